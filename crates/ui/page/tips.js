// Tooltips for a finger and for the keyboard: a tap on a figure or a term, or the focus on a term, shows its meaning.
import { at, setText } from "./figures.js";

// The distance of a tip to its part and to the edges of the window, in pixels.
const GAP = 6;
const TITLED = "[title]:not([title=''])";
// What has an action of its own.
const ACTS = "button, select, input, summary, label, #room";

// The part whose tip is shown, if any.
let shown = null;

// The part with the meaning of this one: itself, or the term of a figure, which heads its column or begins its row.
function explained(target) {
  if (!(target instanceof Element) || target.closest(ACTS)) return null;
  const titled = target.closest(TITLED) ?? target.closest("dl > div")?.querySelector(TITLED);
  const cell = target.closest("td");
  if (titled || !cell) return titled ?? null;
  const head = cell.closest("table").tHead.rows[0].cells[cell.cellIndex];
  return head?.querySelector(TITLED) ?? cell.parentElement.cells[0].querySelector(TITLED);
}

// Below its part, or above it where the window, or on a phone the bar of STOP, leaves no place. It moves with its part.
function show(part) {
  shown = part;
  const tip = at("tip");
  const of = part?.getBoundingClientRect();
  tip.hidden = !of || of.bottom <= 0 || of.top >= innerHeight;
  if (tip.hidden) return;
  setText(tip, part.title);
  const [size, bar] = [tip.getBoundingClientRect(), at("emergency").getBoundingClientRect().top];
  const end = bar > innerHeight / 2 ? bar : innerHeight;
  const below = of.bottom + GAP;
  const top = below + size.height <= end - GAP ? below : Math.max(GAP, of.top - GAP - size.height);
  tip.style.top = `${top}px`;
  tip.style.left = `${Math.max(GAP, Math.min(of.left, innerWidth - GAP - size.width))}px`;
}

export function openTips() {
  addEventListener("click", ({ target }) => show(explained(target)));
  addEventListener("focusin", ({ target }) => show(target.closest("dfn")));
  addEventListener("focusout", () => show(null));
  addEventListener("keydown", ({ key }) => { if (key === "Escape") show(null); });
  for (const event of ["scroll", "resize"]) addEventListener(event, () => show(shown), { capture: true, passive: true });
}

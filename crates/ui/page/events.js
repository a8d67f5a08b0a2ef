// The log of events, newest first. The server keeps it.

import { at } from "./figures.js";

// Height of a window in which the list is open at the start, in CSS pixels.
const OPEN_FROM = 1000;

const time = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" });

export function openEvents() {
  at("events").open = innerHeight >= OPEN_FROM;
  at("events").addEventListener("toggle", () => {
    if (!at("events").open) return;
    // In a lower window the list lies over the decision times: the end of their column has both.
    const column = at("event-log").parentElement;
    if (innerHeight < OPEN_FROM) column.scrollTop = column.scrollHeight;
    at("event-list").scrollIntoView({ block: "nearest" });
  });
}

export function showEvents(events) {
  const rows = events.toReversed().map((event) => fill(document.createElement("li"), event));
  at("event-list").replaceChildren(...rows);
  if (events.length) fill(at("last-event"), events.at(-1));
}

function fill(element, { at_ms, text, is_bad }) {
  const stamp = Object.assign(document.createElement("time"), { dateTime: new Date(at_ms).toISOString(), textContent: time.format(at_ms) });
  element.replaceChildren(stamp, text);
  element.className = is_bad ? "bad" : "";
  return element;
}

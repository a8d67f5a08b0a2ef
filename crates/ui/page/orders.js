// The buttons: each sends an order. A pressed button shows the published state, and the message beside the
// buttons shows the answer of the process that received the order, never the click.

import { CHECK_SERVER, Unanswered, ask, expectTaken, refusalIn } from "./requests.js";
import { STALE_S, isReporting } from "./sentence.js";

const POWERS_W = [0.5, 1, 2, 4];
const SPEEDS = [["0 m/s", 0], ["0.5 m/s", 0.5], ["2 m/s", 2], ["4 m/s", 4]];
const BLOCKED_MAX = 8;
// A message of the page itself, for example without a connection, is shown this long.
const OWN_MESSAGE_MS = 10000;
// An order without an answer of the server ends after this time.
const ORDER_LIMIT_MS = 6000;

// The words of the buttons, for the messages of the page itself.
const BUTTONS = {
  policy: "switch", stick: "jam a quarter", release: "release", stop: "STOP", rearm: "re-arm", "kill-controller": "kill",
  "restart-controller": "restart", power: "optical power", speed: "walking speed", blocked: "blocked direct paths",
};

// The names of buttons whose ids differ, in the line about the disabled ones.
const BUTTON_NAMES = { "switch-policy": "switch", rearm: "re-arm", stick: "mirrors", release: "mirrors" };

// A message of the page about an order that the server did not answer.
export const notConfirmed = (order, reason) =>
  `not confirmed: ${BUTTONS[order]}: ${reason}; ${order === "stop" ? "run `heliostat stop`, or cut the power of the mirrors" : CHECK_SERVER}`;

// What a button for the first users of the table does: its number is no number of a user.
export function blockedTitle(users) {
  if (!users.length) return "leave every direct path as it is";
  const [paths, of] = users.length === 1 ? ["path", "user"] : ["paths", "users"];
  return `block the direct ${paths} of ${of} ${users.map(({ user }) => user).join(", ")}`;
}

// Why a button for so many users does not act, empty where it does.
export function tooFew(users, present) {
  if (users <= present) return "";
  return present === 0 ? "no user is in the room" : `only ${present} ${present === 1 ? "user is" : "users are"} in the room`;
}

// What a phone says below the orders: the names of the disabled ones with their reasons, empty without any.
export function notTaken(disabled) {
  const named = new Map();
  for (const [name, why] of disabled) named.set(why, (named.get(why) ?? new Set()).add(name));
  const texts = [...named].map(([why, names]) => `${[...names].join(", ")} (${why})`);
  return texts.length ? `Disabled: ${texts.join("; ")}.` : "";
}

// Whether every array answers, and none reports a stop: a re-arm would release nothing. Where the number of arrays is not
// announced, or a fault of one hides the state of another, this is unknown.
function isStopFree(plan, { stop, array, ages_s }) {
  const areHeard = plan.geometry_source !== "default" && !array.silent.length && ages_s.array != null && ages_s.array <= STALE_S;
  const isOpen = stop.stops.length || stop.held || stop.problems.length || stop.lost.length || /stopped|fault/.test(array.state);
  return areHeard && !isOpen && (stop.phase === "none" || stop.phase === "released");
}

// Why the buttons of each order are disabled, empty where they are not; `now` is null before the first figures. STOP is
// always enabled.
const AWAITED = "the page waits for the first figures of its server";
export function reasons(plan, now, policy) {
  if (!now) return { rearm: AWAITED, policy: AWAITED, room: AWAITED, kill: AWAITED, restart: AWAITED };
  const limit = plan.stop_only ?? "";
  const foreign = plan.controls_processes ? "" : "only `heliostat demo` can kill or restart the processes that it started";
  const absent = now.controller_alive ? "" : "the page sees no controller";
  const silent = now.origin === "no-data" ? "the room does not report" : "only a simulated room takes this order";
  return {
    rearm: limit || (isStopFree(plan, now) ? "no array reports an emergency stop" : ""),
    policy: limit || absent || (policy ? "" : "no policy is chosen"),
    room: limit || (now.origin === "simulated" ? "" : silent),
    kill: foreign || absent,
    // A controller that hangs is replaced too.
    restart: foreign,
  };
}

export class Orders {
  // STOP acts from now on; the other buttons wait for `open`, and for the first figures.
  constructor() {
    this.plan = null;
    // The names of the stops that the page shows: a re-arm releases these and no others.
    this.stops = [];
    this.newest = null;
    // The number of the last order in an event.
    this.newestId = null;
    this.hasFigures = false;
    this.status = document.getElementById("order-status");
    this.status.addEventListener("click", () => this.dismiss());
    this.note = document.getElementById("not-taken");
    this.jammed = document.getElementById("label-mirrors");
    this.select = document.getElementById("policy");
    this.select.addEventListener("change", () => this.describe(this.select.value));
    this.power = this.speed = this.blocked = [];
    this.on("switch-policy", () => ({ order: "policy", name: this.select.value }));
    this.on("stick", () => ({ order: "stick", share: 0.25 }));
    this.on("release", () => ({ order: "release" }));
    this.on("stop", () => ({ order: "stop" }));
    this.on("rearm", () => ({ order: "rearm", stops: this.stops }));
    this.on("kill", () => ({ order: "kill-controller" }));
    this.on("restart", () => ({ order: "restart-controller" }));
    this.enable(null);
  }

  // Takes the plan of the room.
  open(plan) {
    this.plan = plan;
    this.select.replaceChildren(...plan.policies.map(({ name, description }) => Object.assign(new Option(name, name), { title: description })));
    // None, until the policy in use is known.
    this.select.selectedIndex = -1;
    this.power = this.group("power", POWERS_W.map((watts) => [`${watts} W`, watts]), (watts) => ({ order: "power", watts }));
    for (const [button, watts] of this.power) button.dataset.title = `each LED transmits ${watts} W of light`;
    this.speed = this.group("speed", SPEEDS, (max_m_s) => ({ order: "speed", max_m_s }));
    for (const [button, max_m_s] of this.speed) button.dataset.title = max_m_s ? `users walk at ${max_m_s} m/s at most` : "users stand still";
    // All that the room can have at all times: users who come or go move no button.
    const choices = Array.from({ length: Math.min(plan.users_max ?? BLOCKED_MAX, BLOCKED_MAX) + 1 }, (_, users) => [`${users}`, users]);
    this.blocked = this.group("blocked", choices, (users) => ({ order: "blocked", users }));
    for (const [button, users] of this.blocked) button.ariaLabel = `${users || "no"} ${users === 1 ? "user" : "users"}`;
    this.enable(null);
  }

  // Enables the buttons that act, and gives the others the reason as their tooltip; on a phone a line has the reasons.
  enable(now) {
    const reason = reasons(this.plan, now, this.select.value);
    const disabled = [];
    const set = (button, why, name = BUTTON_NAMES[button.id] ?? button.id) => {
      button.disabled = why !== "";
      button.title = why || (button.dataset.title ?? "");
      if (why) disabled.push([name, why]);
    };
    const of = (id) => document.getElementById(id);
    for (const [button] of this.power) set(button, reason.room, "optical power");
    for (const [button, users] of this.blocked) set(button, reason.room || tooFew(users, now.users.length), reason.room ? "direct paths" : `${users}`);
    for (const [button] of this.speed) set(button, reason.room, "walking speed");
    for (const id of ["stick", "release"]) set(of(id), reason.room);
    set(of("switch-policy"), reason.policy);
    for (const id of ["kill", "restart", "rearm"]) set(of(id), reason[id]);
    const note = notTaken(disabled);
    if (this.note.textContent !== note) this.note.textContent = note;
  }

  // Shows the published state.
  update(now) {
    this.hasFigures = true;
    this.answers(now.orders);
    this.stops = now.stop.stops.map((stop) => stop.name);
    document.getElementById("rearm").textContent = this.stops.length > 1 ? `re-arm all ${this.stops.length}` : "re-arm";
    const pressed = (buttons, value) => {
      for (const [button, of] of buttons) button.setAttribute("aria-pressed", String(value != null && Math.abs(of - value) < 1e-6));
    };
    // While the room is silent, the buttons stay, and none is pressed.
    const isKnown = isReporting(now);
    // Users come and go: the first ones of the table are named.
    for (const [button, users] of this.blocked) button.dataset.title = blockedTitle(now.users.slice(0, users));
    // A real room takes no such order.
    pressed(this.blocked, isKnown && now.origin === "simulated" ? now.users.filter((user) => user.forced).length : null);
    pressed(this.power, isKnown ? now.power_w : null);
    pressed(this.speed, isKnown ? now.speed_m_s : null);
    const jammed = now.jammed ? `Mirrors (${now.jammed} jammed)` : "Mirrors";
    if (this.jammed.textContent !== jammed) this.jammed.textContent = jammed;
    if (now.policy && now.policy !== this.policy) {
      this.policy = now.policy;
      if (document.activeElement !== this.select) this.select.value = now.policy;
      this.describe(this.select.value);
    }
    this.enable(now);
  }

  // What the chosen policy does.
  describe(policy) {
    const chosen = this.plan.policies.find(({ name }) => name === policy);
    document.getElementById("policy-help").textContent = chosen ? `${chosen.name}: ${chosen.description}.` : "";
  }

  on(id, order) {
    document.getElementById(id).addEventListener("click", () => this.send(order()));
  }

  group(id, choices, order) {
    const buttons = choices.map(([name, value]) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = name;
      button.dataset.value = value;
      button.addEventListener("click", () => this.send(order(value)));
      return [button, value];
    });
    document.getElementById(id).replaceChildren(...buttons.map(([button]) => button));
    return buttons;
  }

  async send(order) {
    const before = this.newestId;
    try {
      const answer = await ask("order", ORDER_LIMIT_MS, {
        method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(order),
      });
      const refusal = answer.ok ? null : await refusalIn(answer);
      if (answer.ok) expectTaken(answer);
      // The next event has the answer of the receiver to an order that reached the server. Before the first one the page
      // says what was answered, and of a refusal until an event has the order: it can be that of a proxy.
      const isInEvents = answer.ok || answer.status === 503 || answer.status === 422;
      const isSaid = this.newestId !== before || (answer.ok && this.hasFigures);
      const text = isInEvents ? `${BUTTONS[order.order]}: ${refusal ?? "sent"}` : `refused: ${refusal}`;
      this.own(isInEvents && isSaid ? null : text, isInEvents);
    } catch (error) {
      if (!(error instanceof Unanswered)) throw error;
      this.own(notConfirmed(order.order, error.message));
    }
  }

  // Whether the server accepts orders from this address, before one is needed.
  async check() {
    const refused = document.getElementById("refused");
    try {
      const answer = await ask("check", ORDER_LIMIT_MS, { method: "POST" });
      if (!answer.ok) refused.textContent = `This page cannot send orders, STOP neither. ${await refusalIn(answer)}`;
      refused.hidden = answer.ok;
    } catch (error) {
      // Without a connection the banner says so.
      if (!(error instanceof Unanswered)) throw error;
    }
  }

  // A message of the page itself; a provisional one ends with the first event that has a further order.
  own(text, isProvisional = false) {
    this.message = text && { text, isProvisional, until: performance.now() + OWN_MESSAGE_MS };
    this.show();
  }

  // The newest order that still has something to say.
  answers(orders) {
    this.newest = orders[0] ?? null;
    if (this.newest && this.newest.id !== this.newestId) {
      this.newestId = this.newest.id;
      if (this.message?.isProvisional) this.message = null;
    }
    this.show();
  }

  // Hides a refusal that lies over the page, as on a phone.
  dismiss() {
    if (getComputedStyle(this.status).position !== "fixed" || this.status.className !== "bad") return;
    if (this.message) this.message = null;
    else this.dismissed = this.newest?.id;
    this.show();
  }

  // Ends the answer of a server that is silent, by the time since its last event in s: the server ends the others.
  age(silence) {
    if (silence > STALE_S) this.newest = null;
    this.show();
  }

  show() {
    if (this.newest && this.newest.id === this.dismissed) this.newest = null;
    if (this.message && performance.now() > this.message.until) this.message = null;
    const text = this.message?.text ?? this.newest?.text ?? "";
    const answer = this.message ? "refused" : this.newest?.state;
    const state = { done: "good", sent: "", [undefined]: "" }[answer] ?? "bad";
    if (this.status.textContent !== text) this.status.textContent = this.status.title = text;
    if (this.status.className !== state) this.status.className = state;
  }
}

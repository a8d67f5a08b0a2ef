// Starts the page: loads the static plan once, then applies the live events.
import { Room } from "./room.js";
import { Charts } from "./charts.js";
import { Buttons } from "./buttons.js";

export const USER_COLOURS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#999933", "#aa4499"];
export const userColour = (index) => USER_COLOURS[index % USER_COLOURS.length];

const at = (id) => document.getElementById(id);
const setText = (element, text) => { if (element.textContent !== text) element.textContent = text; };

// Theme: the system's until the user chooses one.
const systemDark = matchMedia("(prefers-color-scheme: dark)");
const chosen = () => localStorage.getItem("theme") ?? "system";
const isDark = () => chosen() === "dark" || (chosen() === "system" && systemDark.matches);
function applyTheme(parts) {
  document.documentElement.dataset.theme = isDark() ? "dark" : "light";
  setText(at("theme"), `theme: ${chosen()}`);
  parts.forEach((part) => part.theme(isDark()));
}

function chip(id, text, state) {
  setText(at(id), text);
  at(id).className = state ?? "";
}

function users(rows) {
  const body = at("users");
  while (body.rows.length > rows.length) body.deleteRow(-1);
  const largest = Math.max(1, ...rows.map((user) => Math.max(user.rate_mbps, user.min_rate_mbps)));
  rows.forEach((user, index) => {
    let row = body.rows[index];
    if (!row) {
      row = body.insertRow();
      row.innerHTML = '<td><span class="swatch"></span><span></span></td><td></td><td class="number"></td>' +
        '<td class="number"></td><td><div class="bar"><i></i><b></b></div></td>';
      row.querySelector(".swatch").style.background = userColour(index);
      row.querySelector(".bar i").style.background = userColour(index);
    }
    const [name, path, rate, minimum, bar] = row.cells;
    const met = user.rate_mbps >= user.min_rate_mbps;
    setText(name.lastChild, String(user.user));
    setText(path, user.forced ? "blocked (order)" : user.blocked ? "blocked" : "clear");
    setText(rate, user.rate_mbps.toFixed(2));
    rate.className = met ? "number" : "number bad";
    setText(minimum, met ? user.min_rate_mbps.toFixed(1) : `${user.min_rate_mbps.toFixed(1)} not met`);
    minimum.className = rate.className;
    bar.querySelector("i").style.width = `${(100 * user.rate_mbps) / largest}%`;
    bar.querySelector("b").style.left = `${(100 * user.min_rate_mbps) / largest}%`;
  });
}

function list(element, entries) {
  while (element.children.length > entries.length) element.lastChild.remove();
  entries.forEach(([name, value, state], index) => {
    if (!element.children[index]) element.insertAdjacentHTML("beforeend", "<div><dt></dt><dd></dd></div>");
    const [term, figure] = element.children[index].children;
    setText(term, name);
    setText(figure, value);
    figure.className = state ?? "";
  });
}

function quantiles(times) {
  const body = at("quantiles").tBodies[0];
  times.forEach(({ name, us }, index) => {
    const row = body.rows[index] ?? body.insertRow();
    const cells = [name, ...(us ? [us.p50, us.p99, us.max].map((value) => value.toFixed(0)) : ["–", "–", "–"])];
    cells.forEach((text, column) => {
      const cell = row.cells[column] ?? row.insertCell();
      if (column > 0) cell.className = "number";
      setText(cell, text);
    });
  });
}

function figures(now) {
  const ORIGIN = { simulated: ["simulated", ""], measured: ["measured", ""], "no-data": ["no data", "bad"] };
  chip("chip-policy", now.policy || "–");
  const stuck = now.array.unusable ? `, ${now.array.unusable} of ${now.array.mirrors} unusable` : "";
  chip("chip-array", now.array.state + stuck, now.array.state === "following" && !stuck ? "good" : "bad");
  chip("chip-controller", now.controller_alive ? "alive" : "gone", now.controller_alive ? "good" : "bad");
  chip("chip-room", ...ORIGIN[now.origin]);
  users(now.users);
  quantiles(now.times);
  const faults = ["faults", now.array.faults.join(", ") || "none", now.array.faults.length ? "bad" : ""];
  const counts = now.counts.map((count) => [count.name, String(count.value), count.is_problem && count.value > 0 ? "bad" : ""]);
  list(at("counts"), [...counts, faults]);
  const problem = now.nodes.filter((node) => node.problem).map((node) => `${node.node}: ${node.problem}`);
  setText(at("problem"), [...now.notes, ...problem].join("; "));
}

async function start() {
  const plan = await (await fetch("/room.json")).json();
  setText(at("where"), `room ${plan.room}, scenario ${plan.scenario}`);
  const parts = [new Room(at("room"), plan), new Charts(plan), new Buttons(plan)];
  const [room, charts, buttons] = parts;
  const retheme = () => applyTheme(parts);
  retheme();
  systemDark.addEventListener("change", retheme);
  at("theme").addEventListener("click", () => {
    const next = { system: "dark", dark: "light", light: "system" };
    localStorage.setItem("theme", next[chosen()]);
    retheme();
  });

  const live = new EventSource("/live");
  live.addEventListener("figures", (event) => {
    const now = JSON.parse(event.data);
    if (now.geometry !== plan.geometry) { location.reload(); return; }
    figures(now);
    buttons.update(now);
    charts.update(now);
  });
  live.addEventListener("frame", (event) => room.update(JSON.parse(event.data)));
  live.addEventListener("error", () => chip("chip-room", "no connection", "bad"));
}

start().catch((error) => chip("chip-room", `no page: ${error.message}`, "bad"));

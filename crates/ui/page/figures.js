// The figures beside the room: state chips, users, counters, times and problems.
import { jain } from "./fairness.js";
import { userColour } from "./geometry.js";
import { asSentence, duration, isCalibrating, noReport, rateOf, refusal } from "./sentence.js";

export const at = (id) => document.getElementById(id);
export const setText = (element, text) => { if (element.textContent !== text) element.textContent = text; };
const setTitle = (element, text) => { if (element.title !== text) element.title = text; };
const setClass = (element, name) => { if (element.className !== name) element.className = name; };

// The sentence and the width of the window for which its size was chosen; digits have one width.
let fitted = "";

// The sentence above the picture. One that does not fit its line has two smaller ones of the same height.
export function showSentence(text) {
  const sentence = at("sentence");
  setText(sentence, text);
  const place = `${text.replace(/\d/g, "0")} ${innerWidth}`;
  if (place === fitted) return;
  fitted = place;
  sentence.classList.remove("long");
  sentence.classList.toggle("long", sentence.scrollHeight > sentence.clientHeight);
}

// A narrow window cuts the text off; the tooltip has it, or more.
function chip(id, text, state = "", title = text) {
  setText(at(id), text);
  setTitle(at(id), title);
  setClass(at(id), state);
}

// The network of a learned policy: the file that the user gave, else the hash of another one.
export function networkIn(hash, file) {
  if (!hash) return "";
  return hash === file?.hash ? `Its network is ${file.name}.` : `Its network has the hash ${hash}.`;
}

// The state of each process; a state that is old or unknown is never green, and an unknown one is not bad.
export function chips(now, ages, file) {
  const silent = (process) => noReport(ages.of(process));
  const kind = (process) => (ages.isUnknown(process) ? "old" : "bad");
  const { name, idle } = now.in_charge;
  const isSilent = ages.isStale("controller") || !now.controller_alive;
  const policy = idle && now.policy ? `${now.policy} (idle)` : now.policy || "–";
  const explained = [idle, networkIn(now.network, file)].filter(Boolean).join(" ");
  chip("chip-policy", isCalibrating(now) ? name : policy, idle || isSilent ? "old" : "", explained || undefined);
  if (isSilent) {
    const isAbsent = !now.controller_alive && !ages.isStale("server");
    if (isAbsent && now.controller_unseen) chip("chip-controller", "not seen", "bad");
    else chip("chip-controller", isAbsent && !ages.isUnknown("controller") ? "gone" : silent("controller"), kind("controller"));
  } else {
    const refusing = refusal(now);
    chip("chip-controller", isCalibrating(now) ? "calibration" : refusing ? "reports refused" : "alive", refusing ? "bad" : "good");
  }
  const stuck = now.array.unusable ? `, ${now.array.unusable} unusable` : "";
  const array = now.array.state + stuck;
  if (ages.isStale("array")) chip("chip-array", silent("array"), kind("array"));
  else chip("chip-array", array, now.array.state === "following" && !stuck ? "good" : "bad", stuck ? `${array} of ${now.array.mirrors} mirrors` : array);
  if (ages.isStale("room")) chip("chip-room", silent("room"), kind("room"));
  else chip("chip-room", now.origin);
}

// The users of the table with their rates. Without the mirrors they are those of the frame that the picture shows, so
// that direct path, rate and picture are of one report.
function rated(now, shown, frame) {
  if (shown.wall) return now.users.map((user) => ({ ...user, rate: user.is_rate_known ? rateOf(user) : null }));
  if (!frame) return now.users.map((user) => ({ ...user, rate: null }));
  return frame.users.map((user) => ({ ...user, rate: user.without_mirrors_mbps }));
}

// The sum rates. Without the mirrors, that without them is of the frame of the table, so that its rates add up to it; the
// report of the other sums may be an earlier or a later one.
export function sums(now, shown, frame) {
  const rates = shown.wall ? [] : rated(now, shown, frame).map(({ rate }) => rate);
  if (now.sum_mbps?.no_irs == null || rates.length === 0 || rates.some((rate) => rate == null)) return now.sum_mbps;
  return { ...now.sum_mbps, no_irs: rates.reduce((sum, rate) => sum + rate, 0) };
}

// One row for each user, by id: users come and go.
export function users(now, shown, frame, outages) {
  const body = at("users");
  const listed = rated(now, shown, frame);
  const largest = Math.max(1, ...listed.map((user) => Math.max(user.rate ?? 0, user.min_rate_mbps)));
  const rows = new Map([...body.rows].map((row) => [row.dataset.user, row]));
  listed.forEach((user, index) => {
    const row = rows.get(String(user.user)) ?? newRow(user.user);
    rows.delete(String(user.user));
    if (body.rows[index] !== row) body.insertBefore(row, body.rows[index] ?? null);
    fill(row, user, largest);
    // The outages are those with the mirrors.
    const outage = shown.wall ? outages.of(user.user) : null;
    setText(row.cells[4], outageText(outage));
    setTitle(row.cells[4], outageLengths(outage));
  });
  for (const row of rows.values()) row.remove();
  const fairness = jain(listed.map(({ rate }) => rate));
  setText(at("jain"), fairness === null ? "–" : fairness.toFixed(2));
  setText(at("rates-title"), shown.wall ? "Rate of each user" : "Rate of each user without the mirrors");
}

function newRow(user) {
  const row = document.createElement("tr");
  row.dataset.user = user;
  row.innerHTML = '<td><span class="swatch"></span><span></span></td><td></td><td class="number"><span></span><small></small></td>' +
    '<td class="number"></td><td class="number"></td><td><div class="bar"><i></i><b></b></div></td>';
  row.querySelector(".swatch").style.background = userColour(user);
  row.querySelector(".bar i").style.background = userColour(user);
  return row;
}

function fill(row, user, largest) {
  const { rate } = user;
  const [name, path, figure, minimum, , bar] = row.cells;
  const below = rate !== null && rate < user.min_rate_mbps;
  setText(name.lastChild, String(user.user));
  setText(path, user.blocked === null ? "unknown" : user.forced ? "by order" : user.blocked ? "blocked" : "clear");
  const [known, possible] = figure.children;
  setText(known, rate === null ? "unknown" : rate.toFixed(rate < 100 ? 2 : 1));
  const [oracle, share] = rate === null ? [null, null] : [user.oracle_mbps ?? null, user.share_of_oracle ?? null];
  setText(possible, share === null ? "" : ` ${shareText(share)}`);
  const judged = share === null ? "" : ` The mirrors gave ${shareText(share)} of it at the same time.`;
  setTitle(figure, oracle === null ? "" : `At the last status of the simulator the oracle gave this user ${oracle.toFixed(2)} Mbit/s.${judged}`);
  setClass(figure, below ? "number bad" : "number");
  setText(minimum, `${below ? "below " : ""}${user.min_rate_mbps.toFixed(1)}`);
  setTitle(minimum, below ? "The rate is below the minimum rate." : "");
  setClass(minimum, figure.className);
  setTitle(bar, "The rate, with the minimum rate as a line.");
  bar.querySelector("i").style.width = `${(100 * (rate ?? 0)) / largest}%`;
  bar.querySelector("b").style.left = `${(100 * user.min_rate_mbps) / largest}%`;
}

// The oracle may give a user hardly any rate, for the sum.
const shareText = (share) => (share > 9.99 ? "> 999 %" : `${(100 * share).toFixed(0)} %`);

function outageText(outage) {
  if (outage === null) return "–";
  return outage.share === 0 ? "none" : `${(100 * outage.share).toFixed(0)} %, ${outage.longest_s.toFixed(1)} s`;
}

// The number and the lengths of the outages in the observed time.
export function outageLengths(outage) {
  if (outage === null) return "";
  const { observed_s, count, p50_s, p95_s } = outage;
  const within = `in the last ${duration(observed_s)}`;
  if (count === 0) return `no outage ${within}`;
  return `${count} ${count === 1 ? "outage" : "outages"} ${within}: p50 ${p50_s.toFixed(1)} s, p95 ${p95_s.toFixed(1)} s`;
}

function list(element, entries) {
  while (element.children.length > entries.length) element.lastChild.remove();
  entries.forEach(([name, value, state, meaning, of], index) => {
    if (!element.children[index]) element.insertAdjacentHTML("beforeend", '<div><dt><dfn tabindex="0"></dfn></dt><dd></dd></div>');
    const [term, figure] = element.children[index].children;
    element.children[index].dataset.from = of;
    setText(term.firstChild, name);
    setTitle(term.firstChild, meaning);
    setText(figure, value);
    setClass(figure, state ?? "");
  });
}

// What the rows of times mean. Those in `DECIDED` also need position reports: without them no decision is timed.
const DECIDED = ["decision", "age"];
const TIMES = {
  decision: "From the arrival of a position report in the controller to the end of the publication of its commands.",
  loop: "From the publication of a position report by the simulator to the arrival of its command at the array.",
  age: "From the sampling of the positions to the decision that uses them.",
};

// A number with a narrow space between its thousands, which no language reads as a decimal sign.
export const grouped = (value) => value.toFixed(0).replace(/\B(?=(\d{3})+$)/g, "\u202f");

function quantiles(times) {
  const body = at("quantiles").tBodies[0];
  times.forEach(({ name, of, us }, index) => {
    const row = body.rows[index] ?? body.insertRow();
    row.dataset.from = DECIDED.includes(name) ? `${of} room` : of;
    if (!row.cells[0]) {
      const explained = Object.assign(document.createElement("dfn"), { tabIndex: 0, title: TIMES[name], textContent: name });
      row.insertCell().append(explained);
    }
    const texts = us ? [us.p50, us.p99, us.max].map(grouped) : ["–", "–", "–"];
    texts.forEach((text, column) => {
      const cell = row.cells[column + 1] ?? row.insertCell();
      setClass(cell, "number");
      setText(cell, text);
    });
  });
}

// Which controller leads, which stand by or do not report, and the takeovers of those in the room, if there are any; nothing where one controller is alone.
function standby(controllers) {
  const short = ({ name }) => name.slice(0, 4);
  const WORDS = { leads: "leads", calibrates: "calibrates", unheard: "commands, but no array reports", unfollowed: "is not followed", "stands-by": "stands by", silent: "does not report" };
  const leaders = controllers.filter((one) => one.role === "leads" || one.role === "calibrates");
  const isBad = leaders.length !== 1 || controllers.some((one) => one.role === "silent");
  const sum = (key) => controllers.reduce((total, one) => total + one[key], 0);
  const isSpread = new Set(controllers.map((one) => one.host)).size > 1;
  const host = (one) => (isSpread && one.host ? ` on ${one.host}` : "");
  const text = controllers.map((one) => `${short(one)}${host(one)} ${WORDS[one.role]}`).join(", ");
  const of = (key) => controllers.map((one) => `${short(one)} ${one[key]}`).join(", ") || "0";
  const lost = sum("false_takeovers");
  const taken = sum("takeovers") + lost;
  if (controllers.length < 2 && taken === 0) return [];
  const roles = [
    ["controllers", text || "none", isBad ? "wide bad" : "wide", "The controllers in the room, by the beginning of their source id, with their hosts if these differ: one leads, or a calibration commands in its place; the others stand by. One is not followed where it does not stand by and the array follows another one or reports none. Where no array reports, the one that commands is not known to lead. One that does not report hangs, or the link to it is cut.", "controller"],
  ];
  if (taken === 0) return roles;
  return [
    ...roles,
    ["takeovers", of("takeovers"), "wide", "How often each controller in the room took over since its start.", "controller"],
    ["false takeovers", of("false_takeovers"), lost > 0 ? "wide bad" : "wide", "Takeovers of each controller from a leader that was not gone: a slow controller, or a link that loses messages.", "controller"],
  ];
}

// What is wrong, each line with what to do: the notes about the room, then the problems of its processes. What the
// answer to an order already says is left out. Below them, what differs without a fault.
export function problems(now) {
  const isSaid = ({ problem }) => now.orders.some(({ reason }) => reason && problem.endsWith(reason));
  const ofProcesses = now.nodes.filter((node) => node.problem && !isSaid(node)).map((node) => `${node.node}: ${node.problem}`);
  listProblems([...now.notes, ...ofProcesses]);
  lines(at("remark"), now.remarks);
}

// After the end of the server no problem is a present one; the log of events keeps them.
export const clearProblems = () => listProblems([]);

// On a phone the list scrolls away, and its first line, the most serious one, stays beside STOP.
function listProblems(texts) {
  lines(at("problem"), texts);
  at("worst").hidden = texts.length === 0;
  setText(at("worst"), texts.length ? asSentence(texts[0]) : "");
}

function lines(list, texts) {
  const lines = texts.map(asSentence);
  list.hidden = lines.length === 0;
  while (list.children.length > lines.length) list.lastChild.remove();
  lines.forEach((line, index) => setText(list.children[index] ?? list.appendChild(document.createElement("li")), line));
}

// The noise of positions that the belief has learned; the tooltip has the stated one, and the velocities.
function trackerNoise(noise) {
  if (!noise) return [];
  const cm = (metres) => `${(100 * metres).toFixed(1)} cm`;
  const meaning = `Standard deviation of a reported coordinate, as the belief learns it from the reports: ${cm(noise.position_m)}; the scenario states ${cm(noise.position_stated_m)}. Of a velocity component: ${noise.velocity_m_s.toFixed(2)} m/s; stated ${noise.velocity_stated_m_s.toFixed(2)} m/s.`;
  return [["tracker noise", cm(noise.position_m), "", meaning, "controller"]];
}

// The light of served users as a share of the expected one, where it is farthest from it; the tooltip has all.
function servedLight(light) {
  if (light.length === 0) return [];
  const farthest = light.reduce((far, one) => (Math.abs(Math.log(one.ratio)) > Math.abs(Math.log(far.ratio)) ? one : far));
  const all = light.map(({ of, ratio }) => `${of} ${ratio.toFixed(2)}`).join(", ");
  const isOff = light.some((one) => one.off_since_s !== undefined);
  const meaning = `Median of the light that served users receive, as a share of the light that the controller expects at the present angles: ${all}.`;
  return [["light received", farthest.ratio.toFixed(2), isOff ? "bad" : "", meaning, "controller"]];
}

// The process that counts, and since when: the counters of the list are of several processes.
export function countedBy({ process, minutes }) {
  if (!process) return "";
  const ago = minutes === 0 ? "less than a minute" : duration(60 * minutes);
  return `Counted since the start of ${process}${minutes === null ? "" : `, ${ago} ago`}.`;
}

// Counters, times and faults.
export function counters(now) {
  quantiles(now.times);
  at("late").hidden = now.late == null;
  setText(at("late"), now.late ?? "");
  const meaning = "Faults that the arrays report now: link, mirror, temperature, supply, calibration, clock, or a stop that is not executed.";
  // Without any report it is unknown whether there are faults.
  const noFaults = now.array.silent.length < now.array.arrays ? "none" : "–";
  const faults = ["faults", now.array.faults.join(", ") || noFaults, now.array.faults.length ? "bad" : "", meaning, "array"];
  const counts = now.counts.map((count) => [count.name, count.value === null ? "–" : String(count.value), count.is_problem && count.value > 0 ? "bad" : "", `${count.meaning.replace(/\.?$/, ".")} ${countedBy(count)}`.trim(), count.of]);
  list(at("counts"), [...counts, faults, ...trackerNoise(now.tracker_noise), ...servedLight(now.light), ...standby(now.controllers)]);
}

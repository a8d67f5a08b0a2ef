// Starts the page: loads the static plan once, then applies the live events.
import { Ages } from "./stale.js";
import { Charts } from "./charts.js";
import { Live } from "./live.js";
import { Orders } from "./orders.js";
import { Outages } from "./outages.js";
import { CHECK_SERVER, Refused, Unanswered, ask, refusalIn } from "./requests.js";
import { Room } from "./room.js";
import { presentUsers } from "./geometry.js";
import { banner, endBanner, isNewer, lastSentence, sentence, spoken } from "./sentence.js";
import { at, chips, clearProblems, counters, problems, setText, showSentence, sums, users } from "./figures.js";
import { heatGradient } from "./heat.js";
import { openEvents, showEvents } from "./events.js";
import { openTips } from "./tips.js";

// Theme: the system's until the user chooses one.
const systemDark = matchMedia("(prefers-color-scheme: dark)");
const chosen = () => localStorage.getItem("theme") ?? "system";
const isDark = () => chosen() === "dark" || (chosen() === "system" && systemDark.matches);
function applyTheme(parts) {
  document.documentElement.dataset.theme = isDark() ? "dark" : "light";
  setText(at("theme"), `theme: ${chosen()}`);
  parts.forEach((part) => part.theme(isDark()));
}

function showBanner({ now, ages, ended, orders }) {
  const shown = ended
    ? endBanner(ended, now)
    : banner(now, ages.silence, ages.of("array"), ages.of("present_controller"), orders.plan.stop_only);
  const element = at("banner");
  element.hidden = shown === null;
  setText(at("said"), shown ? spoken(shown.text) : "");
  if (!shown) return;
  setText(element, shown.text);
  element.dataset.kind = shown.kind;
}

// Figures are shown at most this often, so that they can be read. All parts show the same event, so that
// sentence and table agree. Without the mirrors this is a frame, for the picture too.
const SHOW_EVERY_MS = 250;

// A server that does not answer by then is given up.
const START_LIMIT_MS = 15000;

// What depends on the age of the figures, several times a second.
function showAges(state) {
  const { now, ages, room, frame, ended, network, orders } = state;
  showBanner(state);
  orders.age(ages.silence);
  showSentence(ended ? lastSentence : sentence(now, ages.of("room"), room.shown, frame));
  ages.mark();
  if (!now) return;
  chips(now, ages, network);
}

// Figures and frames may list different users for a moment; both are drawn.
function keepColours({ now, frame }) {
  presentUsers([now, frame].flatMap((event) => event?.users ?? []).map((user) => user.user));
}

function showHeat(map) {
  at("heat-scale").hidden = map === null;
  if (map) setText(at("heat-max"), `${map.max_mbps.toFixed(0)} Mbit/s`);
}

async function loadPlan() {
  const answer = await ask("room.json", START_LIMIT_MS);
  if (!answer.ok) throw new Refused(await refusalIn(answer));
  try {
    return await answer.json();
  } catch (error) {
    console.info(error);
    throw new Unanswered("the description of the room did not arrive complete");
  }
}

// Why the page does not start, and what to do.
function notStarted(error) {
  const advice = "To stop the mirrors, run `heliostat stop`, or cut their power.";
  if (error instanceof Refused) return `The page cannot start: its server refuses: ${error.message.trim()}. ${advice}`;
  if (error instanceof Unanswered) return `The page cannot start: ${error.message}. To go on, ${CHECK_SERVER}, and load the page again. ${advice}`;
  return `The page cannot start: this browser cannot run a part of it. Use a current Chromium or Firefox; its console has the cause. ${advice}`;
}

async function start() {
  const orders = new Orders();
  const plan = await loadPlan();
  orders.open(plan);
  const where = `room ${plan.room}, scenario ${plan.scenario}`;
  setText(at("where"), where);
  at("where").title = where;
  at("heat-bar").style.background = heatGradient;
  const room = new Room(at("room"), plan);
  const askHistory = async () => (await loadPlan()).history;
  const charts = new Charts(plan, askHistory);
  orders.check();
  openEvents();
  openTips();
  // At the top of the page the banner is above the list; elsewhere it would cover its first lines.
  at("worst").addEventListener("click", () => scrollTo(0, 0));
  const parts = [room, charts];
  const retheme = () => applyTheme(parts);
  retheme();
  systemDark.addEventListener("change", retheme);
  at("theme").addEventListener("click", () => {
    const next = { system: "dark", dark: "light", light: "system" };
    localStorage.setItem("theme", next[chosen()]);
    retheme();
  });

  // `users` are the figures at the newest report of the room, with what the mirrors followed then: those of a silent
  // room stay, in grey with their age.
  const state = { now: null, users: null, frame: null, framed: 0, room, ages: null, ended: "", network: plan.network, orders };
  const outages = new Outages();
  const show = () => showAges(state);
  state.ages = new Ages(show, () => room.pictureAge);
  const showUsers = () => {
    if (!state.users) return;
    users(state.users, room.shown, state.frame, outages);
    charts.figures(sums(state.users, room.shown, state.frame), state.users.sum_name);
  };
  addEventListener("shown", () => { showUsers(); show(); });
  addEventListener("heat", ({ detail }) => showHeat(detail));
  new Live(plan.page, {
    figures: (now) => {
      outages.take(now);
      if (state.ages.silence * 1000 < SHOW_EVERY_MS && state.now) return;
      state.now = now;
      const isNew = isNewer(now, state.users);
      if (isNew || !state.users) state.users = now;
      keepColours(state);
      state.ages.take(now);
      charts.update(isNew ? now : { ...now, sum_mbps: null }, state.users.in_charge);
      showUsers();
      counters(now);
      problems(now);
      orders.update(now);
      show();
    },
    log: showEvents,
    ended: (text) => {
      state.ended = text;
      clearProblems();
      show();
    },
    mode: (mode) => {
      const text = mode === "polled" ? `${where}; slower, because other rooms of this site are open` : where;
      setText(at("where"), text);
      at("where").title = text;
    },
    problem: (text) => {
      at("refused").hidden = false;
      setText(at("refused"), `The server sends no figures: ${text}`);
    },
    frame: (frame) => {
      // The next figures load the page again.
      if (frame.geometry !== plan.geometry) return;
      const [now, without] = [performance.now(), !room.shown.wall];
      if (without && now - state.framed < SHOW_EVERY_MS) return;
      state.framed = now;
      state.frame = frame;
      keepColours(state);
      room.update(frame);
      if (without) {
        showUsers();
        show();
      }
    },
  });
}

start().catch((error) => {
  at("awaited").hidden = true;
  at("banner").hidden = false;
  at("banner").dataset.kind = "bad";
  setText(at("banner"), notStarted(error));
  setText(at("said"), notStarted(error));
  console.error(error);
});

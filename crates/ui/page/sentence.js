// The sentence above the room, and the banner: both say what is unknown, and neither shows old values.

import { CHECK_SERVER } from "./requests.js";

// Figures older than this are stale, in s.
export const STALE_S = 1;

const rounded = (mbps) => (Math.abs(mbps) < 10 ? mbps.toFixed(1) : mbps.toFixed(0));

// A time in s, in words.
export function duration(time_s) {
  if (time_s < 120) return `${time_s < 10 ? time_s.toFixed(1) : time_s.toFixed(0)} s`;
  return time_s < 7200 ? `${Math.floor(time_s / 60)} min` : `${Math.floor(time_s / 3600)} h`;
}

// What the page says of a source that is silent; the age is infinite where it never reported.
export const noReport = (age) => (age === Infinity ? "no report" : `no report for ${duration(age)}`);

// What the mirrors add to the sum rate.
function mirrorsIn({ sum_mbps: sum, sum_name: name }) {
  if (!sum) return "The rates are unknown.";
  if (sum.is_modelled) return `The ${name} is ${rounded(sum.policy)} Mbit/s, and ${rounded(sum.no_irs)} without the mirrors.`;
  if (sum.no_irs == null) return `The ${name} is ${rounded(sum.policy)} Mbit/s; the rate without mirrors is unknown.`;
  const gain = sum.policy - sum.no_irs;
  if (Math.abs(gain) < 0.05) return "Mirrors add nothing to the sum rate.";
  return gain > 0 ? `Mirrors add ${rounded(gain)} Mbit/s.` : `Mirrors take ${rounded(-gain)} Mbit/s away.`;
}

// The rate of a user with the mirrors, which the table and the sentence judge: one with a share of the oracle's is that of
// the instant of the share.
export const rateOf = ({ rate_mbps, compared_mbps }) => compared_mbps ?? rate_mbps;

// How many users are below their minimum rate.
function usersIn(users) {
  if (users.length === 0) return "No user is in the room.";
  const unknown = users.filter((user) => !user.is_rate_known).length;
  const below = users.filter((user) => user.is_rate_known && rateOf(user) < user.min_rate_mbps).length;
  const of = `of ${users.length} ${users.length === 1 ? "user" : "users"}`;
  const rest = unknown ? ` The rate of ${unknown} ${of} is unknown.` : "";
  if (below === users.length) return `${below === 1 ? "The user is" : `All ${below} users are`} below the minimum rate.`;
  if (below > 0) return `${below} ${of} ${below === 1 ? "is" : "are"} below the minimum rate.${rest}`;
  if (unknown === users.length) return "No receiver reports the gains of its user.";
  if (unknown) return rest.trim();
  return users.length === 1 ? "The user has the minimum rate." : `All ${users.length} users have their minimum rate.`;
}

// How many users lose their link without the mirrors, while the room is shown without them.
function withoutIn(users) {
  const known = users.filter((user) => user.without_mirrors_mbps != null);
  if (known.length < users.length || users.length === 0) return "The rates without the mirrors are unknown.";
  const below = known.filter((user) => user.without_mirrors_mbps < user.min_rate_mbps);
  if (!below.length) return `Without the mirrors, all ${users.length} users have their minimum rate.`;
  const names = `${below.length === 1 ? "user" : "users"} ${below.map((user) => user.user).join(", ")}`;
  return `Without the mirrors, ${below.length} of ${users.length} users ${below.length === 1 ? "is" : "are"} below the minimum rate: ${names}.`;
}

// Whether the figures of the users are not old.
export const isReporting = (now) => now.ages_s.room != null && now.ages_s.room <= STALE_S;

// Whether figures have a later report of the room than those before, which may be `null`. The two times of a report, as
// seen by the server, differ by less than that between two reports.
const SAME_REPORT_S = 0.005;
const reportedAt = (now) => now.time_s - now.ages_s.room;
export const isNewer = (now, before) => isReporting(now) && (!before || before.ages_s.room == null || reportedAt(now) > reportedAt(before) + SAME_REPORT_S);

// The controller, if it refuses the position reports; else `undefined`.
export const refusal = (now) => now.nodes.find(({ node, state }) => node === "controller" && state === "position reports refused");

// Whether a calibration commands the mirrors in place of a controller, as the server judges it.
export const isCalibrating = (now) => now.in_charge?.name === "calibration";

// The sentence for figures of an age in s; `now` is null before the first figures.
export function sentence(now, age, shown, frame) {
  if (now === null) return "Waiting for the first report of the room.";
  if (now.ages_s.room == null) return "No room has reported yet: users and rates are unknown.";
  if (age > STALE_S) return `The room has not reported for ${duration(age)}: users and rates are unknown.`;
  if (isCalibrating(now)) return `A calibration commands the mirrors: ${now.calibration}. The rates are those of its probes.`;
  // The list of problems has the reason.
  if (refusal(now)) return "The controller refuses the position reports.";
  if (shown?.wall === false && frame) return withoutIn(frame.users);
  return now.users.length === 0 ? usersIn(now.users) : `${mirrorsIn(now)} ${usersIn(now.users)}`;
}

// A text for a screen reader, which reads it again at each change: without ages, which change several times a second.
export const spoken = (text) => text.replace(/ (for|at least) [\d.]+ (s|min|h)\b( ago)?/g, "");

// Who ordered a stop and why, and when, unless the banner has said this time, `said` in s; the server of this page may
// have opened after the stop.
function orderedBy({ name, operator, reason, age_s }, said) {
  const why = reason ? ` (${reason})` : "";
  if (/^0+\/0$/.test(name)) return `The array started stopped${why}.`;
  const known = Math.abs(age_s - said) < 1 ? "" : ` at least ${duration(age_s)} ago`;
  return `Ordered by ${operator || `stop ${name}`}${why}${known}.`;
}

export const capitalised = (text) => `${text[0].toUpperCase()}${text.slice(1)}`;
export const asSentence = (text) => `${capitalised(text)}.`;

// The banner of a controller that is in the room and does not report; no calibration has an age here.
function controllerBanner(age) {
  if (age <= STALE_S || age === Infinity) return null;
  return { kind: "bad", text: `The controller has not reported for ${duration(age)}: it hangs, or the connection to it is lost. Check its process, or restart it.` };
}

// A stop that was open at the last event of the server is still the first thing to know.
function openStop(now) {
  const isOpen = ["requested", "unconfirmed"].includes(now?.stop.phase);
  return isOpen ? " Its last stop was not confirmed: run `heliostat stop`, or cut the power of the mirrors." : "";
}

// The banner of a server that has ended in order, and the sentence beside it. The server says why.
export function endBanner(text, now) {
  const open = openStop(now);
  return { kind: open ? "bad" : "stop", text: `${text}${open} Everything below is old.` };
}
export const lastSentence = "The figures are the last ones before the end.";

// The banner: `null`, or its text and kind. `silence` is the time since the last event of the server in s; `stopOnly`
// says that the certificate of the page permits no re-arm.
export function banner(now, silence, arrayAge, controllerAge, stopOnly) {
  const check = asSentence(CHECK_SERVER);
  if (now === null) return silence > 3 ? { kind: "bad", text: `No connection to the server of this page. ${check}` } : null;
  if (silence > STALE_S) {
    return { kind: "bad", text: `No connection to the server of this page for ${duration(silence)}.${openStop(now)} Everything below is old. ${check}` };
  }
  const { phase, since_s, stops, held, problems, free, lost } = now.stop;
  const several = now.array.arrays > 1;
  const [who, have, their] = several ? ["The arrays", "have", "their devices have"] : ["The array", "has", "its device has"];
  const lacking = several ? "Not every array has" : "The array has not";
  // The time of a confirmed stop is not in the text.
  const said = phase === "unconfirmed" ? since_s : NaN;
  const by = stops.map((stop) => ` ${orderedBy(stop, said)}`).join("");
  const open = problems.length ? ` ${problems.map(asSentence).join(" ")}` : "";
  const ends = lost.length ? " Only reports of the arrays, the return of a lost driver or a release can end this warning." : " Only the arrays can end this warning.";
  const moving = free.map((array) => ` Array ${array} is not stopped: no stop holds it.`).join("");
  switch (phase) {
    case "requested": return { kind: "bad", text: `Stop requested. ${lacking} confirmed it yet.${open}` };
    case "unconfirmed":
      // The words of a controller have the time of the stop that it holds.
      return { kind: "bad", text: `${lacking} confirmed the stop${held ? "" : ` for ${duration(since_s)}`}.${open || " No array reports: cut the power of the mirrors."}${moving}${by}${held ? "" : ends}` };
    case "confirmed":
      if (arrayAge > STALE_S) {
        return { kind: "bad", text: `${who} confirmed the stop, but ${have} not reported for ${duration(arrayAge)}: ${several ? "their" : "its"} state is unknown.${by}` };
      }
      return { kind: free.length || problems.length ? "bad" : "stop", text: `${who} ${have} confirmed the stop: ${their} executed it.${open}${moving}${by} Re-arm${stopOnly ? " with the keys of an operator" : ""} releases ${stops.length > 1 ? `these ${stops.length} stops` : "it"}.` };
    // A state that contradicts it comes from a second driver, or from a stop that follows. Without telemetry none is known.
    case "released":
      if (lost.length) return { kind: "bad", text: `The stop is released, and a lost driver has not confirmed it. ${lost.map(asSentence).join(" ")}` };
      return arrayAge > STALE_S || now.array.state.includes("stopped") ? null : { kind: "good", text: `The stop is released: ${who.toLowerCase()} ${have} confirmed it.` };
    default: return controllerBanner(controllerAge);
  }
}

// The age of what the page shows, from the ages that the server reports and the time since its last event.
import { STALE_S, duration, noReport } from "./sentence.js";

const CHECK_EVERY_MS = 200;
// A picture may lack the newest frame for this time in s: a machine without a graphics card draws slowly.
const PICTURE_LATE_S = 3;

export class Ages {
  // Calls `changed` several times a second, with events and without. `picture` gives the age of the picture in s.
  constructor(changed, picture = () => 0) {
    this.picture = picture;
    this.arrived = performance.now();
    this.now = null;
    setInterval(changed, CHECK_EVERY_MS);
  }

  take(now) {
    this.arrived = performance.now();
    this.now = now;
  }

  // Time since the last event of the server in s.
  get silence() {
    return (performance.now() - this.arrived) / 1000;
  }

  // Age in s of what a process reported: a field of `ages_s`; infinite where it is absent. `page` is the server too.
  of(process) {
    // The server sends an event several times a second; the page counts by itself.
    if (process === "server" || process === "page") return this.silence;
    if (process === "picture") return this.picture();
    const age = this.now?.ages_s[process];
    return age == null ? Infinity : age + this.silence;
  }

  isStale(process) {
    return this.of(process) > (process === "picture" ? PICTURE_LATE_S : STALE_S);
  }

  // Whether a process has never reported: what it would report is unknown, and nothing is wrong with it yet.
  isUnknown(process) {
    return this.of(process) === Infinity;
  }

  // Marks the parts and the single figures that show old values; the style sheet writes their age beside them: that of
  // the oldest of their sources. Before the first figures there are none.
  mark() {
    if (!this.now) return;
    for (const part of document.querySelectorAll("[data-from]")) {
      const age = Math.max(0, ...part.dataset.from.split(" ").filter((of) => this.isStale(of)).map((of) => this.of(of)));
      part.classList.toggle("stale", age > 0);
      part.classList.toggle("unknown", age === Infinity);
      const text = age === 0 ? "" : age === Infinity ? noReport(age) : `${duration(age)} old`;
      if (part.dataset.age !== text) part.dataset.age = text;
    }
  }
}

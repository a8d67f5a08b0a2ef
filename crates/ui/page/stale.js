// The age of what the page shows, from the ages that the server reports and the time since its last event.
import { STALE_S, seconds } from "./sentence.js";

const CHECK_EVERY_MS = 200;

export class Ages {
  // Calls `changed` several times a second, with events and without.
  constructor(changed) {
    this.started = this.arrived = performance.now();
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

  // Age in s of what a process reported: a field of `ages_s`; infinite where it is absent.
  of(process) {
    // The server sends an event several times a second; the page counts by itself.
    if (process === "server" || process === "page") return this.silence;
    const age = this.now?.ages_s[process];
    return age == null ? Infinity : age + this.silence;
  }

  isStale(process) {
    return this.of(process) > STALE_S;
  }

  // Marks the parts that show old values, and says how old they are.
  mark() {
    for (const part of document.querySelectorAll("[data-from]")) {
      const ages = part.dataset.from.split(" ").map((process) => this.of(process));
      const age = Math.max(...ages);
      part.classList.toggle("stale", age > STALE_S);
      const text = age <= STALE_S ? "" : age === Infinity ? "no report" : `${seconds(age)} old`;
      if ((part.dataset.age ?? "") === text) continue;
      part.dataset.age = text;
      if (part.tagName !== "SECTION") part.title = text;
    }
  }
}

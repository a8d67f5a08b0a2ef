// Keeps drawing from taking the whole machine: a slow one draws less often, and never falls behind.

const REST = 2;

export class Pace {
  constructor(least_ms) {
    this.least_ms = least_ms;
    this.next = 0;
    this.busy = false;
  }

  // Draws if it is time to; what costs long is followed by a longer rest.
  run(draw) {
    if (this.busy || document.hidden || performance.now() < this.next) return;
    this.busy = true;
    const begun = performance.now();
    draw();
    // The second frame comes once the first has been painted.
    requestAnimationFrame(() => requestAnimationFrame(() => {
      const now = performance.now();
      this.next = Math.max(begun + this.least_ms, now + REST * (now - begun));
      this.busy = false;
    }));
  }

  // The next draw is due at once.
  hurry() {
    this.next = 0;
  }
}

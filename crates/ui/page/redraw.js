// Limits the redraw rate: a slow machine draws less often instead of falling behind.

// Pause after a draw, as a multiple of its duration.
export const PAUSE = 2;

export class RedrawLimiter {
  constructor(interval_ms) {
    this.interval_ms = interval_ms;
    this.next = 0;
    this.busy = false;
  }

  // Draws if the next draw is due; a long draw is followed by a longer pause.
  run(draw) {
    if (this.busy || document.hidden || performance.now() < this.next) return;
    this.busy = true;
    const start = performance.now();
    draw();
    // The second callback runs after the first frame was painted.
    requestAnimationFrame(() => requestAnimationFrame(() => {
      const now = performance.now();
      this.next = Math.max(start + this.interval_ms, now + PAUSE * (now - start));
      this.busy = false;
    }));
  }

  // Makes the next draw due immediately.
  reset() {
    this.next = 0;
  }
}

// The connection to the server: events, and a reload when another server or another room answers.
import { Stream } from "./stream.js";

export class Live {
  // `handlers` has `figures`, `frame`, `log`, `ended` (a sentence), `mode` ("live" or "polled") and `problem`, a text of the server.
  constructor(page, handlers) {
    this.page = page;
    this.handlers = handlers;
    this.isReached = false;
    if (typeof SharedWorker === "function") this.share();
    else this.own();
  }

  // One stream for all tabs of this page.
  share() {
    const worker = new SharedWorker("worker.js", { type: "module" });
    // Without the worker, for example because the browser cannot load it, the tab has a stream of its own.
    worker.onerror = () => { if (!this.isReached) this.own(); };
    worker.port.onmessage = ({ data }) => {
      document.documentElement.dataset.stream = "shared";
      this.take(data.kind, data.text);
    };
    addEventListener("pageshow", () => worker.port.postMessage("here"));
    addEventListener("pagehide", () => worker.port.postMessage("gone"));
    worker.port.postMessage("here");
  }

  // A stream of this tab alone.
  own() {
    document.documentElement.dataset.stream = "own";
    new Stream((kind, text) => this.take(kind, text));
  }

  take(kind, text) {
    this.isReached = true;
    if (kind === "figures") this.figures(JSON.parse(text));
    else if (["frame", "log", "ended"].includes(kind)) this.handlers[kind](JSON.parse(text));
    else this.handlers[kind](text);
  }

  figures(now) {
    // Plan, policies and past rates belong to another server or room.
    if (now.page !== this.page) location.reload();
    else this.handlers.figures(now);
  }
}

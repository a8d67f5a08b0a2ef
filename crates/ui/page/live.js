// The connection to the server: events, and a reload when another server or another room answers.

const RETRY_MS = 1000;

export class Live {
  constructor(page, handlers) {
    this.page = page;
    this.handlers = handlers;
    this.open();
  }

  open() {
    this.source = new EventSource("/live");
    this.source.addEventListener("figures", (event) => {
      const now = JSON.parse(event.data);
      // Plan, policies and past rates belong to another server or room.
      if (now.page !== this.page) {
        this.source.close();
        location.reload();
        return;
      }
      this.handlers.figures(now);
    });
    this.source.addEventListener("frame", (event) => this.handlers.frame(JSON.parse(event.data)));
    // A browser does not retry after every error.
    this.source.addEventListener("error", () => {
      if (this.source.readyState !== EventSource.CLOSED) return;
      setTimeout(() => this.open(), RETRY_MS);
    });
  }
}

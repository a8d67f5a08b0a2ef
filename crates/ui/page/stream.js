// The stream of events of one server, for all tabs of its page in this browser: `worker.js` holds one for them,
// or the page has its own where the browser has no shared workers.
//
// A browser opens few connections to one host, six in HTTP/1.1, and a stream holds one of them. Rooms below the
// paths of one site share them too. So at most `STREAMS_MAX` streams are open for a host; further rooms are polled,
// and orders always find a free connection.

import { ask, refusalIn } from "./requests.js";

const RETRY_MS = 1000;
const POLL_MS = 400;
// A poll without an answer ends after this time.
const POLL_LIMIT_MS = 4000;
const STREAMS_MAX = 3;
// The pages of this host answer within this time; of a busy browser they may answer later.
const COUNT_MS = 150;
// How often a polled room looks for a free place.
const RECOUNT_POLLS = 20;

export class Stream {
  // `deliver` gets the kind and the text of each event: "figures", "frame", "log", "ended", "mode" ("live" or "polled"), or "problem".
  constructor(deliver) {
    this.deliver = deliver;
    this.others = new BroadcastChannel("heliostat-streams");
    this.others.onmessage = ({ data }) => this.answer(data);
    this.open();
  }

  async open() {
    if (await this.countOthers() < STREAMS_MAX) this.stream();
    else this.poll(1);
  }

  // The number of streams that come before this one: a page that has counted earlier comes first.
  async countOthers() {
    this.id = `${Date.now()}-${Math.random()}`;
    this.holders = new Set();
    this.isCounting = true;
    this.others.postMessage({ asks: this.id });
    await new Promise((resolve) => setTimeout(resolve, COUNT_MS));
    this.isCounting = false;
    return this.holders.size;
  }

  answer({ asks, holds, to }) {
    const isHeld = this.isStreaming || this.isCounting;
    if (isHeld && this.id < asks) this.others.postMessage({ holds: this.id, to: asks });
    if (to !== this.id) return;
    this.holders.add(holds);
    if (this.isStreaming && this.holders.size >= STREAMS_MAX) this.giveUp();
  }

  // The answers of other pages came after the stream was opened.
  giveUp() {
    this.isStreaming = false;
    this.source.close();
    this.poll(1);
  }

  stream() {
    this.isStreaming = true;
    this.source = new EventSource("live");
    this.deliver("mode", "live");
    for (const kind of ["figures", "frame", "log", "ended"]) this.source.addEventListener(kind, (event) => this.deliver(kind, event.data));
    // A browser does not retry after every error.
    this.source.addEventListener("error", async () => {
      if (this.source.readyState !== EventSource.CLOSED) return;
      await this.fetch();
      setTimeout(() => this.isStreaming && this.stream(), RETRY_MS);
    });
  }

  // The newest events, or why the server refuses them.
  async fetch() {
    try {
      const answer = await ask("events.json", POLL_LIMIT_MS);
      if (!answer.ok) {
        this.deliver("problem", await refusalIn(answer));
        return;
      }
      for (const [kind, event] of Object.entries(await answer.json())) this.deliver(kind, JSON.stringify(event));
    } catch {
      // There is no connection; the page says so.
    }
  }

  async poll(count) {
    this.deliver("mode", "polled");
    await this.fetch();
    const isDue = count % RECOUNT_POLLS === 0;
    setTimeout(() => (isDue ? this.open() : this.poll(count + 1)), POLL_MS);
  }
}

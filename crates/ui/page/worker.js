// A worker that all tabs of this page share: one stream for them. It ends with the last of them.
import { Stream } from "./stream.js";

const tabs = new Set();
// The newest of the events that are sent on a change only, for a tab that comes later.
const last = new Map();
let stream = null;

function deliver(kind, text) {
  if (kind === "mode" || kind === "log") last.set(kind, text);
  for (const port of tabs) port.postMessage({ kind, text });
}

onconnect = ({ ports: [port] }) => {
  port.onmessage = ({ data }) => {
    if (data === "gone") tabs.delete(port);
    else tabs.add(port);
    stream ??= new Stream(deliver);
  };
  for (const [kind, text] of last) port.postMessage({ kind, text });
};

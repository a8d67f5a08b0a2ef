// A worker that all tabs of this page share: one stream for them. It ends with the last of them.
import { Stream } from "./stream.js";

const tabs = new Set();
let stream = null;
let mode = null;

function deliver(kind, text) {
  if (kind === "mode") mode = text;
  for (const port of tabs) port.postMessage({ kind, text });
}

onconnect = ({ ports: [port] }) => {
  port.onmessage = ({ data }) => {
    if (data === "gone") tabs.delete(port);
    else tabs.add(port);
    stream ??= new Stream(deliver);
  };
  if (mode) port.postMessage({ kind: "mode", text: mode });
};

// Requests to the server of the page. Where one fails, the page says in its own words what is wrong; those of the
// browser go to its console.

// What to do without an answer of the server.
export const CHECK_SERVER = "check that `heliostat ui` or `heliostat demo` still runs, and that this computer reaches it";

// No answer of the server; its message says why.
export class Unanswered extends Error {}

// A refusal of the server; its message is that of the server, which says what to do.
export class Refused extends Error {}

// The answer to a request, within a time in ms.
export async function ask(path, limit_ms, options = {}) {
  try {
    return await fetch(path, { ...options, signal: AbortSignal.timeout(limit_ms) });
  } catch (error) {
    console.info(error);
    throw new Unanswered(reasonOf(error, limit_ms));
  }
}

// What the server says in a refusal. A text of another program between, such as a proxy, is no answer of the server.
export async function refusalIn(answer) {
  const isOfServer = answer.headers.get("content-type")?.startsWith("text/plain") && ![502, 504].includes(answer.status);
  if (!isOfServer) throw ofProxy(answer);
  try {
    return await answer.text();
  } catch (error) {
    console.info(error);
    throw new Unanswered("the answer of the server broke off");
  }
}

// That the server has taken an order. Any other success is that of a program between, such as the login page of a proxy.
export function expectTaken(answer) {
  const isOfServer = answer.status === 202 && answer.headers.get("content-type")?.startsWith("application/json");
  if (!isOfServer) throw ofProxy(answer);
}

const ofProxy = ({ status }) => new Unanswered(`a proxy before the server answers with status ${status}`);

// Why a request has no answer.
function reasonOf(error, limit_ms) {
  return error.name === "TimeoutError" ? `no answer of the server within ${limit_ms / 1000} s` : "the server of this page cannot be reached";
}

// The API with the key of this tab; problems (RFC 9457) become errors with their detail.

const ROOT = "api/v1";
const KEY = "ambit-key";

export class Problem extends Error {
  constructor(status, body) {
    super((body && (body.detail || body.title)) || (status ? "the service answered " + status : "the service does not answer"));
    this.status = status; // 0: there was no answer
  }

  // Whether the same request may be answered in a while: a service restarts, a network is away.
  get passing() {
    return this.status === 0 || this.status === 429 || this.status >= 500;
  }
}

export function key() {
  return sessionStorage.getItem(KEY);
}

export function useKey(text) {
  if (text) sessionStorage.setItem(KEY, text);
  else sessionStorage.removeItem(KEY);
}

function headers(more) {
  return key() ? { ...more, Authorization: "Bearer " + key() } : { ...more };
}

// Of one wish; crypto.randomUUID is only where a context is secure, and over plain HTTP on a network none is.
function newId() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

// What a browser says of a network, each in its own words, is that nobody answered.
function unanswered(error) {
  throw error.name === "AbortError" ? error : new Problem(0);
}

async function answer(path, options) {
  const response = await fetch(path, options).catch(unanswered);
  if (response.ok) return response;
  let body = null;
  try { body = await response.json(); } catch { /* not ours: the status says enough */ }
  throw new Problem(response.status, body);
}

export async function get(path, signal) {
  const response = await answer(ROOT + path, { headers: headers(), signal });
  return response.json().catch(unanswered);
}

export async function post(path, body) {
  const more = body === undefined ? {} : { "Content-Type": "application/json", "Idempotency-Key": newId() };
  const response = await answer(ROOT + path, {
    method: "POST",
    headers: headers(more),
    body: body === undefined ? undefined : JSON.stringify(body),
  });
  return response.status === 204 ? null : response.json();
}

export async function version() {
  return (await answer("readyz", {}).catch(() => null))?.json();
}

// A document for a person: a link where the browser may fetch it, a download where a key has to be shown.
export function documentLink(path, text, name, context) {
  const link = document.createElement("a");
  link.textContent = text;
  link.href = ROOT + path;
  if (!key()) {
    link.target = "_blank";
    link.rel = "noopener";
    return link;
  }
  const download = async () => {
    const response = await answer(ROOT + path, { headers: headers() });
    const address = URL.createObjectURL(await response.blob().catch(unanswered));
    const file = Object.assign(document.createElement("a"), { href: address, download: name });
    file.click();
    setTimeout(() => URL.revokeObjectURL(address), 10000);
  };
  link.addEventListener("click", (event) => {
    event.preventDefault();
    context.doing(download);
  });
  return link;
}

// Server-sent events by fetch, which can show a key; comes back after a break, with the last id. Whoever looks is told of a
// break, and of what ends it all: what was heard last is by then no longer so.
export async function events(path, heard, context) {
  const signal = context.signal;
  let last = null;
  let pause = 500;
  while (!signal.aborted) {
    try {
      const more = last === null ? {} : { "Last-Event-ID": last };
      const response = await answer(ROOT + path, { headers: headers({ Accept: "text/event-stream", ...more }), signal });
      pause = 500;
      context.back();
      for await (const event of parsed(response.body)) {
        if (event.id !== null) last = event.id;
        const data = JSON.parse(event.data);
        heard(data, event.type);
        if (["done", "failed", "cancelled"].includes(data.state)) return;
      }
    } catch (error) {
      if (signal.aborted) return;
      if (error instanceof Problem && !error.passing) {
        context.told(error);
        return;
      }
      if (error instanceof Problem) context.away(error);
    }
    await new Promise((go) => setTimeout(go, pause));
    pause = Math.min(2 * pause, 10000);
  }
}

async function* parsed(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value.replaceAll("\r\n", "\n");
    let end;
    while ((end = text.indexOf("\n\n")) >= 0) {
      const event = { type: "message", data: "", id: null };
      for (const line of text.slice(0, end).split("\n")) {
        const colon = line.indexOf(":");
        if (colon <= 0) continue;
        const field = line.slice(0, colon);
        const content = line.slice(colon + 1).replace(/^ /, "");
        if (field === "data") event.data += (event.data ? "\n" : "") + content;
        else if (field === "event") event.type = content;
        else if (field === "id") event.id = content;
      }
      text = text.slice(end + 2);
      if (event.data) yield event;
    }
  }
}

// Elements from text only: nothing that the service says is ever read as HTML.

export function h(tag, attributes, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (name === "width") element.style.width = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  for (const child of children.flat(3)) {
    if (child === null || child === undefined) continue;
    element.append(child instanceof Node ? child : document.createTextNode(String(child)));
  }
  return element;
}

// Draws anew what differs. What stays is left in its place: it keeps the focus, and a click that is under way.
export function renew(place, made) {
  const old = [...place.childNodes];
  made.forEach((node, k) => {
    const was = old[k];
    if (!was) place.append(node);
    else if (was.isEqualNode(node)) return;
    else if (was.nodeType === Node.ELEMENT_NODE && was.cloneNode(false).isEqualNode(node.cloneNode(false))) renew(was, [...node.childNodes]);
    else was.replaceWith(node);
  });
  old.slice(made.length).forEach((node) => node.remove());
}

export function table(heads, rows, numbers = []) {
  const kind = (k) => (numbers.includes(k) ? { class: "n" } : {});
  return h("div", { class: "scroll" }, h("table", {},
    h("thead", {}, h("tr", {}, heads.map((text, k) => h("th", kind(k), text)))),
    h("tbody", {}, rows.map((cells) => h("tr", {}, cells.map((cell, k) => h("td", kind(k), cell)))))));
}

export function state(text) {
  return h("span", { class: "state " + text }, text);
}

export function section(title, ...children) {
  return h("section", {}, h("h2", {}, title), children);
}

export function nothing(text) {
  return h("p", { class: "empty" }, text);
}

// A time on this machine's clock, in one order of day and month for every reader.
export function when(iso) {
  if (!iso) return "–";
  const date = new Date(iso);
  const two = (n) => String(n).padStart(2, "0");
  const day = date.getFullYear() + "-" + two(date.getMonth() + 1) + "-" + two(date.getDate());
  return h("time", { datetime: iso, title: iso }, day + " " + two(date.getHours()) + ":" + two(date.getMinutes()));
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "";
  const s = Math.round(seconds);
  if (s < 60) return s + " s";
  if (s < 3600) return Math.floor(s / 60) + " min " + String(s % 60).padStart(2, "0") + " s";
  return Math.floor(s / 3600) + " h " + String(Math.floor((s % 3600) / 60)).padStart(2, "0") + " min";
}

// A value with as many digits as its standard deviation allows.
export function figures(value, std) {
  if (value === null || value === undefined) return "–";
  if (!(std > 0)) return number(value);
  const digits = 1 - Math.floor(Math.log10(std));
  if (digits <= 0) {
    const step = 10 ** -digits;
    return fixed(Math.round(value / step) * step, 0) + " ± " + (Math.round(std / step) * step).toFixed(0);
  }
  return fixed(value, Math.min(digits, 12)) + " ± " + std.toFixed(Math.min(digits, 12));
}

// A value with fixed digits; what rounds to nought has no sign.
export function fixed(value, digits) {
  const shown = value.toFixed(digits);
  return Number(shown) === 0 ? shown.replace("-", "") : shown;
}

// What a person is told of a campaign's phase, as terminals and reports say it.
const PHASES = { preliminary: "coarse sweep", main: "main sweep", validation: "unseen sweep", amplifier: "amplifier sweep" };

export function phase(name) {
  return PHASES[name] || name;
}

export function number(value, digits = 5) {
  return value === null || value === undefined ? "–" : String(Number(value.toPrecision(digits)));
}

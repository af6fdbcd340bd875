// The page: a view by the address's hash, fetched anew when it changes, stopped when it is left.

import { get, key, Problem, useKey, version } from "./api.js";
import { h, nothing, section, state, table, when } from "./dom.js";
import { rig } from "./rig.js";
import * as tables from "./tables.js";

const view = document.getElementById("view");
const problem = document.getElementById("problem");
const form = document.getElementById("key");
let current = null;
let about = ""; // what the problem is of that is told: PASSING, ASKED, or what was read

const PASSING = "passing"; // over with the next answer
const ASKED = "asked"; // of what a person asked for: no page that is refreshed beneath it takes it away
const AGAIN = "; this page asks again by itself";

class Context {
  constructor() {
    this.controller = new AbortController();
    this.signal = this.controller.signal;
    this.timers = [];
    this.later = [];
  }

  every(ms, what) {
    this.timers.push(setInterval(() => { if (!document.hidden && !view.querySelector("button:active, a:active")) what(); }, ms));
  }

  then(what) {
    this.later.push(what);
  }

  refresh = () => { if (!this.signal.aborted) show(); };

  // What a person asked for. Without an answer nobody knows, and it stays told when the service is back.
  doing = (what) => what().then(() => told(null), (error) => told(error, error.status === 0 ? "; what was asked for may not be done" : "", ASKED));

  told = told;

  // What the page asks again by itself is told where nothing else is, until it is answered.
  away = (error) => { if (problem.hidden) told(error, AGAIN, PASSING); };

  back = () => { if (about === PASSING) told(null); };

  end() {
    this.controller.abort();
    this.timers.forEach(clearInterval);
  }
}

function told(error, more = "", what = "") {
  if (error && error.name === "AbortError") return;
  about = error ? what : "";
  problem.hidden = !error;
  problem.textContent = error ? error.message + more : "";
  if (error instanceof Problem && error.status === 401) form.hidden = false;
}

const BUSY_MS = 5000; // while a job waits or runs,
const IDLE_MS = 30000; // and while none does: a schedule may begin one
const TOLD = 3; // of what drifted, as in the sentence of a check

async function overview(context) {
  const [rigs, newest, running, checks, failures] = await Promise.all([
    get("/rigs?limit=1000", context.signal), get("/jobs?limit=15", context.signal),
    get("/jobs?state=running&limit=15", context.signal), get("/health-checks?newest=true&limit=1000", context.signal),
    get("/jobs?kind=health&state=failed&newest=true&limit=1000", context.signal),
  ]);
  const jobs = newest.items.concat(running.items.filter((job) => !newest.items.some((shown) => shown.id === job.id)));
  context.every(jobs.some(tables.active) ? BUSY_MS : IDLE_MS, context.refresh);
  const names = new Map(rigs.items.map((r) => [r.id, r.name]));
  const latest = new Map(checks.items.map((check) => [check.rig, check]));
  const failed = new Map(failures.items.map((job) => [job.rig, job]));
  const rows = rigs.items.map((r) => [
    h("a", { href: "#/rig/" + r.id }, r.name), health(latest.get(r.id), failed.get(r.id)), r.axes.join(" "), r.controller_url || "no controller",
  ]);
  return [
    section("Rigs", rigs.items.length ? table(["rig", "health", "axes", "controller"], rows) : nothing("No rigs yet: POST /api/v1/rigs with a datasheet.")),
    section("Jobs", tables.jobs(jobs, names, context), newest.next ? more("#/jobs", "All jobs") : ""),
  ];
}

function health(check, failed) {
  const known = check ? [...found(check), " ", when(check.created_at)] : ["not checked"];
  return h("div", { class: "told" }, h("div", {}, known), tables.failedCheck(check, failed));
}

function found(check) {
  if (!check.alarm) return ["zone ", state(check.zone)];
  const told = check.drifted_words.slice(0, TOLD);
  const more = check.drifted_words.length - told.length;
  return [state("alarm"), " ", told.join("; ") + (more ? " and " + more + " more" : "")];
}

// All jobs, a page at a time: "#/jobs", and "#/jobs/<id>" for those before that one.
async function history(after, context) {
  const [rigs, jobs] = await Promise.all([
    get("/rigs?retired=true&limit=1000", context.signal),
    get("/jobs?limit=100" + (after ? "&after=" + encodeURIComponent(after) : ""), context.signal),
  ]);
  if (jobs.items.some(tables.active)) context.every(BUSY_MS, context.refresh);
  const names = new Map(rigs.items.map((r) => [r.id, r.name]));
  return [section(after ? "Earlier jobs" : "All jobs", tables.jobs(jobs.items, names, context),
    jobs.next ? more("#/jobs/" + jobs.next, "Earlier jobs") : "")];
}

function more(address, text) {
  return h("p", {}, h("a", { class: "more", href: address }, text));
}

async function route(context) {
  const [kind, id] = location.hash.replace(/^#\/?/, "").split("/");
  if (kind === "rig" && id) return rig(id, context);
  if (kind === "job" && id) {
    const found = await get("/jobs/" + id, context.signal);
    const owner = await get("/rigs/" + found.rig, context.signal);
    return tables.job(found, new Map([[owner.id, owner.name]]), context);
  }
  if (kind === "jobs") return history(id, context);
  return overview(context);
}

async function show() {
  if (current) current.end();
  const context = (current = new Context());
  const left = document.documentElement.getAttribute("data-shown") !== (location.hash || "#/");
  try {
    const parts = await route(context);
    if (context.signal.aborted) return;
    const held = document.activeElement;
    const kept = view.contains(held) && held !== view;
    view.replaceChildren(...parts.filter((p) => p !== ""));
    if (kept) [...view.querySelectorAll(held.tagName)].find((same) => same.isEqualNode(held))?.focus({ preventScroll: true });
    context.later.forEach((what) => what());
    if (left || about !== ASKED) told(null);
    form.hidden = true;
    document.documentElement.setAttribute("data-shown", location.hash || "#/");
  } catch (error) {
    if (context.signal.aborted) return;
    // What stood here before is of another address; at the same one it is still the last that is known.
    if (left) view.replaceChildren();
    // What was refused stays so; anything else is asked again, or the page would stay as it is though the service is back.
    const again = !(error instanceof Problem) || error.passing;
    if (again) context.every(BUSY_MS, context.refresh);
    if (left || about !== ASKED || !again) told(error, again ? AGAIN : "");
  }
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  useKey(document.getElementById("key-text").value.trim());
  document.getElementById("key-text").value = "";
  told(null);
  show();
});
window.addEventListener("hashchange", show);
// A browser keeps a page that is left, for who comes back, and what it listens to: six of these, and no answer comes through.
window.addEventListener("pagehide", () => current?.end());
window.addEventListener("pageshow", (event) => { if (event.persisted) show(); });
version().then((found) => { document.getElementById("version").textContent = found ? "ambit " + found.version : ""; });
if (key()) form.hidden = true;
show();

// Tables of jobs, alive: each running one is watched by its events.

import { confirmed, motion } from "./confirm.js";
import { documentLink, events, get, post } from "./api.js";
import { duration, h, nothing, phase, renew, state, table, when } from "./dom.js";

const WATCHED = 3; // a browser opens six connections to a server; the page itself needs some
const ACTIVE = ["queued", "running"];
const MOVING = ["experiment", "health"];
const RETRIABLE = ["failed", "cancelled"];

export const active = (job) => ACTIVE.includes(job.state);

export function jobs(list, names, context) {
  if (!list.length) return nothing("No jobs yet.");
  const heads = ["job", "rig", "state", "progress", "submitted", "by", ""];
  const rows = list.map((job) => cells(job, names, context));
  const made = table(heads, rows);
  const lines = made.querySelectorAll("tbody tr");
  const alive = list.map((job, k) => [job, lines[k]]).filter(([job]) => active(job));
  for (const [job, line] of alive.slice(-WATCHED)) {
    events("/jobs/" + job.id + "/events", (now) => {
      renew(line, cells(now, names, context).map((cell) => h("td", {}, cell)));
      if (!active(now)) context.refresh();
    }, context);
  }
  if (alive.length > WATCHED) context.every(3000, context.refresh);
  return made;
}

function cells(job, names, context) {
  return [
    h("a", { href: "#/job/" + job.id, title: job.id }, job.kind),
    h("a", { href: "#/rig/" + job.rig }, names.get(job.rig) || job.rig),
    state(job.state),
    progress(job),
    when(job.created_at),
    job.submitted_by,
    active(job) ? cancel(job, context) : "",
  ];
}

// That a rig's newest check failed after the one that is told, and why: then nobody knows how it is by now.
export function failedCheck(check, failed) {
  if (!failed || (check && new Date(failed.ended_at) < new Date(check.created_at))) return "";
  const why = h("a", { href: "#/job/" + failed.id, title: failed.error.detail }, failed.error.title);
  return h("div", {}, "newest check ", state("failed"), ": ", why, " ", when(failed.ended_at));
}

export function progress(job) {
  if (job.state === "failed") return h("span", { title: job.error && job.error.detail }, job.error ? job.error.title : "");
  if (job.state === "done") return "in " + duration((new Date(job.ended_at) - new Date(job.started_at)) / 1000);
  if (job.state === "cancelled") return job.progress.phase.replace(/^cancelled(: )?/, ""); // why, where there is a reason
  if (job.state !== "running") return "";
  const p = job.progress;
  const left = p.time_left_s ? duration(p.time_left_s) + " left" : "";
  const points = p.points ? p.point + " of " + p.points + " points" : phase(p.phase);
  const told = [p.percent.toFixed(0) + " %", points, left].filter(Boolean).join(", "); // a job that just began has neither
  return h("span", {}, h("span", { class: "bar" }, h("i", { width: p.percent + "%" })), told);
}

function cancel(job, context) {
  const button = h("button", { class: "danger", value: job.id, disabled: job.cancel_requested }, job.cancel_requested ? "stopping" : "Cancel");
  button.addEventListener("click", () => context.doing(async () => {
    button.disabled = true; // until the job says that it stops
    await post("/jobs/" + job.id + "/cancel").catch((error) => { button.disabled = false; throw error; });
  }));
  return button;
}

function retry(job, context) {
  const button = h("button", { class: "retry" }, "Try again");
  button.addEventListener("click", () => context.doing(async () => {
    if (MOVING.includes(job.kind)) {
      const rig = await get("/rigs/" + job.rig, context.signal);
      if (!(await confirmed("Try the " + job.kind + " on " + rig.name + " again?", motion(job.kind, rig), rig.controller_url))) return;
    }
    button.disabled = true;
    await post("/jobs/" + job.id + "/retry").finally(() => { button.disabled = false; });
    context.refresh();
  }));
  return button;
}

export async function job(found, names, context) {
  const place = h("div", {});
  const told = h("div", {});
  const show = (now) => {
    if (now.state === "done" && now.result.gap) diagnosed(now.result.gap, told, context).catch(context.told);
    draw(now);
  };
  const draw = (now) => renew(place, [...h("div", {},
    h("p", { class: "lead " + { failed: "bad", cancelled: "warn" }[now.state] }, state(now.state), " ", progress(now)),
    now.error ? h("p", { class: "note" }, now.error.detail) : "",
    table(["", ""], [
      ["kind", now.kind],
      ["rig", h("a", { href: "#/rig/" + now.rig }, names.get(now.rig) || now.rig)],
      ["phase", phase(now.progress.phase) || "–"],
      ["submitted", h("span", {}, when(now.created_at), " by " + now.submitted_by)],
      ["started", when(now.started_at)],
      ["ended", when(now.ended_at)],
      ["result", results(now, context)],
    ]),
    active(now) ? h("p", { class: "row" }, cancel(now, context)) : "",
    RETRIABLE.includes(now.state) ? h("p", { class: "row" }, retry(now, context)) : "",
  ).childNodes]);
  show(found);
  if (active(found)) events("/jobs/" + found.id + "/events", show, context);
  return [h("h2", {}, "Job ", h("span", { class: "small" }, found.id)), told, place];
}

async function diagnosed(id, place, context) {
  const { verdict } = await get("/gaps/" + id + "/gap.json", context.signal);
  place.replaceChildren(h("p", { class: "lead" }, verdict.sentence || verdict.kind),
    h("p", { class: "about" }, documentLink("/gaps/" + id + "/report.html", "report of the diagnosis", "gap.html", context)));
}

function results(now, context) {
  const paths = {
    experiment: (id) => ["/experiments/" + id + "/file", "experiment.h5"],
    model: (id) => ["/models/" + id + "/report.html", "report.html"],
    gap: (id) => ["/gaps/" + id + "/report.html", "gap.html"],
    health: (id) => ["/health-checks/" + id + "/report.html", "health.html"],
  };
  const links = Object.entries(now.result || {}).filter(([kind]) => paths[kind]).map(([kind, id]) => {
    const [path, name] = paths[kind](id);
    return [documentLink(path, kind, name, context), " "];
  });
  return links.length ? h("span", {}, links) : "–";
}

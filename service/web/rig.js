// One rig: what it does now, what it is, where its twin falls short, how it ages.

import { documentLink, get, post } from "./api.js";
import { confirmed, motion } from "./confirm.js";
import { figures, fixed, h, nothing, number, renew, section, state, table, when } from "./dom.js";
import * as plots from "./plots.js";
import * as tables from "./tables.js";

export async function rig(id, context) {
  const signal = context.signal;
  const of = "?rig=" + encodeURIComponent(id);
  const [found, jobs, models, gaps, checks, trend, schedules, experiments, failures] = await Promise.all([
    get("/rigs/" + id, signal), get("/jobs" + of + "&limit=10", signal), get("/models" + of + "&newest=true", signal),
    get("/gaps" + of + "&newest=true", signal), get("/health-checks" + of + "&newest=true", signal),
    get("/rigs/" + id + "/trend", signal), get("/schedules" + of + "&limit=20", signal),
    get("/experiments" + of + "&purpose=commissioning&complete=true&limit=1", signal), get("/jobs" + of + "&kind=health&state=failed&newest=true", signal),
  ]);
  const names = new Map([[id, found.name]]);
  return [
    h("h2", {}, found.name, " ", h("span", { class: "small" }, "version " + found.version + (found.retired_at ? ", retired" : ""))),
    found.note ? h("p", {}, found.note) : "",
    live(found, context),
    actions(found, context),
    section("Jobs", tables.jobs(jobs.items, names, context)),
    section("Model", ...(await model(models.items[0], context))),
    section("Gap between rig and twin", ...(await gap(gaps.items[0], context)), diagnose(found, experiments.items[0], context)),
    section("Health", tables.failedCheck(checks.items[0], failures.items[0]), ...health(checks.items[0], trend, context)),
    section("Schedules", ...(await schedule(schedules.items, context))),
  ];
}

function live(found, context) {
  const place = h("div", { id: "live" });
  if (!found.controller_url) return nothing("This rig has no controller: experiments are uploaded.");
  let now = null;
  const show = async () => {
    now = await get("/rigs/" + found.id + "/status", context.signal).catch((error) => error);
    if (context.signal.aborted) return;
    if (now instanceof Error) { // of the service: of the controller nothing is known
      place.replaceChildren(h("p", { class: "note" }, "What it does now is not known: " + now.message));
      if (now.status === 401) context.told(now);
      return;
    }
    if (!now.reachable) {
      place.replaceChildren(h("p", { class: "note" }, "The controller does not answer: " + now.detail));
      return;
    }
    const by = (values, scale, digits) => !values ? "–" : values.map((x, k) => h("span", { class: "axis" }, h("i", {}, found.axes[k]), " " + fixed(scale * x, digits)));
    const figures = [
      ["state", state(now.state === "done" ? "levitated" : now.state)], ["moved by", now.lease_holder || "nobody"],
      ["excitation, A", number(now.excitation_a, 3)], ["speed, rad/s", number(now.speed_rad_s, 4)],
      ["displacements, µm", by(now.displacement_m, 1e6, 2)], ["currents, A", by(now.current_a, 1, 3)],
    ];
    renew(place, [...h("div", {}, h("dl", {}, figures.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value)))),
      now.trip_message ? h("p", { class: "note" }, now.trip_message) : "",
      now.state === "tripped" && !found.retired_at ? h("button", { class: "acknowledge", onclick: () => acknowledge(found, now, context)() }, "Acknowledge the trip") : "").childNodes]);
  };
  show();
  context.every(2000, show);
  return place;
}

const submit = (kind, about, context) => () => context.doing(async () => {
  const job = await post("/jobs", { kind, ...about });
  location.hash = "#/job/" + job.id;
});

const PROFILES = { standard: "standard, some 20 min for four axes", quick: "quick, a third of the time and of the accuracy" };

// A job that moves the rotor, once somebody has said so.
const move = (kind, title, profiles, found, context) => async () => {
  const options = await confirmed(title + " " + found.name + "?", motion(kind, found), found.controller_url, profiles);
  if (options) await submit(kind, { rig: found.id, options }, context)();
};

// Nothing moves by it, but whoever submits a job may move the rotor again.
const acknowledge = (found, now, context) => async () => {
  const words = ["It tripped: " + (now.trip_message || now.trip) + ".", "Jobs may excite the rotor again. Is the cause found?"];
  const sure = await confirmed("Acknowledge the trip of " + found.name + "?", words, found.controller_url, null, "Acknowledge");
  if (sure) await context.doing(() => post("/rigs/" + found.id + "/acknowledge"));
};

function actions(found, context) {
  if (!found.controller_url || found.retired_at) return "";
  return h("p", { class: "row" },
    h("button", { class: "commission", onclick: move("experiment", "Commission", PROFILES, found, context) }, "Commission"),
    h("button", { class: "check", onclick: move("health", "Check the health of", null, found, context) }, "Check health"),
    h("button", { class: "danger", onclick: () => context.doing(() => post("/rigs/" + found.id + "/stop")) }, "Stop the excitation"));
}

async function model(found, context) {
  if (!found) return [nothing("No model yet: commission the rig, or upload an experiment and identify it.")];
  const response = await get("/models/" + found.id + "/frequency-response", context.signal);
  const planes = Object.keys(found.summary.planes);
  const rows = new Map();
  const put = (name, plane, value, nominal = "") => {
    if (!rows.has(name)) rows.set(name, [name, ...planes.map(() => "–"), nominal]);
    rows.get(name)[1 + planes.indexOf(plane)] = value;
  };
  const each = (what) => planes.forEach((plane) => what(plane, found.summary.planes[plane]));
  each((plane, p) => {
    for (const [name, e] of Object.entries(p.stiffness)) put(name + ", " + e.unit, plane, figures(e.value, e.std), number(e.nominal, 7));
  });
  each((plane, p) => p.modes.forEach((m, k) => { // planes may differ in how many they have
    const w = m.natural_frequency_rad_s, z = m.damping_ratio;
    put("wn" + (k + 1) + ", rad/s", plane, figures(w.value, w.std));
    put("zeta" + (k + 1), plane, figures(z.value, z.std));
  }));
  each((plane, p) => {
    const peaks = Object.values(p.sensitivity_peak || {}).map((v) => v.toFixed(2)).join(" / ");
    put("sensitivity peak A / B, zone", plane, h("span", {}, peaks + ", ", state(p.iso_14839_3_zone)));
  });
  const place = h("div", { class: "plot bode", id: "bode" });
  const entries = Object.entries(response).flatMap(([plane, p]) => p.axes.flatMap((out, a) => p.axes.map((source, b) => [plane, a, b, "y " + out + " / u " + source])));
  const choice = h("select", { id: "entry" }, entries.map((e, k) => h("option", { value: k }, e[3])));
  const show = () => {
    const [plane, a, b] = entries[choice.value || 0];
    plots.bode(place, response[plane], a, b);
  };
  choice.addEventListener("change", show);
  context.then(show);
  const path = "/models/" + found.id;
  const notes = (found.summary.warnings || []).concat(...planes.map((plane) => (found.summary.planes[plane].warnings || []).map((text) => plane + "-plane: " + text)));
  return [
    found.summary.sentence ? h("p", { class: "lead " + (found.summary.tone || "") }, found.summary.sentence) : "",
    notes.length ? h("details", { class: "notes" }, h("summary", {}, notes.length === 1 ? "1 note" : notes.length + " notes"), h("ul", {}, notes.map((text) => h("li", {}, text)))) : "",
    h("p", { class: "about" }, "Identified ", when(found.created_at), " · ", documentLink(path + "/report.html", "report", "report.html", context), " · ",
      documentLink(path + "/result.json", "result.json", "result.json", context)),
    table(["figure", ...planes.map((p) => "plane " + p), "datasheet"], [...rows.values()], [...planes.keys()].map((k) => k + 1).concat(planes.length + 1)),
    h("p", { class: "row" }, h("label", { for: "entry" }, "Response"), choice), place,
  ];
}

// Of the newest whole commissioning.
function diagnose(found, whole, context) {
  if (!whole || found.retired_at) return "";
  return h("p", { class: "row" },
    h("button", { class: "diagnose", onclick: submit("gap", { rig: found.id, experiment: whole.id }, context) }, "Diagnose the gap"),
    h("span", { class: "about" }, "of the experiment of ", when(whole.created_at)));
}

async function gap(found, context) {
  if (!found) return [nothing("Not diagnosed yet.")];
  const document = await get("/gaps/" + found.id + "/gap.json", context.signal);
  const verdict = document.verdict;
  const place = h("div", { class: "plot gap", id: "gap" });
  if (document.candidates.length) context.then(() => plots.candidates(place, document.candidates));
  const closure = found.summary.closure;
  const tone = { no_gap: "", effect: "warn", effects: "warn", none_of_these: "bad" }[verdict.kind];
  return [
    h("p", { class: "lead " + tone }, verdict.sentence || verdict.kind),
    h("p", { class: "about" }, "Diagnosed ", when(found.created_at), " · ", documentLink("/gaps/" + found.id + "/report.html", "report", "gap.html", context)),
    table(["gap before", "noise floor", "closed by what was found"], [[
      number(100 * found.summary.gap_before, 3) + " %", number(100 * found.summary.noise_floor, 3) + " %",
      closure === null || closure === undefined ? "–" : fixed(100 * closure, 0) + " %",
    ]], [0, 1, 2]),
    (document.notes || []).map((note) => h("p", { class: "note" }, note)),
    document.candidates.length ? place : "",
  ];
}

function health(found, trend, context) {
  if (!found) return [nothing("Not checked yet.")];
  const places = h("div", { class: "plots", id: "trend" });
  const once = trend.checks.length < 2;
  const [followed, unknown] = [true, false].map((yes) => Object.entries(trend.series).filter(([, s]) => plots.known(s).length > 0 === yes));
  const steady = Object.entries(trend.series).filter(([, s]) => s.drifting).map(([name]) => name);
  if (!once) context.then(() => {
    for (const [name, series] of followed) {
      const place = h("div", { class: "plot" });
      places.append(place);
      plots.trend(place, name, series);
    }
  });
  return [
    h("p", { class: "lead " + (found.alarm ? "bad" : found.zone_calm ? "" : "warn") }, found.sentence),
    h("p", { class: "about" }, "Checked ", when(found.created_at), " · " + trend.checks.length + (once ? " check · " : " checks · "),
      documentLink("/health-checks/" + found.id + "/report.html", "report", "health.html", context)),
    steady.length ? h("p", { class: "note" }, "Changes steadily: " + steady.join(", ")) : "",
    unknown.length ? h("p", { class: "note" }, "Known too badly to be followed: " + unknown.map(([name]) => name).join(", ")) : "",
    once ? only(followed) : places,
  ];
}

// One check is no trend: its changes as figures.
function only(followed) {
  const row = ([name, series]) => [
    h("span", series.drifted[0] ? { class: "state alarm" } : {}, name), figures(series.change_percent[0], plots.deviation(series, 0)),
  ];
  const planes = [...new Set(followed.map(([name]) => name.split(".")[0]))];
  return h("div", {}, h("p", { class: "about" }, "Changes since the commissioning, with one standard deviation; a trend begins with the second check."),
    h("div", { class: "side", id: "changes" }, planes.map((plane) =>
      table(["figure", "change, %"], followed.filter(([name]) => name.startsWith(plane + ".")).map(row), [1]))));
}

async function schedule(found, context) {
  if (!found.length) return [nothing("No schedule: this rig is checked when somebody asks.")];
  const runs = await Promise.all(found.map((s) => get("/schedules/" + s.id + "/runs?limit=30", context.signal)));
  const rows = found.map((s, k) => {
    const lost = runs[k].items.filter((r) => r.state !== "submitted"); // missed or refused: the rig was not checked
    const none = runs[k].items.length ? "none of the last " + runs[k].items.length : "no run yet";
    const last = lost.length ? notMade(lost[0], lost.length + " of the last " + runs[k].items.length) : none;
    return [s.cron + " " + s.timezone, s.enabled ? when(s.next_at) : "off", last, s.webhook ? s.webhook.url : ""];
  });
  return [table(["schedule", "next", "not made", "webhook"], rows)];
}

function notMade(newest, many) {
  return h("div", { class: "told" }, h("div", {}, many + ", newest ", state(newest.state), " ", when(newest.due_at)), h("div", {}, newest.detail));
}

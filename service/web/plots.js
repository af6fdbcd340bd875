// Figures in the look of the reports.
/* global Plotly */

const INK = "#1c2733", GRID = "#e4e8ec", MEASURED = "#7b8794", MODEL = "#0072b2", SECOND = "#d55e00", BAD = "#c0392b";
const REGION = "rgba(0,114,178,0.22)";
// on a narrow screen the buttons would lie over the legend, and fingers zoom by themselves
const BUTTONS = window.matchMedia("(max-width: 760px)").matches ? false : "hover";
const CONFIG = { responsive: true, displaylogo: false, displayModeBar: BUTTONS, modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]] };

function axis(more) {
  return {
    showline: true, mirror: true, linecolor: "#9aa5b1", ticks: "outside", ticklen: 4, tickcolor: "#9aa5b1",
    gridcolor: GRID, zeroline: false, ...more,
  };
}

function layout(more) {
  return {
    margin: { l: 62, r: 10, t: 30, b: 42 }, paper_bgcolor: "#fff", plot_bgcolor: "#fff",
    font: { family: "Helvetica, Arial, sans-serif", size: 12, color: INK }, hovermode: "closest", ...more,
  };
}

function draw(place, data, form, config = CONFIG) {
  Plotly.newPlot(place, data, form, config).then(() => place.setAttribute("data-drawn", "yes"));
}

const LOG_HZ = { type: "log", tickvals: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000] };

// Bode plot of one entry: measured points, model and its 99 % region.
export function bode(place, plane, out, source) {
  const traces = [];
  const entry = (response) => response.re.map((row, k) => [row[out][source], response.im[k][out][source]]);
  const size = (pairs) => pairs.map(([re, im]) => Math.hypot(re, im));
  const angle = (pairs) => pairs.map(([re, im]) => (Math.atan2(im, re) * 180) / Math.PI);
  const model = plane.model;
  const drawn = entry(model);
  const magnitude = size(drawn);
  const radius = model.std.map((row) => 2.146 * row[out][source]); // 99 % of a complex Gaussian
  const high = magnitude.map((m, k) => m + radius[k]);
  const low = magnitude.map((m, k) => Math.max(m - radius[k], 1e-3 * m));
  traces.push({
    x: [...model.frequency_hz, ...model.frequency_hz.slice().reverse()], y: [...high, ...low.slice().reverse()],
    fill: "toself", fillcolor: REGION, line: { width: 0 }, hoverinfo: "skip", name: "99 % region",
  });
  const sets = [["measured", plane.measured, MEASURED], ["unseen sweep", plane.unseen, SECOND]];
  for (const [name, response, colour] of sets) {
    if (!response) continue;
    const pairs = entry(response);
    const marker = { color: colour, size: 4 };
    traces.push({ x: response.frequency_hz, y: size(pairs), mode: "markers", name, marker });
    traces.push({ x: response.frequency_hz, y: angle(pairs), mode: "markers", yaxis: "y2", marker, showlegend: false });
  }
  const line = { color: MODEL, width: 1.4 };
  traces.push({ x: model.frequency_hz, y: magnitude, mode: "lines", name: "model", line });
  traces.push({ x: model.frequency_hz, y: angle(drawn), mode: "lines", yaxis: "y2", line, showlegend: false });
  const f = plane.measured.frequency_hz;
  draw(place, traces, layout({
    xaxis: axis({ ...LOG_HZ, anchor: "y2", title: { text: "frequency, Hz" }, range: [Math.log10(f[0]) - 0.05, Math.log10(f.at(-1)) + 0.05] }),
    yaxis: axis({ type: "log", domain: [0.42, 1], title: { text: "|y/u|, m/A" }, exponentformat: "power" }),
    yaxis2: axis({ domain: [0, 0.36], title: { text: "phase, °" }, range: [-190, 190], tickvals: [-180, -90, 0, 90, 180] }),
    legend: { orientation: "h", x: 0, y: 1.01, yanchor: "bottom" },
  }));
}

// Standard deviation of a figure's change at a check, percent: of the check and of the commissioning.
export function deviation(series, k) {
  return Math.hypot(series.std_percent[k], series.baseline_std_percent);
}

// The checks that knew the change of a figure better than by the figure itself.
export function known(series) {
  return [...series.std_percent.keys()].filter((k) => deviation(series, k) < 100);
}

// Change of one figure over the checks, percent, with one standard deviation.
export function trend(place, name, series) {
  const shown = known(series);
  const of = (values) => shown.map((k) => values[k]);
  const marker = { color: of(series.drifted).map((d) => (d ? BAD : MODEL)), size: 5 };
  draw(place, [{
    x: of(series.at), y: of(series.change_percent), mode: "markers", marker,
    error_y: { type: "data", array: shown.map((k) => deviation(series, k)), thickness: 1, width: 0, color: "#9aa5b1" },
  }], layout({
    title: { text: name, font: { size: 12 }, x: 0.02, y: 0.97 }, margin: { l: 20, r: 10, t: 24, b: 40 }, showlegend: false,
    xaxis: axis({ type: "date", nticks: 3 }),
    yaxis: axis({ nticks: 5, ticksuffix: " %", exponentformat: "none", automargin: true }),
    shapes: [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: 0, y1: 0, line: { color: "#9aa5b1", width: 1, dash: "dot" } }],
  }), { responsive: true, displayModeBar: false });
}

// Explanations of a gap by their probability.
export function candidates(place, found) {
  const shown = found.slice(0, 6).reverse();
  draw(place, [{
    type: "bar", orientation: "h", y: shown.map((c) => c.effect.replaceAll("_", " ").replaceAll("+", " + ")), x: shown.map((c) => 100 * c.probability),
    marker: { color: MODEL }, hovertemplate: "%{x:.1f} %<extra></extra>",
  }], layout({
    margin: { l: 20, r: 14, t: 8, b: 40 }, showlegend: false,
    xaxis: axis({ range: [0, 100], title: { text: "probability, %" } }), yaxis: axis({ gridcolor: "#fff", automargin: true }),
  }));
}

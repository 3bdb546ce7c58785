/** The response in figures: the summary, timings, one anchor over time, and the table of the best. */

import { anchorColour } from "./drawing.js";
import { byId, figure, make, makeSvg } from "./dom.js";

const MAX_ROWS = 10;
const STAGES = { queue: "queue", encode: "encode", sample: "sample", refine: "refine", rest: "transfer, drawing" };

/** Size of a chart in the units of its drawing. */
const [WIDTH, HEIGHT, TOP] = [300, 72, 18];
/** 1/m; a sharper turn is as good as turning on the spot. */
const MAX_CURVATURE = 4;

const LENGTH = { name: "Length", unit: "m", value: (anchors, n) => anchors.length(n) };
const SCORE = { name: "Score", unit: "", value: ({ scores }, n) => scores[n], all: ({ scores }) => scores };
const CLEARANCE = { name: "Clear", unit: "m", value: ({ clearance }, n) => clearance[n] };
const DURATION = { name: "Lasts", unit: "s", value: (anchors, n) => anchors.duration(n) };
const TOP_SPEED = { name: "Top", unit: "m/s", value: (anchors, n) => anchors.greatest(anchors.speeds, n) };

/** The columns that a response can fill; `path` are those about the way of an anchor. */
export function columnsOf({ scores, clearance, speeds, hasOwnTime }, path = [LENGTH]) {
  return [scores && SCORE, clearance && CLEARANCE, ...path, hasOwnTime && DURATION, speeds && TOP_SPEED].filter(Boolean);
}

/** Name the anchor that the figures are about: the one in focus, or the best. */
export function nameAnchor(anchors, focus) {
  const { best, safe, scores } = anchors;
  const n = focus ?? best;
  byId("anchor-name").textContent = focus === null ? "Best anchor" : `Anchor ${focus}`;
  const words = [scores && `score ${figure(scores[n], 2, scores)}`, `${anchors.duration(n).toFixed(1)} s`];
  byId("anchor-figures").textContent = safe[n] ? words.filter(Boolean).join(", ") : "not safe";
}

/** Set the summary. An unchanged text is not set again, or screen readers would repeat it. */
export function say(text) {
  if (byId("summary").textContent !== text) byId("summary").textContent = text;
}

/** Remove the figures of the last response. */
export function clearFigures() {
  for (const id of ["summary", "anchor-figures", "times", "times-key", "round-trip", "charts", "poses"]) byId(id).replaceChildren();
  byId("times").removeAttribute("aria-label");
  byId("anchor-name").textContent = "Best anchor";
  const table = byId("best");
  delete table.dataset.columns;
  table.tHead.rows[0].replaceChildren();
  table.tBodies[0].replaceChildren();
  fadeFigures(false);
}

/** Fade the figures while they do not belong to the current request. */
export function fadeFigures(isStale) {
  byId("layout").toggleAttribute("data-stale", isStale);
}

/** Show the stages of `timing` and the rest of `screenMs`, all in ms. */
export function showTimes(timing, screenMs) {
  const times = { ...timing, rest: Math.max(0, screenMs - timing.total) };
  const stages = Object.keys(STAGES).filter((stage) => stage in times);
  const sum = stages.reduce((total, stage) => total + times[stage], 0) || 1;
  const mark = (stage) => {
    const element = make("i");
    element.dataset.stage = stage;
    return element;
  };
  byId("times").replaceChildren(...stages.map((stage) => {
    const bar = mark(stage);
    bar.style.width = `${(100 * times[stage]) / sum}%`;
    return bar;
  }));
  byId("times").setAttribute("aria-label", stages.map((stage) => `${STAGES[stage]} ${milliseconds(times[stage])}`).join(", "));
  byId("times-key").replaceChildren(...stages.map((stage) => {
    return make("li", {}, mark(stage), `${STAGES[stage]} `, make("b", {}, milliseconds(times[stage])));
  }));
  byId("round-trip").textContent = `on screen in ${milliseconds(screenMs)}`;
}

const milliseconds = (ms) => `${ms < 9.95 ? ms.toFixed(1) : ms.toFixed(0)} ms`;

/** A heading of a table with its unit. */
export function heading({ name, unit }) {
  return make("th", { scope: "col" }, name, ...(unit ? [make("span", { className: "unit" }, unit)] : []));
}

/** Who gets onLook(n), null for none, and onKeep(n) from the rows: the view that filled the table last. */
let listeners = {};

/**
 * Fill the table of the best anchors. `columns` are {name, unit, value(anchors, n), all(anchors)};
 * `all` is missing for values that are never tiny.
 */
export function showBest(surface, anchors, { columns, focus, ...callbacks }) {
  listeners = callbacks;
  const body = bodyFor(columns);
  const best = anchors.order.slice(0, MAX_ROWS);
  byId("best-name").textContent = anchors.count > MAX_ROWS ? "Ten best" : anchors.count > 1 ? "All anchors" : "The anchor";
  while (body.rows.length > best.length) body.rows[body.rows.length - 1].remove();
  best.forEach((n, place) => {
    const row = body.rows[place] ?? newRow(body, columns.length);
    row.dataset.anchor = n;
    row.className = anchors.safe[n] ? "" : "unsafe";
    row.setAttribute("aria-current", n === focus);
    columns.forEach(({ value, all }, k) => { row.cells[k + 1].textContent = figure(value(anchors, n), 2, all?.(anchors)); });
    const button = row.cells[0].firstChild;
    button.lastChild.data = `${n}`;
    button.setAttribute("aria-label", `Anchor ${n}${anchors.safe[n] ? "" : ", not safe"}`);
    button.firstChild.style.setProperty("--tone", anchorColour(surface, anchors, surface.show.colourBy, n));
  });
}

/** The body of the table, empty if its columns have changed. */
function bodyFor(columns) {
  const table = byId("best");
  const names = columns.map(({ name }) => name).join();
  if (table.dataset.columns !== names) {
    table.dataset.columns = names;
    table.tHead.rows[0].replaceChildren(...[{ name: "Anchor" }, ...columns].map(heading));
    table.tBodies[0].replaceChildren();
  }
  return table.tBodies[0];
}

/** Rows are filled again with every response, so that the focus stays where it is. */
function newRow(body, columns) {
  const row = body.insertRow();
  const button = make("button", { type: "button" }, make("i"), document.createTextNode(""));
  row.append(make("td", {}, button), ...Array.from({ length: columns }, () => make("td")));
  const anchor = () => Number(row.dataset.anchor);
  row.addEventListener("pointerenter", () => listeners.onLook(anchor()));
  row.addEventListener("pointerleave", () => listeners.onLook(null));
  button.addEventListener("focus", () => listeners.onLook(anchor()));
  button.addEventListener("blur", () => listeners.onLook(null));
  button.addEventListener("click", () => listeners.onKeep(anchor()));
  return row;
}

/** Chart speed, acceleration and curvature of anchor n over time, each with its limit; `step` marks a time. */
export function drawCharts(anchors, n, step) {
  const { limits, steps } = anchors;
  if (!anchors.speeds || !anchors.pulls) {
    byId("charts").replaceChildren();
    return;
  }
  const slice = (values) => values.subarray(n * steps, (n + 1) * steps);
  const constant = (value) => ({ limit: new Float64Array(steps).fill(value), limitText: value, ceiling: 1.15 * value });
  const [speeds, pulls, curvature] = [slice(anchors.speeds), slice(anchors.pulls), anchors.curvature(n)];
  const ceiling = Math.min(MAX_CURVATURE, Math.max(1, 1.2 * peakOf(curvature)));
  const charts = [
    { name: "Speed", unit: "m/s", values: speeds, ...constant(limits.v_max) },
    { name: "Acceleration", unit: "m/s²", values: pulls, ...constant(limits.a_max) },
    { name: "Curvature", unit: "1/m", values: curvature, limit: anchors.curvatureLimit(n), limitText: "a_max ⁄ v²", ceiling },
  ];
  const axis = make("p", {}, make("span", {}, "0 s"), make("span", {}, `${anchors.duration(n).toFixed(1)} s`));
  byId("charts").replaceChildren(...charts.map((chart) => drawChart(chart, step)), axis);
}

const peakOf = (values) => Math.max(0, ...[...values].filter(Number.isFinite));

function drawChart({ name, unit, values, limit, limitText, ceiling: wanted }, step) {
  const peak = peakOf(values);
  const ceiling = name === "Curvature" ? wanted : Math.max(wanted, peak);
  const x = (t) => (t / (values.length - 1)) * WIDTH;
  const y = (value) => HEIGHT - (Math.min(value, ceiling) / ceiling) * (HEIGHT - TOP);
  const points = (run, of) => run.map((t) => `${x(t).toFixed(1)} ${y(of[t]).toFixed(1)}`).join("L");
  const path = (d, kind) => makeSvg("path", { d, class: kind });
  const lines = runs(values);
  const shown = step === null || !Number.isFinite(values[step]) ? `top ${peak.toFixed(2)}` : `now ${values[step].toFixed(2)}`;
  const label = `${name}: top ${peak.toFixed(2)} ${unit}, limit ${limitText}`;
  const chart = makeSvg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT + 1}`, role: "img", "aria-label": label });
  chart.append(
    makeSvg("text", { x: 0, y: 11, class: "name" }, `${name} ${unit}`),
    makeSvg("text", { x: WIDTH, y: 11, "text-anchor": "end" }, `${shown}, limit ${limitText}`),
    path(`M0 ${HEIGHT}H${WIDTH}`, "axis"),
    ...lines.map((run) => path(`M${x(run[0])} ${HEIGHT}L${points(run, values)}L${x(run.at(-1))} ${HEIGHT}z`, "area")),
    ...runs(limit, ceiling).map((run) => path(`M${points(run, limit)}`, "limit")),
    ...lines.map((run) => path(`M${points(run, values)}`, "line")),
  );
  if (step !== null) chart.append(path(`M${x(step)} ${TOP}V${HEIGHT}`, "now"));
  return chart;
}

/** Unbroken runs of time steps with finite values up to the ceiling. */
function runs(values, ceiling = Infinity) {
  const all = [[]];
  values.forEach((value, t) => {
    if (Number.isFinite(value) && value <= ceiling) all.at(-1).push(t);
    else if (all.at(-1).length) all.push([]);
  });
  return all.filter((run) => run.length > 1);
}

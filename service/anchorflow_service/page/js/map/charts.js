/** Speed, acceleration and curvature of one anchor over time, each against its limit. */

import { byId, make, makeSvg } from "../dom.js";

const WIDTH = 300;
const HEIGHT = 72;
const TOP = 18;
/** 1/m; sharper turns are as good as turning on the spot. */
const MOST_CURVATURE = 4;

/** Draws the charts of anchor n; `step` marks a time. */
export function drawCharts(anchors, n, step) {
  const { limits, steps } = anchors;
  if (!anchors.speeds || !anchors.pulls) {
    byId("charts").replaceChildren();
    return;
  }
  const slice = (values) => values.subarray(n * steps, (n + 1) * steps);
  const constant = (value) => new Float64Array(steps).fill(value);
  const charts = [
    { name: "Speed", unit: "m/s", values: slice(anchors.speeds), limit: constant(limits.v_max), limitText: limits.v_max, top: 1.15 * limits.v_max },
    { name: "Acceleration", unit: "m/s²", values: slice(anchors.pulls), limit: constant(limits.a_max), limitText: limits.a_max, top: 1.15 * limits.a_max },
    { name: "Curvature", unit: "1/m", values: anchors.curvature(n), limit: anchors.curvatureLimit(n), limitText: "a_max ⁄ v²", top: MOST_CURVATURE },
  ];
  const end = `${anchors.duration(n).toFixed(1)} s`;
  const axis = make("p", {}, make("span", {}, "0 s"), make("span", {}, end));
  byId("charts").replaceChildren(...charts.map((chart) => draw(chart, step)), axis);
}

function draw({ name, unit, values, limit, limitText, top }, step) {
  const peak = Math.max(0, ...[...values].filter(Number.isFinite));
  const ceiling = name === "Curvature" ? Math.min(top, Math.max(1, 1.2 * peak)) : Math.max(top, peak);
  const x = (t) => (t / (values.length - 1)) * WIDTH;
  const y = (value) => HEIGHT - (Math.min(value, ceiling) / ceiling) * (HEIGHT - TOP);
  const line = runs(values);
  const shown = step === null || !Number.isFinite(values[step]) ? `top ${peak.toFixed(2)}` : `now ${values[step].toFixed(2)}`;
  const label = `${name}: top ${peak.toFixed(2)} ${unit}, limit ${limitText}`;
  const chart = makeSvg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT + 1}`, role: "img", "aria-label": label });
  chart.append(
    makeSvg("text", { x: 0, y: 11, class: "name" }, `${name} ${unit}`),
    makeSvg("text", { x: WIDTH, y: 11, "text-anchor": "end" }, `${shown}, limit ${limitText}`),
    makeSvg("path", { d: `M0 ${HEIGHT}H${WIDTH}`, class: "axis" }),
    ...line.map((run) => makeSvg("path", { d: `M${x(run[0])} ${HEIGHT}${points(run, values, x, y, "L")}L${x(run.at(-1))} ${HEIGHT}z`, class: "area" })),
    ...runs(limit, ceiling).map((run) => makeSvg("path", { d: points(run, limit, x, y), class: "limit" })),
    ...line.map((run) => makeSvg("path", { d: points(run, values, x, y), class: "line" })),
  );
  if (step !== null) chart.append(makeSvg("path", { d: `M${x(step)} ${TOP}V${HEIGHT}`, class: "now" }));
  return chart;
}

/** Time steps in unbroken runs of finite values, none above the ceiling. */
function runs(values, ceiling = Infinity) {
  const all = [[]];
  values.forEach((value, t) => {
    if (Number.isFinite(value) && value <= ceiling) all.at(-1).push(t);
    else if (all.at(-1).length) all.push([]);
  });
  return all.filter((run) => run.length > 1);
}

function points(run, values, x, y, first = "M") {
  return run.map((t, k) => `${k ? "L" : first}${x(t).toFixed(1)} ${y(values[t]).toFixed(1)}`).join("");
}

/** What came back beside the picture: the poses of an anchor, and the extras that were asked for. */

import { byId, figure, make, plain } from "../dom.js";
import { unnest } from "./tensor.js";

const UNITS = { x: "m", y: "m", heading: "rad" };
/** Where the table tells the last pose: ahead of the ego, and to its left. */
export const END = [
  { name: "Ahead", unit: "m", value: (anchors, n) => anchors.pose(n, anchors.steps - 1)[0] },
  { name: "Left", unit: "m", value: (anchors, n) => anchors.pose(n, anchors.steps - 1)[1] },
];

/** The poses of anchor n, by time; `step` is the one under the pointer. */
export function showPoses(anchors, n, step) {
  const { components } = anchors.card.answer;
  const head = make("tr", {}, ...["Time", ...components].map((name) => heading(name, name === "Time" ? "s" : UNITS[name])));
  const rows = Array.from({ length: anchors.steps }, (_, t) => {
    const cells = [anchors.time(n, t), ...anchors.pose(n, t)].map((value) => figure(value));
    const row = make("tr", {}, ...cells.map((text) => make("td", {}, text)));
    row.setAttribute("aria-current", t === step);
    return row;
  });
  byId("poses").replaceChildren(make("thead", {}, head), make("tbody", {}, ...rows));
}

function heading(name, unit) {
  return make("th", { scope: "col" }, name, ...(unit ? [make("span", { className: "unit" }, unit)] : []));
}

/** The extras by shape, and between which values they lie. */
export function showExtras(extras) {
  byId("extras").replaceChildren(...Object.entries(extras).map(([name, nested]) => {
    const { shape, values } = unnest(nested);
    const [low, high] = values.reduce(([least, most], value) => [Math.min(least, value), Math.max(most, value)], [Infinity, -Infinity]);
    return make("li", {}, make("b", {}, name), ` [${shape.join(", ")}] `, make("span", {}, `${plain(low)} to ${plain(high)}`));
  }));
}

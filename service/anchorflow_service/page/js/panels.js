/** What came back, in figures: the summary, where the time went, the ten best. */

import { anchorColour } from "./lines.js";
import { byId, figure as number, make } from "./dom.js";

const ROWS = 10;
const STAGES = { queue: "queue", encode: "encode", sample: "sample", refine: "refine", way: "transfer, drawing" };

/** "58 of 64 anchors are safe." and, where none is, why. */
export function showSummary(anchors, scene) {
  const { count, numSafe, trouble } = anchors;
  const text = numSafe ? `${numSafe} of ${count} anchors are safe.` : `No anchor is safe: ${scene.tightEnd || trouble}.`;
  // Said again only when it is news, so that a screen reader is not talked over.
  if (byId("summary").textContent !== text) byId("summary").textContent = text;
}

/** Where the time between asking and seeing went; `screenMs` is all of it. */
export function showTimes(timing, screenMs) {
  const served = { ...timing, way: Math.max(0, screenMs - timing.total) };
  const stages = Object.keys(STAGES).filter((stage) => stage in served);
  const sum = stages.reduce((total, stage) => total + served[stage], 0) || 1;
  byId("times").replaceChildren(...stages.map((stage) => {
    const bar = make("i");
    bar.dataset.stage = stage;
    bar.style.width = `${(100 * served[stage]) / sum}%`;
    return bar;
  }));
  const words = stages.map((stage) => `${STAGES[stage]} ${milliseconds(served[stage])}`);
  byId("times").setAttribute("aria-label", words.join(", "));
  byId("times-key").replaceChildren(...stages.map((stage) => {
    const mark = make("i");
    mark.dataset.stage = stage;
    return make("li", {}, mark, `${STAGES[stage]} `, make("b", {}, milliseconds(served[stage])));
  }));
  byId("round-trip").textContent = `on screen in ${milliseconds(screenMs)}`;
}

/** The table; `onLook(n)` is told which anchor is looked at, null for none, `onKeep(n)` a click. */
export function showBest(stage, anchors, { by, focus, onLook, onKeep }) {
  const body = byId("best").tBodies[0];
  const best = anchors.order.slice(0, ROWS);
  while (body.rows.length > best.length) body.rows[body.rows.length - 1].remove();
  best.forEach((n, place) => {
    const row = body.rows[place] ?? newRow(body, onLook, onKeep);
    row.dataset.anchor = n;
    row.className = anchors.safe[n] ? "" : "unsafe";
    row.setAttribute("aria-current", n === focus);
    const figures = [anchors.scores[n], anchors.clearance[n], anchors.length(n), anchors.greatest(anchors.speeds, n)];
    figures.forEach((value, k) => { row.cells[k + 1].textContent = number(value); });
    const button = row.cells[0].firstChild;
    button.lastChild.data = `${n}`;
    button.setAttribute("aria-label", `Anchor ${n}${anchors.safe[n] ? "" : ", not safe"}`);
    button.firstChild.style.setProperty("--tone", anchorColour(stage, anchors, by, n));
  });
}

/** A row is made once and filled again with every answer, so that focus stays where it is. */
function newRow(body, onLook, onKeep) {
  const row = body.insertRow();
  const button = make("button", { type: "button" }, make("i"), document.createTextNode(""));
  row.append(make("td", {}, button), ...Array.from({ length: 4 }, () => make("td")));
  const anchor = () => Number(row.dataset.anchor);
  row.addEventListener("pointerenter", () => onLook(anchor()));
  row.addEventListener("pointerleave", () => onLook(null));
  button.addEventListener("focus", () => onLook(anchor()));
  button.addEventListener("blur", () => onLook(null));
  button.addEventListener("click", () => onKeep(anchor()));
  return row;
}

const milliseconds = (ms) => `${ms < 9.95 ? ms.toFixed(1) : ms.toFixed(0)} ms`;

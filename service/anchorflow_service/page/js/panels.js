/** What came back, in figures: the summary, where the time went, the ten best. */

import { anchorColour } from "./lines.js";
import { byId, figure as number, make } from "./dom.js";

const ROWS = 10;
const STAGES = { queue: "queue", encode: "encode", sample: "sample", refine: "refine", way: "transfer, drawing" };

const LENGTH = { name: "Length", unit: "m", value: (anchors, n) => anchors.length(n) };
const SCORE = { name: "Score", unit: "", value: ({ scores }, n) => scores[n], all: ({ scores }) => scores };
const CLEARANCE = { name: "Clear", unit: "m", value: ({ clearance }, n) => clearance[n] };
const DURATION = { name: "Lasts", unit: "s", value: (anchors, n) => anchors.duration(n) };
const TOP_SPEED = { name: "Top", unit: "m/s", value: (anchors, n) => anchors.greatest(anchors.speeds, n) };

/** The columns of the table that the arrays of an answer can fill, with what tells of the way. */
export function columnsOf({ scores, clearance, speeds, hasOwnTime }, way = [LENGTH]) {
  return [scores && SCORE, clearance && CLEARANCE, ...way, hasOwnTime && DURATION, speeds && TOP_SPEED].filter(Boolean);
}

/** Which anchor the figures are about: the one in focus, or the best. */
export function nameAnchor(anchors, focus) {
  const { best, safe, scores } = anchors;
  const looked = focus ?? best;
  byId("anchor-name").textContent = focus === null ? "Best anchor" : `Anchor ${focus}`;
  const said = [scores && `score ${number(scores[looked], 2, scores)}`, `${anchors.duration(looked).toFixed(1)} s`];
  byId("anchor-figures").textContent = safe[looked] ? said.filter(Boolean).join(", ") : "not safe";
}

/** What has come back, in a sentence. */
export function say(text) {
  // Said again only when it is news, so that a screen reader is not talked over.
  if (byId("summary").textContent !== text) byId("summary").textContent = text;
}

/** Nothing has come back of what is asked now. */
export function clearAnswer() {
  for (const id of ["anchor-figures", "times", "times-key", "round-trip"]) byId(id).replaceChildren();
  byId("times").removeAttribute("aria-label");
  byId("anchor-name").textContent = "Best anchor";
  const table = byId("best");
  delete table.dataset.columns;
  table.tHead.rows[0].replaceChildren();
  table.tBodies[0].replaceChildren();
  fadeFigures(false);
}

/** Whether the figures are of an answer that is no longer the one to what is asked. */
export function fadeFigures(stale) {
  byId("layout").toggleAttribute("data-stale", stale);
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

/**
 * The table of the best; `columns` of it are {name, unit, value(anchors, n), all(anchors)}, where
 * `all` is left out of those that are never tiny. `onLook(n)` is told which anchor is looked at,
 * null for none, `onKeep(n)` a click.
 */
export function showBest(stage, anchors, { columns, by, focus, onLook, onKeep }) {
  const body = bodyFor(columns, onLook, onKeep);
  const best = anchors.order.slice(0, ROWS);
  byId("best-name").textContent = anchors.count > ROWS ? "Ten best" : anchors.count > 1 ? "All anchors" : "The anchor";
  while (body.rows.length > best.length) body.rows[body.rows.length - 1].remove();
  best.forEach((n, place) => {
    const row = body.rows[place] ?? newRow(body, columns.length);
    row.dataset.anchor = n;
    row.className = anchors.safe[n] ? "" : "unsafe";
    row.setAttribute("aria-current", n === focus);
    columns.forEach(({ value, all }, k) => { row.cells[k + 1].textContent = number(value(anchors, n), 2, all?.(anchors)); });
    const button = row.cells[0].firstChild;
    button.lastChild.data = `${n}`;
    button.setAttribute("aria-label", `Anchor ${n}${anchors.safe[n] ? "" : ", not safe"}`);
    button.firstChild.style.setProperty("--tone", anchorColour(stage, anchors, by, n));
  });
}

/** Who is told of looks and clicks: the view that has filled the table last. */
let listeners = {};

/** The table's body, emptied where its columns are others than before. */
function bodyFor(columns, onLook, onKeep) {
  listeners = { onLook, onKeep };
  const table = byId("best");
  const names = columns.map(({ name }) => name).join();
  if (table.dataset.columns === names) return table.tBodies[0];
  table.dataset.columns = names;
  const heads = [{ name: "Anchor", unit: "" }, ...columns].map(({ name, unit }) => {
    return make("th", { scope: "col" }, name, ...(unit ? [make("span", { className: "unit" }, unit)] : []));
  });
  table.tHead.rows[0].replaceChildren(...heads);
  table.tBodies[0].replaceChildren();
  return table.tBodies[0];
}

/** A row is made once and filled again with every answer, so that focus stays where it is. */
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

const milliseconds = (ms) => `${ms < 9.95 ? ms.toFixed(1) : ms.toFixed(0)} ms`;

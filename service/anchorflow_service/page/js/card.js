/** The card of a bundle, in words: what it takes, how it works, what it gives. */

import { byId, make, plain } from "./dom.js";

/** A list with more numbers than this is told by how many there are. */
const MOST_NUMBERS = 4;

export class CardPanel {
  /** Show the card of the bundle that is asked. */
  show(card) {
    // Where there is no map to draw on, the card is what one has to read first.
    byId("card-block").open = card.conditioning.kind !== "cost_map";
    byId("card-state").textContent = card.ready ? "ready" : "not ready";
    byId("card-state").dataset.ready = card.ready;
    const rows = [
      ["Bundle", `${card.name} ${card.version}`],
      ["Planner", card.planner],
      ["Inputs", ...card.inputs.map(inputText)],
      ["Conditioning", partText(card.conditioning)],
      ["Sampler", partText(card.sampler)],
      ["Finish", partText(card.finish)],
      ["Time", timeText(card.time)],
      ["Answer", [`trajectories [N, T, ${card.answer.components.length}] of ${card.answer.components.join(", ")}`, ...card.answer.arrays].join(", ")],
      ...(card.answer.extras.length ? [["Extras", ...card.answer.extras.map(inputText)]] : []),
      ["SHA-256", `${card.sha256.slice(0, 16)}…`],
    ];
    byId("card").replaceChildren(...rows.flatMap(([name, ...values]) => {
      return [make("dt", {}, name), ...values.map((value) => make("dd", {}, value))];
    }));
  }
}

/** "float32 [3, 16, 24]" of a tensor's type and axes. */
export const typeText = ({ dtype, shape }) => `${dtype} [${shape.join(", ")}]`;

/** "m/s, −60 to 60" of what a tensor's values may be; "" where the card says nothing. */
export function limitsText({ unit, range }) {
  return [unit, range && rangeText(range)].filter(Boolean).join(", ");
}

function rangeText([low, high]) {
  if (low === null) return high === null ? "" : `at most ${plain(high)}`;
  return high === null ? `at least ${plain(low)}` : `${plain(low)} to ${plain(high)}`;
}

function inputText(spec) {
  const limits = limitsText(spec);
  return make("span", {}, make("b", {}, spec.name), ` ${typeText(spec)}${limits && `, ${limits}`}${spec.optional ? ", optional" : ""}`);
}

/** Any part: its kind and what it says of itself. */
function partText({ kind, ...rest }) {
  const words = Object.entries(rest).map(([name, value]) => `${name.replaceAll("_", " ")} ${(name === "ranges" ? rangesText : valueText)(value)}`);
  const name = kind.replaceAll("_", " ");
  return words.length ? `${name}: ${words.join(", ")}` : name;
}

/** What a request may ask for, by the name of its field. */
function rangesText(ranges) {
  return Object.entries(ranges).map(([name, range]) => `${name} ${rangeText(range)}`).join(", ") || "none";
}

function valueText(value) {
  if (value === null) return "free";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value === "number") return plain(value);
  if (Array.isArray(value)) return value.length > MOST_NUMBERS ? `of ${value.length}` : value.map(valueText).join(", ") || "none";
  if (value && typeof value === "object") return Object.entries(value).map(([name, part]) => `${name} ${valueText(part)}`).join(", ");
  return String(value);
}

function timeText({ steps, first_s: first, dt }) {
  if (dt === null) return `${steps} poses from ${plain(first)} s on, each anchor in its own time`;
  const last = first + (steps - 1) * dt;
  return `${steps} poses from ${plain(first)} to ${plain(last)} s, ${plain(dt)} s apart`;
}

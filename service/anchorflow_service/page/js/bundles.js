/** The bundles that are served: which one is asked, and its card in words. */

import { byId, make, plain } from "./dom.js";
import { Unreachable, ask } from "./service.js";

/** A longer list of numbers is summed up by its length. */
const MAX_LISTED = 4;

export class Bundles {
  card = null;
  #cards = [];

  /** Calls `onChoose(card)` with the card of the bundle that is asked from now on. */
  constructor(onChoose) {
    this.onChoose = onChoose;
    byId("bundle").addEventListener("change", () => this.choose(this.#named(byId("bundle").value)));
  }

  /** Read the cards that are served now; keep the choice if it is still served, in its new version. */
  async refresh() {
    const { models } = await ask("v2/models");
    if (!models.length) throw new Unreachable("The service serves no bundle at present.");
    this.#cards = models;
    byId("bundle").replaceChildren(...models.map(({ name, version }) => new Option(`${name} ${version}`, name)));
    const card = this.#named(this.card?.name) ?? models[0];
    if (card.sha256 === this.card?.sha256) byId("bundle").value = card.name;
    else this.choose(card);
  }

  /** The served card with this name, if its conditioning is of the same kind as the chosen one's. */
  like(name) {
    const card = this.#named(name);
    return card?.conditioning.kind === this.card.conditioning.kind ? card : undefined;
  }

  choose(card) {
    this.card = card;
    byId("bundle").value = card.name;
    showCard(card);
    this.onChoose(card);
  }

  #named(name) {
    return this.#cards.find((card) => card.name === name);
  }
}

function showCard(card) {
  // Without a map to draw on, the card is the first thing to read.
  byId("card-block").open = card.conditioning.kind !== "cost_map";
  byId("card-state").textContent = card.ready ? "ready" : "not ready";
  byId("card-state").dataset.ready = card.ready;
  const { components, arrays, extras } = card.answer;
  const rows = [
    ["Bundle", `${card.name} ${card.version}`],
    ["Planner", card.planner],
    ["Inputs", ...card.inputs.map(specText)],
    ["Conditioning", partText(card.conditioning)],
    ["Sampler", partText(card.sampler)],
    ["Finish", partText(card.finish)],
    ["Time", timeText(card.time)],
    ["Answer", [`trajectories [N, T, ${components.length}] of ${components.join(", ")}`, ...arrays].join(", ")],
    ...(extras.length ? [["Extras", ...extras.map(specText)]] : []),
    ["SHA-256", `${card.sha256.slice(0, 16)}…`],
  ];
  byId("card").replaceChildren(...rows.flatMap(([name, ...values]) => [make("dt", {}, name), ...values.map((value) => make("dd", {}, value))]));
}

/** "float32 [3, 16, 24]", the type and axes of a tensor. */
export const typeText = ({ dtype, shape }) => `${dtype} [${shape.join(", ")}]`;

/** "m/s, −60 to 60", the unit and range of a tensor; "" if the card has neither. */
export const limitsText = ({ unit, range }) => [unit, range && rangeText(range)].filter(Boolean).join(", ");

/** "0.2 to 6", "at least 1", or "" for a range without ends. */
export function rangeText([low, high]) {
  const [isOpenBelow, isOpenAbove] = [low, high].map((end) => end === null || !Number.isFinite(end));
  if (isOpenBelow) return isOpenAbove ? "" : `at most ${plain(high)}`;
  return isOpenAbove ? `at least ${plain(low)}` : `${plain(low)} to ${plain(high)}`;
}

function specText(spec) {
  const words = [typeText(spec), limitsText(spec), spec.optional && "optional"].filter(Boolean);
  return make("span", {}, make("b", {}, spec.name), ` ${words.join(", ")}`);
}

/** A part of the card: its kind, and all that it says of itself. */
function partText({ kind, ...rest }) {
  const words = Object.entries(rest).map(([name, value]) => `${name.replaceAll("_", " ")} ${name === "ranges" ? rangesText(value) : valueText(value)}`);
  return [kind.replaceAll("_", " "), words.join(", ")].filter(Boolean).join(": ");
}

const rangesText = (ranges) => Object.entries(ranges).map(([name, range]) => `${name} ${rangeText(range)}`).join(", ") || "none";

function valueText(value) {
  if (value === null) return "free";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value === "number") return plain(value);
  if (Array.isArray(value)) return value.length > MAX_LISTED ? `of ${value.length}` : value.map(valueText).join(", ") || "none";
  if (typeof value === "object") return Object.entries(value).map(([name, part]) => `${name} ${valueText(part)}`).join(", ");
  return String(value);
}

function timeText({ steps, first_s: first, dt }) {
  if (dt === null) return `${steps} poses from ${plain(first)} s on, each anchor in its own time`;
  return `${steps} poses from ${plain(first)} to ${plain(first + (steps - 1) * dt)} s, ${plain(dt)} s apart`;
}

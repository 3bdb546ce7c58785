/**
 * The scalar fields of a request, read from the schema of POST /anchors in GET /openapi.json, and
 * their rows in the form. A scalar field that is added to the schema gets a row by itself.
 */

import { rangeText } from "./bundles.js";
import { byId, clamp, make, plain, showFill } from "./dom.js";

/** Fields that have controls of their own, and fields that are for programs. */
const NOT_IN_FORM = new Set([
  "cost_map", "x_curr", "x_goal", "w_style", "inputs", "outputs", "model", "warm_start", "footprint",
  "obstacles", "budget_ms", "robot_id", "request_id", "delay_s", "last_plan",
]);
/** Kinds of `kinematics` that have a heading of their own. */
export const WHEELS = ["differential", "ackermann"];
/**
 * How the page shows some fields: the block of the form, the label, the end of the slider if there
 * is one, the value that is asked first, the field without which it means nothing, with its values
 * if only some count, and the texts of a choice.
 */
const SHOWN = {
  num_samples: { block: "sampling", label: "Anchors", slider: Infinity },
  "sampler.method": { block: "sampling", label: "Sampler" },
  "sampler.schedule.uniform": { block: "sampling", label: "Steps", needs: "sampler.method" },
  robot_radius: { block: "robot", slider: Infinity },
  v_max: { block: "robot", label: "Speed limit", slider: Infinity },
  a_max: { block: "robot", label: "Acceleration limit", slider: Infinity },
  horizon_s: { block: "robot", label: "Duration", slider: Infinity },
  "kinematics.kind": { block: "robot", label: "Drive", texts: { "": "Any way", omni: "Any way (omni)", differential: "Differential", ackermann: "Like a car" } },
  "kinematics.min_turning_radius": { block: "robot", label: "Turning radius", slider: 3, needs: "kinematics.kind", of: WHEELS },
  "kinematics.omega_max": { block: "robot", label: "Turn rate limit", slider: 4, needs: "kinematics.kind", of: WHEELS },
  "kinematics.reverse": { block: "robot", label: "Reverse", needs: "kinematics.kind", of: WHEELS },
  "refine.safety_margin": { block: "finish", slider: 0.5 },
  "refine.guidance": { block: "finish", slider: 2 },
  "refine.certified_margin": { block: "finish", slider: 0.5 },
  seed: { block: "seed", first: 0 },
  cost_penalty: { slider: 20 },
  "goal_tolerance.position": { label: "Goal tolerance" },
  "goal_tolerance.heading": { label: "Heading tolerance", needs: "goal_tolerance.position" },
};
const ONLY_ON_MAPS = new Set(["cost_penalty", "clear_start"]);
const BLOCKS_OF_GROUPS = { sampler: "sampling", refine: "finish" };
const SLIDER_STEP = 0.01;

export class RequestFields {
  /** `openapi`: the document of GET /openapi.json. */
  constructor(openapi) {
    const { schema } = openapi.paths["/anchors"].post.requestBody.content["application/json"];
    const { properties } = openapi.components.schemas[schema.$ref.split("/").at(-1)];
    const names = Object.keys(properties).filter((name) => !NOT_IN_FORM.has(name));
    /** {path, kind, low, high, options, unit, text, initial, block, label, …} each. */
    this.all = names.flatMap((name) => read(name, properties[name]));
  }

  /** The fields that a request to this bundle can carry. */
  of(card) {
    const hasMap = card.conditioning.kind === "cost_map";
    const applies = ({ path, block }) => {
      if (path === "refine.guidance" && card.sampler.kind !== "ode") return false;
      if (path.startsWith("kinematics.")) return hasMap;
      if (block === "robot") return path in (card.conditioning.limits ?? {});
      if (path.startsWith("sampler.")) return hasMap && card.sampler.kind === "ode";
      if (path === "refine.guard") return card.finish.kind === "guard";
      if (path === "refine.route_drives") return (card.finish.route_drives ?? null) !== null;
      if (path.startsWith("refine.")) return hasMap && card.finish.kind === "spline";
      return hasMap || !(path.includes(".") || ONLY_ON_MAPS.has(path));
    };
    return this.all.filter(applies);
  }

  /** {path: value} of the bundle's own values, or the contract's; null: what the bundle does by itself. */
  defaults(card) {
    return Object.fromEntries(this.of(card).map((field) => {
      const [group, name] = field.path.split(".");
      const own = card.conditioning.limits?.[field.path] ?? (group === "refine" ? card.finish[name] : undefined);
      const value = own ?? field.first ?? field.initial;
      return [field.path, typeof value === "number" ? clamp(value, ...(rangeOf(field, card) ?? [value, value])) : value];
    }));
  }

  /** The request's fields of {path: value}; what the bundle decides by itself is left out. */
  toRequest(options, card) {
    const request = {};
    for (const field of this.of(card)) {
      const value = options[field.path] ?? null;
      if (value === null || rangeOf(field, card) === null || lacks(field, options)) continue;
      const names = field.path.split(".");
      const last = names.pop();
      names.reduce((part, name) => (part[name] ??= {}), request)[last] = value;
    }
    return request;
  }

  /** {path: value} of a request, null where it gives none. Throws an Error that names the field. */
  fromRequest(request, card) {
    return Object.fromEntries(this.of(card).map((field) => {
      const value = field.path.split(".").reduce((part, name) => part?.[name], request) ?? null;
      const isGood = { boolean: (given) => typeof given === "boolean", choice: (given) => field.options.includes(given) }[field.kind] ?? Number.isFinite;
      const expected = { boolean: "true or false", choice: `one of ${field.options?.join(", ")}` }[field.kind] ?? "a number";
      if (value !== null && !isGood(value)) throw new Error(`${field.path}: expected ${expected}, got ${described(value)}.`);
      return [field.path, value];
    }));
  }

  /** The names of a request's top-level fields that have rows. */
  get names() {
    return new Set(this.all.map(({ path }) => path.split(".")[0]));
  }
}

/** A value in an error message. */
export function described(value) {
  if (Array.isArray(value)) return `${value.length} values`;
  return value === undefined ? "nothing" : JSON.stringify(value).slice(0, 40);
}

/** The field at a path if it is a scalar, or those inside if it is a group. */
function read(path, schema) {
  const forms = schema.anyOf ?? [schema];
  const scalar = forms.find(({ type, enum: options }) => options || ["number", "integer", "boolean"].includes(type));
  if (scalar) return [describe(path, schema, scalar)];
  // An array may also be bytes in base64; that is another form of its value, not a group of fields.
  const groups = forms.filter(({ properties }) => properties && !properties.base64);
  return groups.flatMap(({ properties }) => Object.entries(properties).flatMap(([name, part]) => read(`${path}.${name}`, part)));
}

function describe(path, { description = "", default: initial = null, "x-unit": unit = "" }, { type, enum: options, ...ends }) {
  const [group] = path.split(".");
  const name = path.split(".").at(-1).replaceAll("_", " ");
  return {
    path,
    kind: options ? "choice" : type,
    options,
    low: ends.minimum ?? ends.exclusiveMinimum ?? -Infinity,
    high: Math.min(ends.maximum ?? ends.exclusiveMaximum ?? Infinity, Number.MAX_SAFE_INTEGER),
    unit: unit.replace("^2", "²"),
    text: description,
    initial,
    block: BLOCKS_OF_GROUPS[group] ?? "more",
    label: name[0].toUpperCase() + name.slice(1),
    ...SHOWN[path],
  };
}

/** [low, high] of a field for a bundle; null if a request cannot change it. */
export function rangeOf({ path, low, high }, card) {
  if (path in (card.conditioning.limits ?? {})) return card.conditioning.ranges[path] ?? null;
  return [low, path === "num_samples" ? Math.min(high, card.sampler.size ?? high) : high];
}

function lacks({ needs, of }, options) {
  const value = options[needs] ?? null;
  return needs !== undefined && (value === null || (of !== undefined && !of.includes(value)));
}

/** The rows of the form; calls `onChange({path: value})`, null for a value that was emptied. */
export class Form {
  #rows;

  constructor(fields, onChange) {
    this.fields = fields;
    this.#rows = fields.all.map((field) => new Row(field, (value) => onChange({ [field.path]: value })));
    for (const row of this.#rows) byId(`fields-${row.field.block}`).append(row.element);
  }

  /** `unused`: paths of fields that mean nothing at the moment, and are hidden. */
  show(options, card, unused = []) {
    const defaults = this.fields.defaults(card);
    for (const row of this.#rows) {
      const { path } = row.field;
      row.element.hidden = !(path in defaults) || unused.includes(path) || (row.field.of !== undefined && lacks(row.field, options));
      if (path in defaults) row.show(options[path] ?? null, card, { isOptional: defaults[path] === null, isUnused: lacks(row.field, options) });
    }
    for (const block of document.querySelectorAll("[id^=fields-]")) {
      block.closest(".block").hidden = [...block.children].every(({ hidden }) => hidden);
    }
  }
}

class Row {
  constructor(field, onChange) {
    this.field = field;
    const { kind, label, text, path } = field;
    const id = path.replaceAll(".", "-");
    this.hint = make("p", { className: "hint", id: `${id}-hint` }, text);
    this.output = make("output", { id: `${id}-value` });
    if (kind === "choice") {
      this.control = make("select", { id }, ...["", ...field.options].map((name) => new Option(field.texts?.[name] ?? (name || "The bundle's own"), name)));
    } else {
      this.control = make("input", { id, type: kind === "boolean" ? "checkbox" : "number" });
    }
    this.control.setAttribute("aria-describedby", this.hint.id);
    if (kind === "boolean") this.control.setAttribute("role", "switch");
    const name = make("span", {}, label);
    const parts = kind === "boolean" ? [this.control, name] : [name, this.output, this.control];
    this.element = make("div", { className: "row" }, make("label", { className: kind === "boolean" ? "switch" : "field", htmlFor: id }, ...parts), this.hint);
    this.control.addEventListener("change", () => onChange(this.#value()));
    this.control.addEventListener("input", () => {
      if (this.control.type === "range") onChange(this.#value());
    });
  }

  /** `isOptional`: it may be left empty; `isUnused`: a field that it needs is empty. */
  show(value, card, { isOptional, isUnused }) {
    const { field, control } = this;
    const range = rangeOf(field, card);
    control.disabled = range === null || isUnused;
    if (field.kind === "boolean") control.checked = value;
    else if (field.kind === "choice") control.value = value ?? "";
    else this.#showNumber(value, range ?? [field.low, Math.max(2 * value, field.low)], field.slider !== undefined && !isOptional);
    const ends = range === null ? "The bundle's own" : field.kind === "number" ? `${rangeText(range)} ${field.unit}`.trim() : "";
    this.hint.textContent = [field.text, ends && `${ends}.`].filter(Boolean).join(" ");
  }

  #showNumber(value, [low, high], isSlider) {
    const { control, field: { kind, slider, unit } } = this;
    this.range = [low, high];
    const most = isSlider ? Math.max(Math.min(slider, high), value) : high;
    const step = kind === "integer" ? 1 : isSlider ? SLIDER_STEP : "any";
    Object.assign(control, { type: isSlider ? "range" : "number", min: low, max: most, step, placeholder: "the bundle's own" });
    control.value = value ?? "";
    // A slider with one place leaves nothing to choose.
    control.hidden = isSlider && low === most;
    this.output.value = [isSlider && plain(value), unit].filter(Boolean).join(" ");
    if (isSlider) showFill(control);
  }

  #value() {
    const { control, field: { kind } } = this;
    if (kind === "boolean") return control.checked;
    if (control.value === "") return null;
    if (kind === "choice") return control.value;
    const value = clamp(Number(control.value), ...this.range);
    return kind === "integer" ? Math.round(value) : value;
  }
}

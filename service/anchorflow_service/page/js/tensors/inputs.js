/** A field for each input that a card lists, and what is wrong with its value. */

import { limitsText, typeText } from "../bundles.js";
import { byId, make, plain } from "../dom.js";
import { ImageField } from "./image_field.js";
import { axesOf, countOf, filled, neutral } from "./tensor.js";

/** Longer vectors are shown as tensors. */
const MAX_IN_A_LINE = 64;
/** Characters of base64 in the placeholder of a tensor. */
const SHOWN_BASE64 = 24;

/**
 * Fields have `spec`, `control`, `hint`, `isEmpty` (neither the user nor a drive has set it), fill(value), and value() as the contract's JSON has it:
 * undefined if it is left out; it throws an Error if there is no value yet.
 */
class TextField {
  static fits = ({ dtype }) => dtype === "text";
  hint = "A text";

  constructor(spec, id, onChange) {
    this.spec = spec;
    this.control = make("textarea", { id, rows: 4, spellcheck: false });
    this.control.addEventListener("input", onChange);
  }

  fill(value) {
    this.control.value = value;
  }

  get isEmpty() {
    return !this.control.value;
  }

  value() {
    return this.control.value || !this.spec.optional ? this.control.value : undefined;
  }
}

/** A line of a few numbers. */
class NumbersField {
  static fits = (spec) => axesOf(spec).length <= 1 && axesOf(spec).every(Number.isInteger) && countOf(spec) <= MAX_IN_A_LINE;

  constructor(spec, id, onChange) {
    this.spec = spec;
    this.count = countOf(spec);
    this.hint = this.count === 1 ? "A number" : `${this.count} numbers`;
    this.control = make("input", { id, type: "text", autocomplete: "off", spellcheck: false });
    this.control.addEventListener("input", onChange);
    this.first = spec.optional ? "" : Array(this.count).fill(neutral(spec)).join(", ");
    this.control.value = this.first;
  }

  get isEmpty() {
    return this.control.value === this.first;
  }

  fill(value) {
    this.control.value = [value].flat().join(", ");
  }

  value() {
    const parts = this.control.value.trim().replace(/^\[|\]$/g, "").split(/[\s,;]+/).filter(Boolean);
    if (!parts.length && this.spec.optional) return undefined;
    const values = parts.map(Number);
    const wrong = parts.find((_, k) => !Number.isFinite(values[k]));
    if (wrong !== undefined) throw new Error(`expected numbers, got ${wrong}`);
    if (values.length !== this.count) throw new Error(`expected ${this.count} numbers, got ${values.length}`);
    return axesOf(this.spec).length ? values : values[0];
  }
}

/** Any other tensor: the neutral value everywhere, unless a drive fills it in or one pastes JSON. */
class TensorField {
  static fits = () => true;

  constructor(spec, id, onChange) {
    this.spec = spec;
    this.first = spec.optional ? "left out" : `${plain(neutral(spec))} everywhere`;
    this.hint = `${this.first}, unless you paste JSON: lists, or {"dtype", "shape", "base64"}`;
    this.control = make("textarea", { id, rows: 2, spellcheck: false, placeholder: this.first });
    this.control.addEventListener("input", () => {
      this.held = undefined;
      this.control.placeholder = this.first;
      onChange();
    });
  }

  /** `value`: {dtype, shape, base64}, which is too long to show and is kept until one types. */
  fill(value) {
    this.held = value;
    this.control.value = "";
    this.control.placeholder = JSON.stringify({ ...value, base64: `${value.base64.slice(0, SHOWN_BASE64)}…` });
  }

  get isEmpty() {
    return !this.held && !this.control.value.trim();
  }

  value() {
    const text = this.control.value.trim();
    if (!text) return this.held ?? (this.spec.optional ? undefined : filled(this.spec));
    try {
      return JSON.parse(text);
    } catch (cause) {
      throw new Error(`expected JSON: ${cause.message}`, { cause });
    }
  }
}

/** The first that fits an input is its field. */
const FIELDS = [TextField, ImageField, NumbersField, TensorField];

export class Inputs {
  #fields = new Map();

  /** `onChange()` is called when the user changes a value. */
  constructor(onChange) {
    this.onChange = onChange;
  }

  useCard(card) {
    this.#fields.clear();
    byId("inputs").replaceChildren(...card.inputs.map((spec) => this.#row(spec)));
  }

  /** {values: {name: value}, wrong}: what the first input without a value lacks, or null. */
  values() {
    this.clear();
    const values = {};
    let wrong = null;
    for (const [name, { field }] of this.#fields) {
      try {
        const value = field.value();
        if (value !== undefined) values[name] = value;
      } catch (error) {
        wrong ??= `${name}: ${error.message}`;
        this.#say(name, error.message);
      }
    }
    return { values, wrong };
  }

  /** Names of required inputs that nobody has set. */
  get empty() {
    return [...this.#fields].filter(([, { field }]) => field.isEmpty && !field.spec.optional).map(([name]) => name);
  }

  /** Fill in {name: value} as the contract's JSON has them, without a call of `onChange`. */
  fill(values) {
    for (const [name, value] of Object.entries(values)) this.#fields.get(name).field.fill(value);
    this.clear();
  }

  /** Show a refusal beside the input that it names; returns whether there is one. */
  refuse({ field, message }) {
    const [group, name] = field?.split(".") ?? [];
    if (group !== "inputs" || !this.#fields.has(name)) return false;
    this.#say(name, message);
    return true;
  }

  clear() {
    for (const name of this.#fields.keys()) this.#say(name, "");
  }

  #row(spec) {
    const id = `input-${spec.name}`;
    const Field = FIELDS.find((kind) => kind.fits(spec));
    const field = new Field(spec, id, () => {
      this.#say(spec.name, "");
      this.onChange();
    });
    const wrong = make("p", { className: "wrong", role: "alert", hidden: true });
    this.#fields.set(spec.name, { field, wrong });
    const type = [typeText({ dtype: spec.dtype, shape: axesOf(spec) }), spec.optional && "optional"].filter(Boolean).join(", ");
    const hint = [field.hint, limitsText(spec)].filter(Boolean).join(": ");
    const label = make("label", { htmlFor: id }, spec.name, make("span", { className: "type" }, type));
    return make("div", { className: "input" }, label, field.control, make("p", { className: "hint" }, hint), wrong);
  }

  #say(name, text) {
    const { field, wrong } = this.#fields.get(name);
    wrong.hidden = !text;
    wrong.textContent = text;
    field.control.toggleAttribute("data-wrong", Boolean(text));
  }
}

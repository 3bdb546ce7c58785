/** An input of a few numbers: a line of text. */

import { make } from "../dom.js";
import { axesOf, countOf, neutral } from "./tensor.js";

/** More than so many are no line that one reads. */
const MOST = 64;

export class NumbersField {
  static fits = (spec) => axesOf(spec).length <= 1 && axesOf(spec).every(Number.isInteger) && countOf(spec) <= MOST;

  constructor(spec, id, onChange) {
    this.spec = spec;
    this.count = countOf(spec);
    const text = spec.optional ? "" : Array.from({ length: this.count }, () => neutral(spec)).join(", ");
    this.hint = this.count === 1 ? "A number" : `${this.count} numbers`;
    this.control = make("input", { id, type: "text", value: text, autocomplete: "off", spellcheck: false });
    this.control.addEventListener("input", onChange);
  }

  /** `value`: as the contract's JSON has it. */
  fill(value) {
    this.control.value = [value].flat().join(", ");
  }

  /** As the contract's JSON has it; undefined: left out. Throws an Error that says what is wrong. */
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

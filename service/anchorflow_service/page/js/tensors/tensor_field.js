/** Any other input: left out or the value nearest to 0 everywhere, unless it is filled in or JSON is pasted. */

import { make, plain } from "../dom.js";
import { filled, neutral } from "./tensor.js";

/** Letters of base64 that are shown of a tensor. */
const SHOWN = 24;

export class TensorField {
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

  /** `value`: {dtype, shape, base64}; too long to stand in the field, it is held until one types. */
  fill(value) {
    this.held = value;
    this.control.value = "";
    this.control.placeholder = JSON.stringify({ ...value, base64: `${value.base64.slice(0, SHOWN)}…` });
  }

  /** As the contract's JSON has it; undefined: left out. Throws an Error that says what is wrong. */
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

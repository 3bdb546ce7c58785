/** Any other input: the value nearest to 0 everywhere, unless JSON is pasted. */

import { make, plain } from "../dom.js";
import { filled, neutral } from "./tensor.js";

export class TensorField {
  static fits = () => true;

  constructor(spec, id, onChange) {
    this.spec = spec;
    this.hint = `${plain(neutral(spec))} everywhere, unless you paste JSON: lists, or {"dtype", "shape", "base64"}`;
    this.control = make("textarea", { id, rows: 2, spellcheck: false, placeholder: `${plain(neutral(spec))} everywhere` });
    this.control.addEventListener("input", onChange);
  }

  /** As the contract's JSON has it. Throws an Error that says what is wrong. */
  value() {
    const text = this.control.value.trim();
    if (!text) return filled(this.spec);
    try {
      return JSON.parse(text);
    } catch (cause) {
      throw new Error(`expected JSON: ${cause.message}`, { cause });
    }
  }
}

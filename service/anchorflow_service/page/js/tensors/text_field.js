/** An input that is a text. */

import { make } from "../dom.js";

export class TextField {
  static fits = (spec) => spec.dtype === "text";
  hint = "A text";

  constructor(spec, id, onChange) {
    this.spec = spec;
    this.control = make("textarea", { id, rows: 4, spellcheck: false });
    this.control.addEventListener("input", onChange);
  }

  fill(value) {
    this.control.value = value;
  }

  /** As the contract's JSON has it; undefined: left out. */
  value() {
    return this.control.value || !this.spec.optional ? this.control.value : undefined;
  }
}

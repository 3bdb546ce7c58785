/** A field for every input that a card lists, and what is wrong with it. */

import { limitsText, typeText } from "../card.js";
import { byId, make } from "../dom.js";
import { ImageField } from "./image_field.js";
import { NumbersField } from "./numbers_field.js";
import { TensorField } from "./tensor_field.js";
import { axesOf } from "./tensor.js";
import { TextField } from "./text_field.js";

/** The first that fits an input is its field. */
const FIELDS = [TextField, ImageField, NumbersField, TensorField];

export class Inputs {
  #fields = new Map();

  /** `onChange()` is called when a value is another than before. */
  constructor(onChange) {
    this.onChange = onChange;
  }

  useCard(card) {
    this.#fields.clear();
    byId("inputs").replaceChildren(...card.inputs.map((spec) => this.#row(spec)));
  }

  /**
   * {values: {name: value} as the contract's JSON has them, wrong}: what the first that is no value
   * lacks, or null. One that is optional and not filled in is left out.
   */
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

  /** Fill in {name: value}, as the contract's JSON has them; nobody is told of a change. */
  fill(values) {
    for (const [name, value] of Object.entries(values)) this.#fields.get(name).field.fill(value);
    this.clear();
  }

  /** Shows a refusal beside the input that it names; whether there is one. */
  refuse({ field, message }) {
    const [group, name] = field?.split(".") ?? [];
    if (group !== "inputs" || !this.#fields.has(name)) return false;
    this.#say(name, message);
    return true;
  }

  /** Nothing is wrong any more. */
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

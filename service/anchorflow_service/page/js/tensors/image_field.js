/** An input that is a picture: a file, brought to the size that the card lists. */

import { make } from "../dom.js";
import { Raster } from "./raster.js";
import { axesOf, base64, unpacked } from "./tensor.js";

const FORMATS = { "image/png": "png", "image/jpeg": "jpeg" };

export class ImageField {
  static fits = (spec) => spec.dtype === "uint8" && axesOf(spec).length === 3 && axesOf(spec)[0] === 3 && axesOf(spec).every(Number.isInteger);

  constructor(spec, id, onChange) {
    [, this.height, this.width] = axesOf(spec);
    this.hint = `A picture, ${this.width} × ${this.height} pixels; black until you choose one`;
    this.onChange = onChange;
    this.picture = make("canvas", { className: "thumbnail", width: this.width, height: this.height });
    this.context = this.picture.getContext("2d");
    this.context.imageSmoothingQuality = "high";
    this.file = make("input", { id, type: "file", accept: Object.keys(FORMATS).join() });
    this.file.addEventListener("change", () => this.#read(this.file.files[0]));
    this.note = make("p", { className: "hint" });
    this.control = make("div", { className: "picture" }, this.picture, make("div", {}, this.file, this.note));
    this.control.addEventListener("dragover", (event) => event.preventDefault());
    this.control.addEventListener("drop", (event) => {
      event.preventDefault();
      this.#read(event.dataTransfer.files[0]);
    });
    this.#clear();
  }

  /** As the contract's JSON has it. */
  value() {
    return this.original ?? { png: this.picture.toDataURL("image/png").split(",")[1] };
  }

  /** `value`: {dtype, shape, base64} of its pixels. */
  fill(value) {
    this.#clear();
    const raster = new Raster({ range: [0, 255] }, unpacked(value), []);
    this.context.drawImage(raster.canvas, 0, 0);
  }

  #clear() {
    this.original = null;
    this.context.fillStyle = "#000";
    this.context.fillRect(0, 0, this.width, this.height);
    this.note.textContent = "";
  }

  async #read(file) {
    this.#clear();
    try {
      if (file) await this.#show(file);
    } catch {
      this.note.textContent = `${file.name}: expected a PNG or JPEG picture.`;
    }
    this.onChange();
  }

  async #show(file) {
    const format = FORMATS[file.type];
    const picture = await createImageBitmap(file);
    this.context.drawImage(picture, 0, 0, this.width, this.height);
    const fits = picture.width === this.width && picture.height === this.height;
    this.note.textContent = `${picture.width} × ${picture.height} pixels${fits ? "" : `, drawn to ${this.width} × ${this.height}`}`;
    // A file of the right size goes as it is; what is drawn loses nothing more as PNG.
    if (fits && format) this.original = { [format]: base64(new Uint8Array(await file.arrayBuffer())) };
  }
}

/** The field of an input that is a picture: a file, in its own size or drawn to that of the card. */

import { make } from "../dom.js";
import { axesOf, drawPicture, toBase64, toPicture, unpack } from "./tensor.js";

const FORMATS = { "image/png": "png", "image/jpeg": "jpeg" };

export class ImageField {
  /** Counts choices, so that a slow file does not replace a later one. */
  #reads = 0;

  static fits = (spec) => spec.dtype === "uint8" && axesOf(spec).length === 3 && axesOf(spec)[0] === 3;

  constructor(spec, id, onChange) {
    const [, height, width] = axesOf(spec);
    /** Pixels; for an axis that the card leaves open its letter. */
    this.size = { width, height };
    this.spec = spec;
    this.optional = Boolean(spec.optional);
    this.isEmpty = true;
    this.isBlackAtFirst = !this.optional && [width, height].every(Number.isInteger);
    const what = [width, height].some(Number.isInteger) ? `, ${width} × ${height} pixels` : " of any size";
    const first = this.optional ? "left out" : this.isBlackAtFirst ? "black" : "nothing is asked";
    this.hint = `A picture${what}; ${first} until you choose one`;
    this.onChange = onChange;
    this.picture = make("canvas", { className: "thumbnail" });
    this.file = make("input", { id, type: "file", accept: Object.keys(FORMATS).join() });
    this.file.addEventListener("change", () => this.#read(this.file.files[0]));
    this.note = make("p", { className: "hint" });
    this.leaveOut = make("button", { type: "button", className: "button" }, "Leave out");
    this.leaveOut.addEventListener("click", () => {
      this.file.value = "";
      this.#read();
    });
    this.control = make("div", { className: "picture" }, this.picture, make("div", {}, this.file, this.note), this.leaveOut);
    this.control.addEventListener("dragover", (event) => event.preventDefault());
    this.control.addEventListener("drop", (event) => {
      event.preventDefault();
      this.#read(event.dataTransfer.files[0]);
    });
    this.#clear();
  }

  value() {
    if (!this.picture.hidden) return this.original ?? { png: this.picture.toDataURL("image/png").split(",")[1] };
    if (this.optional) return undefined;
    throw new Error("expected a picture, got none");
  }

  /** `value`: {dtype, shape, base64} of its pixels. */
  fill(value) {
    this.#clear();
    this.#draw(drawPicture(new OffscreenCanvas(1, 1), toPicture({ range: [0, 255] }, unpack(value), [])));
  }

  #clear() {
    this.#reads++;
    this.original = null;
    this.isEmpty = true;
    this.note.textContent = "";
    this.picture.hidden = !this.isBlackAtFirst;
    this.leaveOut.hidden = true;
    if (this.isBlackAtFirst) this.#blacken(this.size);
  }

  #blacken({ width, height }) {
    Object.assign(this.picture, { width, height });
    const context = this.picture.getContext("2d");
    context.fillRect(0, 0, width, height);
    return context;
  }

  /** Draw on black, in the size of the card, or in the picture's own where the card leaves it open. */
  #draw(picture) {
    const [width, height] = ["width", "height"].map((side) => (Number.isInteger(this.size[side]) ? this.size[side] : picture[side]));
    const context = this.#blacken({ width, height });
    this.picture.hidden = this.isEmpty = false;
    this.leaveOut.hidden = !this.optional;
    context.imageSmoothingQuality = "high";
    context.drawImage(picture, 0, 0, width, height);
    return { width, height };
  }

  async #read(file) {
    this.#clear();
    const read = this.#reads;
    const [picture, bytes] = file ? await Promise.all([createImageBitmap(file), file.arrayBuffer()]).catch(() => []) : [];
    if (read !== this.#reads) return; // another one was chosen meanwhile
    if (picture) this.#show(picture, FORMATS[file.type], bytes);
    else if (file) this.note.textContent = `${file.name}: expected a PNG or JPEG picture.`;
    this.onChange();
  }

  #show(picture, format, bytes) {
    const { width, height } = this.#draw(picture);
    const fits = picture.width === width && picture.height === height;
    const isUnchanged = fits && isOpaque(picture);
    const drawn = fits ? ", drawn on black" : `, drawn to ${width} × ${height}`;
    this.note.textContent = `${picture.width} × ${picture.height} pixels${isUnchanged ? "" : drawn}`;
    // A file of the right size is sent as it is; a drawn one as PNG, which loses nothing more.
    if (isUnchanged && format) this.original = { [format]: toBase64(new Uint8Array(bytes)) };
  }
}

/** Whether no pixel is transparent; the service ignores alpha. */
function isOpaque(picture) {
  const { width, height } = picture;
  const context = new OffscreenCanvas(width, height).getContext("2d");
  context.drawImage(picture, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  for (let k = 3; k < data.length; k += 4) if (data[k] < 255) return false;
  return true;
}

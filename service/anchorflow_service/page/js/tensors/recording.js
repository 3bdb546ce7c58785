/** A recorded drive on the page: its slider fills the inputs, its street is under the anchors. */

import { byId, make, press, showFill } from "../dom.js";
import { listenForDrops } from "../share.js";
import { Street } from "./birds_eye.js";
import { DriveFile, InputMismatch } from "./drive_file.js";
import { axesOf, drawPicture, isPlaces, toPicture, unpack } from "./tensor.js";

/** Drives that this project has simulated; a planner opens with the first that has its inputs. */
const SAMPLES = ["street", "crossing"];
/** s that a frame is shown at most, for drives with gaps. */
const LONGEST_S = 1;
const KEYS = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 };
/** A picture that is wider than high by this factor is above the board, not beside it. */
const WIDE = 1.5;

export class Recording {
  drive = null;
  /** The frame of the slider. */
  index = 0;
  /** {drive, street, index, values} of the frame in the input fields; null if they are not of a drive. */
  held = null;
  /** Whether the drive is a sample. */
  #isSample = false;
  #card = null;
  #street = null;
  #playing = false;
  #movedAt = 0;
  #timer = 0;
  /** The version of the request when trouble was reported. */
  #troubleSince = 0;

  /** `view`: {active, version, inputs, surface}, on whose fields and canvas the drive is; `ask()` sends them. */
  constructor(view, ask) {
    Object.assign(this, { view, ask, slider: byId("drive-time") });
    byId("open-drive").addEventListener("click", () => byId("drive-file").click());
    byId("drive-file").addEventListener("change", () => {
      this.#read(byId("drive-file").files[0]);
      byId("drive-file").value = "";
    });
    byId("close-drive").addEventListener("click", () => {
      this.#close();
      this.ask();
    });
    byId("drive-play").addEventListener("click", () => this.#play(!this.#playing));
    this.slider.addEventListener("input", () => {
      this.#play(false);
      this.#go(Number(this.slider.value));
    });
    document.addEventListener("keydown", (event) => this.#press(event));
    listenForDrops(byId("look").querySelector(".board"), () => view.active, ([file]) => this.#read(file));
  }

  /** Another bundle is asked: the drive stays open if it has the inputs of this one; otherwise a sample is. */
  async useCard(card) {
    this.#card = card;
    this.held = null;
    this.#report(null);
    try {
      this.drive?.checkFits(card);
    } catch (error) {
      if (!this.#isSample) this.#report(error);
      this.#close();
    }
    if (this.drive) this.#go(this.index);
    else await this.#openSample(card);
  }

  async #openSample(card) {
    for (const name of SAMPLES) {
      const response = await fetch(`page/samples/${name}.json`).catch(() => null);
      const text = response?.ok ? await response.text() : "";
      if (card !== this.#card || this.drive) return; // chosen meanwhile
      try {
        const drive = new DriveFile(text, name);
        drive.checkFits(card);
        this.#open(drive, true);
        return;
      } catch {
        // The next one may fit.
      }
    }
    this.view.hasNoSample();
  }

  /** The response to a question about the frame `held` is drawn next. */
  answered({ held, version }) {
    // A question that the page asked by itself does not take the trouble away.
    if (version > this.#troubleSince) this.#report(null);
    if (held) this.#paint(held);
  }

  /** The response is on the screen: while it plays, the next frame follows in its time. */
  shown(held) {
    if (!held || !this.#playing || held.index !== this.index) return;
    const [now, next] = this.drive.frames.slice(this.index, this.index + 2);
    if (!next) {
      this.#play(false);
      return;
    }
    const due = this.#movedAt + 1e3 * Math.min(next.time_s - now.time_s, LONGEST_S);
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#go(held.index + 1), Math.max(0, due - performance.now()));
  }

  /** There is no response: stop, and show the street alone. */
  silent() {
    this.#play(false);
    if (!this.held) return;
    this.view.surface.show.anchors = null;
    this.#paint(this.held);
  }

  async #read(file) {
    if (!file) return;
    try {
      const drive = new DriveFile(await file.text(), file.name);
      this.#report(null);
      drive.checkFits(this.#card);
      this.#open(drive, false);
    } catch (error) {
      this.#report(error);
    }
  }

  #open(drive, isSample) {
    this.#play(false);
    this.drive = drive;
    this.#isSample = isSample;
    this.#street = new Street(drive);
    this.view.surface.show.anchors = null;
    this.slider.max = drive.frames.length - 1;
    this.#showBar();
    this.#go(0);
  }

  #close() {
    if (!this.drive) return;
    this.#play(false);
    this.drive = this.held = null;
    this.#showBar();
    Object.assign(this.view.surface.show, { street: null, frame: null, routes: [], anchors: null });
    byId("sensed").replaceChildren();
    byId("sensed").hidden = true;
    this.view.surface.draw();
  }

  #showBar() {
    const isOpen = this.drive !== null;
    byId("drive-bar").hidden = byId("close-drive").hidden = !isOpen;
    byId("drive-sample").hidden = !isOpen || !this.#isSample;
    byId("look").toggleAttribute("data-drive", isOpen);
  }

  /** Fill in a frame and ask; if the slider has moved on by the time it is unpacked, the newest wins. */
  async #go(index) {
    const { drive, slider } = this;
    const card = this.#card;
    this.index = index;
    this.#movedAt = performance.now();
    slider.value = index;
    const { time_s: time, command } = drive.frames[index];
    const text = `${time.toFixed(1)} s`;
    byId("drive-text").textContent = text;
    slider.setAttribute("aria-valuetext", [text, command].filter(Boolean).join(", "));
    showFill(slider);
    try {
      const values = await drive.values(index, card);
      if (drive !== this.drive || index !== this.index || card !== this.#card) return;
      this.held = { drive, street: this.#street, index, values };
    } catch (error) {
      this.#close();
      this.ask();
      this.#report(error);
      return;
    }
    this.view.inputs.fill(this.held.values);
    if (!this.view.surface.show.anchors) this.#paint(this.held);
    this.ask();
  }

  #paint({ drive, street, index, values }) {
    const { surface } = this.view;
    const given = this.#card.inputs.filter(({ name }) => values[name]?.base64);
    const routes = given.filter(isPlaces).map(({ name }) => unpack(values[name]).values);
    Object.assign(surface.show, { street, frame: drive.frames[index], routes });
    byId("drive-route").hidden = !routes.length;
    showSensed(given.filter(isPicture), values, surface.colours.classes);
    surface.draw();
  }

  #play(plays) {
    this.#playing = plays && this.drive !== null;
    clearTimeout(this.#timer);
    press("drive-play", this.#playing, this.#playing ? "Stop" : "Play", this.#playing ? "stop" : "play");
    // At its end the drive begins again.
    if (this.#playing) this.#go(this.index + 1 < this.drive.frames.length ? this.index + 1 : 0);
  }

  #press(event) {
    if (!this.drive || !this.view.active || event.ctrlKey || event.metaKey || event.altKey) return;
    // Fields and the slider have their own meaning for these keys.
    if (event.target.closest("input, textarea, select, summary")) return;
    const to = this.index + KEYS[event.key];
    if (event.key === " " && !event.target.closest("button")) this.#play(!this.#playing);
    else if (event.key in KEYS) {
      this.#play(false);
      if (this.drive.frames[to]) this.#go(to);
    } else return;
    event.preventDefault();
  }

  /** Report an error, or that there is none; beside the input too if it does not fit. */
  #report(error) {
    this.#troubleSince = this.view.version;
    byId("drive-trouble").textContent = error?.message ?? "";
    byId("drive-trouble").hidden = !error;
    if (error instanceof InputMismatch) this.view.inputs.refuse(error);
  }
}

/** Rows or columns that a picture has at least. */
const LEAST_SIDE = 16;

/** Whether an input has axes of a picture, with channels or without. */
const isPicture = (spec) =>
  !isPlaces(spec) && [2, 3].includes(axesOf(spec).length) && !axesOf(spec).slice(-2).some((side) => side < LEAST_SIDE);

/** Show the inputs of a frame that are pictures; `palette` colours the layers of those with many channels. */
function showSensed(specs, values, palette) {
  const figures = specs.map((spec) => {
    const { shape, values: numbers } = unpack(values[spec.name]);
    // Bytes keep their brightness; other values are scaled to their own greatest.
    const range = spec.dtype === "uint8" ? [0, 255] : spec.range;
    const canvas = drawPicture(make("canvas"), toPicture({ range }, { shape: [1, ...shape].slice(-3), values: numbers }, palette, true));
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${spec.name} of the drive`);
    const figure = make("figure", {}, canvas, make("figcaption", {}, spec.name));
    // Side by side they are of one height.
    figure.style.flexGrow = canvas.width / canvas.height;
    return figure;
  });
  const isWide = figures.some(({ firstChild: { width, height } }) => width > WIDE * height);
  byId("sensed").toggleAttribute("data-wide", isWide);
  byId("sensed").replaceChildren(...figures);
  byId("sensed").hidden = !figures.length;
}

/** A drive that is open: its file, the slider over its time, and what plays it. */

import { byId, showFill } from "../dom.js";
import { listenForDrops } from "../exchange.js";
import { DriveFile } from "./drive_file.js";

/** s that a frame is looked at at most, where a drive leaves something out. */
const LONGEST_S = 1;
const KEYS = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 };

export class DrivePlayer {
  drive = null;
  /** The frame that the slider stands at. */
  index = 0;
  #playing = false;
  #shownAt = 0;
  #timer = 0;

  /**
   * `isShown()`: whether the page asks with inputs; `onOpen(drive)` may throw; `onMove(index)` is
   * told where the slider stands, `onClose()` that it has gone, `onTrouble(error)` why a file is
   * not opened.
   */
  constructor({ isShown, onOpen, onMove, onClose, onTrouble }) {
    Object.assign(this, { isShown, onOpen, onMove, onClose, onTrouble });
    this.slider = byId("drive-time");
    byId("open-drive").addEventListener("click", () => byId("drive-file").click());
    byId("drive-file").addEventListener("change", () => {
      this.#read(byId("drive-file").files[0]);
      byId("drive-file").value = "";
    });
    byId("close-drive").addEventListener("click", () => this.close());
    byId("drive-play").addEventListener("click", () => this.#play(!this.#playing));
    this.slider.addEventListener("input", () => {
      this.#play(false);
      this.#go(Number(this.slider.value));
    });
    document.addEventListener("keydown", (event) => this.#press(event));
    listenForDrops(byId("look").querySelector(".board"), isShown, ([file]) => this.#read(file));
  }

  get frame() {
    return this.drive?.frames[this.index] ?? null;
  }

  close() {
    if (!this.drive) return;
    this.#play(false);
    this.drive = null;
    this.#show();
    this.onClose();
  }

  /** The frame that was asked about is on the screen: the next one comes in its time. */
  shown(index) {
    if (!this.#playing || index !== this.index) return;
    const [now, next] = [this.frame, this.drive.frames[this.index + 1]];
    if (!next) {
      this.#play(false);
      return;
    }
    const due = this.#shownAt + 1e3 * Math.min(next.time_s - now.time_s, LONGEST_S);
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#go(index + 1), Math.max(0, due - performance.now()));
  }

  /** Nothing comes back: wait for somebody to press again. */
  stop() {
    this.#play(false);
  }

  async #read(file) {
    if (!file) return;
    try {
      const drive = new DriveFile(await file.text(), file.name);
      this.onOpen(drive);
      this.#play(false);
      this.drive = drive;
      Object.assign(this.slider, { max: drive.frames.length - 1 });
      this.#show();
      this.#go(0);
    } catch (error) {
      this.onTrouble(error);
    }
  }

  #go(index) {
    this.index = index;
    this.#shownAt = performance.now();
    this.slider.value = index;
    const { time_s: time, command } = this.frame;
    const text = `${time.toFixed(1)} s`;
    byId("drive-text").textContent = text;
    this.slider.setAttribute("aria-valuetext", [text, command].filter(Boolean).join(", "));
    showFill(this.slider);
    this.onMove(index);
  }

  #play(plays) {
    this.#playing = plays && Boolean(this.drive);
    clearTimeout(this.#timer);
    const button = byId("drive-play");
    button.setAttribute("aria-pressed", this.#playing);
    button.setAttribute("aria-label", this.#playing ? "Stop" : "Play");
    button.querySelector("use").setAttribute("href", this.#playing ? "#i-stop" : "#i-play");
    // From the beginning again where it has come to its end.
    if (this.#playing) this.#go(this.index + 1 < this.drive.frames.length ? this.index + 1 : 0);
  }

  #press(event) {
    if (!this.drive || !this.isShown() || event.ctrlKey || event.metaKey || event.altKey) return;
    // What has the focus may mean something else by these keys, as the slider does.
    if (event.target.closest("input, textarea, select, summary")) return;
    if (event.key === " " && !event.target.closest("button")) this.#play(!this.#playing);
    else if (event.key in KEYS) this.#step(KEYS[event.key]);
    else return;
    event.preventDefault();
  }

  #step(by) {
    const to = this.index + by;
    this.#play(false);
    if (to >= 0 && to < this.drive.frames.length) this.#go(to);
  }

  #show() {
    byId("drive-bar").hidden = !this.drive;
    byId("close-drive").hidden = !this.drive;
    byId("look").toggleAttribute("data-drive", Boolean(this.drive));
  }
}

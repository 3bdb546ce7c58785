/** A drive before a planner: its inputs fill the fields, its street lies under the anchors. */

import { byId } from "../dom.js";
import { InputMismatch } from "./drive_file.js";
import { DrivePlayer } from "./drive_player.js";
import { hideSensed, showSensed } from "./sensed.js";
import { Street } from "./street.js";
import { isPlaces, unpacked } from "./tensor.js";

export class Drive {
  /** What the fields hold: {drive, street, index, values} of a frame; null: none of a drive. */
  held = null;
  #street = null;
  #card = null;
  /** The version of what was asked when trouble was said. */
  #saidAt = 0;

  /**
   * `isShown()`: whether the page asks with inputs; `version()` counts changes of what is asked;
   * `onFilled()`, `onClose()` are called then.
   */
  constructor({ inputs, eye, isShown, version, onFilled, onClose }) {
    Object.assign(this, { inputs, eye, version, onFilled, onClose });
    this.player = new DrivePlayer({
      isShown,
      onOpen: (drive) => this.#open(drive),
      onMove: (index) => this.#move(index),
      onClose: () => this.#leave(),
      onTrouble: (error) => this.#say(error),
    });
  }

  get isOpen() {
    return this.player.drive !== null;
  }

  /** Another bundle is asked: the drive goes on where it has what this one wants. */
  useCard(card) {
    this.#card = card;
    this.held = null;
    this.#say(null);
    const { drive, index } = this.player;
    if (!drive) return;
    try {
      drive.checkFits(card);
    } catch (error) {
      this.player.close();
      this.#say(error);
      return;
    }
    this.#move(index);
  }

  /** The answer to a question about `held` is drawn next; trouble from before a change is over. */
  answered({ held, version }) {
    // What is asked of itself when a drive is closed takes no trouble away.
    if (version > this.#saidAt) this.#say(null);
    if (held) this.#paint(held);
  }

  /** It is on the screen. */
  shown(held) {
    if (held) this.player.shown(held.index);
  }

  /** No answer comes: what is looked at is the street alone. */
  silent() {
    this.player.stop();
    if (!this.held) return;
    this.eye.show.anchors = null;
    this.#paint(this.held);
  }

  #open(drive) {
    this.#say(null);
    drive.checkFits(this.#card);
    this.#street = new Street(drive);
    this.eye.show.anchors = null;
  }

  async #move(index) {
    const { drive } = this.player;
    const card = this.#card;
    let values;
    try {
      values = await drive.values(index, card);
    } catch (error) {
      this.player.close();
      this.#say(error);
      return;
    }
    // The newest wins: meanwhile the slider may have gone on.
    if (drive !== this.player.drive || index !== this.player.index || card !== this.#card) return;
    this.held = { drive, street: this.#street, index, values };
    this.inputs.fill(values);
    if (!this.eye.show.anchors) this.#paint(this.held);
    this.onFilled();
  }

  #paint({ drive, street, index, values }) {
    const told = this.#card.inputs.filter((spec) => isPlaces(spec) && values[spec.name]?.base64);
    const routes = told.map(({ name }) => unpacked(values[name]).values);
    Object.assign(this.eye.show, { street, frame: drive.frames[index], routes });
    byId("drive-route").hidden = !routes.length;
    showSensed(this.#card, values, this.eye.colours.classes);
    this.eye.request();
  }

  #leave() {
    this.held = null;
    Object.assign(this.eye.show, { street: null, frame: null, routes: [], anchors: null });
    hideSensed();
    this.eye.request();
    this.onClose();
  }

  /** Beside the input that does not fit, too. */
  #say(error) {
    this.#saidAt = this.version();
    byId("drive-trouble").textContent = error?.message ?? "";
    byId("drive-trouble").hidden = !error;
    if (error instanceof InputMismatch) this.inputs.refuse(error);
  }
}

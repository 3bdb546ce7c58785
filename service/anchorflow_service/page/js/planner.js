/** Sends one request at a time, always about the newest scene, and waits for a service that is away. */

import { byId } from "./dom.js";
import { Refusal, ask } from "./service.js";

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8_000;
const HEARTBEAT_MS = 3_000;
/** Between requests for what the service still compiles. */
const PART_MS = 4_000;
/** Parts of a request that a service compiles after it has begun to answer. */
const PARTS = { obstacles: "people on the map", kinematics: "a robot with a shape or wheels" };
const TIME_LEFT = /about \d+ s more/;

export class Planner {
  #wanted = false;
  #wake = () => {};
  /** Whether the service answers other requests than the one that waits. */
  #isPartly = false;
  /** Whether a request is in flight, or the planner waits for the service. */
  busy = false;

  /**
   * `question()` returns {body, send, …} at the moment of sending, without a body if there is
   * nothing to send. Calls `onAnswer({question, answer, sentAt})`, `onRefusal({question, error})`,
   * `onDown({error, waitMs})` before each wait for the service, and `onUp()` when it is back.
   */
  constructor({ question, onAnswer, onRefusal, onDown, onUp }) {
    Object.assign(this, { question, onAnswer, onRefusal, onDown, onUp });
  }

  /** The scene has changed: send now, or as soon as the request in flight is answered. */
  async ask() {
    this.#wanted = true;
    if (!this.busy) await this.#run();
    // Another scene may do without what the service still compiles.
    else if (this.#isPartly) this.#wake();
  }

  /** Retry now. */
  retry() {
    this.#wake();
  }

  /** From now on, notice a service that stops between requests. */
  watch() {
    setInterval(() => this.#checkHealth(), HEARTBEAT_MS);
  }

  async #run() {
    this.busy = true;
    try {
      while (this.#wanted) {
        this.#wanted = false;
        const question = this.question();
        if (question.body) await this.#put(question);
      }
    } finally {
      this.busy = false;
    }
  }

  async #put(question) {
    const sentAt = performance.now();
    try {
      const answer = await question.send(question.body);
      this.onAnswer({ question, answer, sentAt });
    } catch (error) {
      if (error instanceof Refusal && !error.isTransient) {
        this.onRefusal({ question, error });
        return;
      }
      if (error.isPartly) await this.#waitForPart(error);
      else await this.#recover(error);
      this.#wanted = true;
    }
  }

  /** The service answers, but not this request yet. */
  async #waitForPart(error) {
    this.#isPartly = true;
    this.onDown({ error, waitMs: PART_MS });
    await this.#pause(PART_MS);
    this.#isPartly = false;
  }

  #pause(milliseconds) {
    return new Promise((resolve) => {
      this.#wake = resolve;
      setTimeout(resolve, milliseconds);
    });
  }

  /** Wait until the service takes requests again. */
  async #recover(error) {
    for (let wait = FIRST_WAIT_MS; ; wait = Math.min(2 * wait, LONGEST_WAIT_MS)) {
      const waitMs = error.retryAfterS ? 1e3 * error.retryAfterS : wait;
      this.onDown({ error, waitMs });
      await this.#pause(waitMs);
      try {
        await ask("v2/health/ready");
        this.onUp();
        return;
      } catch (again) {
        error = again;
      }
    }
  }

  async #checkHealth() {
    if (this.busy || document.hidden) return;
    try {
      await ask("v2/health/ready");
    } catch (error) {
      if (this.busy) return; // the request that was sent meanwhile finds out by itself
      this.busy = true;
      await this.#recover(error);
      this.#wanted = true;
      await this.#run();
    }
  }
}

/** The mark in the corner, and a banner while the service does not answer. */
export class Connection {
  #countdown = null;
  /** null until a bundle is known. */
  card = null;

  constructor(onRetry) {
    byId("retry").addEventListener("click", onRetry);
  }

  up() {
    clearInterval(this.#countdown);
    byId("banner").hidden = true;
    if (this.card) this.#show("up", `${this.card.name} ${this.card.version}`);
    else this.#show("wait", "Connecting");
  }

  /** The service has not answered yet. */
  wait(message) {
    this.#banner(true, `${sentence(message)} This page waits for it.`);
    byId("retry").hidden = true;
    this.#show("wait", "Waiting for the service");
  }

  down({ error, waitMs }) {
    const until = performance.now() + waitMs;
    clearInterval(this.#countdown);
    byId("retry").hidden = false;
    const reason = reasonOf(error);
    const count = () => {
      const left = Math.max(0, Math.ceil((until - performance.now()) / 1e3));
      this.#banner(error instanceof Refusal, `${reason} ${left ? `Trying again in ${left} s.` : "Trying again."}`);
    };
    count();
    this.#countdown = setInterval(count, 250);
    if (error instanceof Refusal) this.#show("wait", "Waiting for the service");
    else this.#show("down", "Not connected");
  }

  /** `waits`: the service is there, and will take requests. */
  #banner(waits, text) {
    byId("banner").toggleAttribute("data-waits", waits);
    byId("banner").hidden = false;
    if (byId("banner-text").textContent !== text) byId("banner-text").textContent = text;
  }

  #show(state, text) {
    byId("link").dataset.state = state;
    byId("link-text").textContent = text;
  }
}

/** A message as a sentence. */
const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1).replace(/\.$/, "")}.`;

/** Why a request has to wait, in plain words. */
function reasonOf(error) {
  if (error.isPartly) {
    const part = PARTS[error.field] ?? error.field;
    return `The service is still preparing for ${part}, once on this machine, for ${error.message.match(TIME_LEFT)?.[0] ?? "a while"}. Without that it answers now.`;
  }
  return sentence(error.message.replace(/; try again in \d+ s$/, "")); // the banner counts the seconds
}

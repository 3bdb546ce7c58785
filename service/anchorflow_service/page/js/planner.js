/** Sends one request at a time, always about the newest scene, and waits for a service that is away. */

import { byId } from "./dom.js";
import { Refusal, ask } from "./service.js";

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8_000;
const HEARTBEAT_MS = 3_000;

export class Planner {
  #wanted = false;
  #wake = () => {};
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
      await this.#recover(error);
      this.#wanted = true;
    }
  }

  /** Wait until the service takes requests again. */
  async #recover(error) {
    for (let wait = FIRST_WAIT_MS; ; wait = Math.min(2 * wait, LONGEST_WAIT_MS)) {
      const waitMs = error.retryAfterS ? 1e3 * error.retryAfterS : wait;
      this.onDown({ error, waitMs });
      await new Promise((resolve) => {
        this.#wake = resolve;
        setTimeout(resolve, waitMs);
      });
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
    byId("banner").hidden = false;
    byId("banner-text").textContent = message;
    this.#show("wait", "Waiting for the service");
  }

  down({ error, waitMs }) {
    const until = performance.now() + waitMs;
    clearInterval(this.#countdown);
    byId("banner").hidden = false;
    const reason = error.message.replace(/; try again in \d+ s$|\.$/, ""); // the banner counts the seconds
    const count = () => {
      const left = Math.max(0, Math.ceil((until - performance.now()) / 1e3));
      byId("banner-text").textContent = `${reason}. ${left ? `Trying again in ${left} s.` : "Trying again."}`;
    };
    count();
    this.#countdown = setInterval(count, 250);
    if (error instanceof Refusal) this.#show("wait", "Waiting for the service");
    else this.#show("down", "Not connected");
  }

  #show(state, text) {
    byId("link").dataset.state = state;
    byId("link-text").textContent = text;
  }
}

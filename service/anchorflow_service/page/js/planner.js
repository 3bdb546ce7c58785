/** Asks for anchors: one request in flight, the newest scene wins, and a stopped service is waited for. */

import { Refusal, ask } from "./service.js";

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8_000;
const HEARTBEAT_MS = 3_000;

/**
 * Fires
 *   "answer"   {question, answer, sentAt, receivedAt}
 *   "refusal"  {question, error}
 *   "down"     {error, waitMs}   the service is away; it is tried again after waitMs
 *   "up"       {}                it is back
 */
export class Planner extends EventTarget {
  #question;
  #wanted = false;
  #busy = false;
  #wake = () => {};

  /**
   * `question()` gives {body, send, …} of the newest scene at the moment of sending; without a body
   * nothing is asked. `send(body)` brings the answer.
   */
  constructor(question) {
    super();
    this.#question = question;
    setInterval(() => this.#listen(), HEARTBEAT_MS);
  }

  /** Whether a request is in flight, or the service is waited for. */
  get busy() {
    return this.#busy;
  }

  /** The scene has changed: ask now, or as soon as the request in flight is answered. */
  ask() {
    this.#wanted = true;
    if (!this.#busy) this.#run();
  }

  /** Do not wait any longer before the next try. */
  retry() {
    this.#wake();
  }

  async #run() {
    this.#busy = true;
    try {
      while (this.#wanted) {
        this.#wanted = false;
        const question = this.#question();
        if (question.body) await this.#put(question);
      }
    } finally {
      this.#busy = false;
    }
  }

  async #put(question) {
    const sentAt = performance.now();
    try {
      const answer = await question.send(question.body);
      this.#tell("answer", { question, answer, sentAt, receivedAt: performance.now() });
    } catch (error) {
      if (error instanceof Refusal && !error.passes) {
        this.#tell("refusal", { question, error });
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
      this.#tell("down", { error, waitMs });
      await new Promise((resolve) => {
        this.#wake = resolve;
        setTimeout(resolve, waitMs);
      });
      try {
        await ask("v2/health/ready");
        this.#tell("up");
        return;
      } catch (again) {
        error = again;
      }
    }
  }

  /** Notice a service that stops while nobody asks. */
  async #listen() {
    if (this.#busy || document.hidden) return;
    try {
      await ask("v2/health/ready");
    } catch (error) {
      if (this.#busy) return; // a request went out meanwhile and sees for itself
      this.#busy = true;
      await this.#recover(error);
      this.#wanted = true;
      await this.#run();
    }
  }

  #tell(type, detail = {}) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}

/** The service over HTTP: its answers, its refusals, and its silence. */

import { askForToken, authorization } from "./token.js";

const PATIENCE_MS = 30_000;

/** The contract's error JSON. */
export class Refusal extends Error {
  constructor({ code, message, field }, retryAfterS) {
    super(message);
    Object.assign(this, { code, field, retryAfterS });
  }

  /** Whether the same request may be answered later. */
  get passes() {
    return this.code === "overloaded" || this.code === "not_ready";
  }
}

/** Nobody answers there, or not in the contract's words. */
export class Unreachable extends Error {}

/** GET where `body` is missing, else POST of it as JSON; the parsed answer. */
export function ask(path, body) {
  const headers = { "Content-Type": "application/json" };
  const post = { method: "POST", headers, body: JSON.stringify(body) };
  return send(path, body === undefined ? {} : post, (response) => response.json());
}

/** What `read(response)` makes of an answer. Rejects with a `Refusal` or as `Unreachable`. */
export async function send(path, options, read) {
  for (;;) {
    try {
      return await sendOnce(path, options, read);
    } catch (error) {
      if (error.code !== "unauthorized") throw error;
      await askForToken(error.message);
    }
  }
}

async function sendOnce(path, options, read) {
  let response, answer;
  try {
    const signal = AbortSignal.timeout(PATIENCE_MS);
    const headers = { ...options.headers, ...authorization() };
    response = await fetch(path, { ...options, headers, signal, cache: "no-store" });
    answer = await (response.ok ? read(response) : response.json());
  } catch (cause) {
    throw new Unreachable("The service does not answer.", { cause });
  }
  if (response.ok) return answer;
  if (!answer?.error?.message) throw new Unreachable(`Status ${response.status} without the contract's error JSON.`);
  throw new Refusal(answer.error, Number(response.headers.get("Retry-After")) || undefined);
}

/** The bearer token of a service that asks for one; kept until the tab is closed. */

import { byId } from "./dom.js";

const KEY = "anchorflow-token";
/** What no header can carry, such as an invisible space that was copied along. */
const FOREIGN = /[^ -\xff]/u;
let asking = null;

/** What goes with every request: {Authorization}, or nothing. */
export function authorization() {
  const token = sessionStorage.getItem(KEY);
  return token ? { Authorization: `Bearer ${token}` } : {};
}

/** Shows why a token is needed and resolves when one has been given; one question for all who wait. */
export function askForToken(why) {
  byId("token-why").textContent = why;
  asking ??= new Promise((resolve) => {
    const form = byId("token-form");
    form.hidden = false;
    byId("token").focus();
    form.onsubmit = (event) => {
      event.preventDefault();
      const token = byId("token").value.trim();
      const foreign = token.match(FOREIGN);
      if (foreign) {
        byId("token-why").textContent = `token: expected characters of Latin-1, got ${codePoint(foreign[0])} in place ${foreign.index + 1}`;
        return;
      }
      sessionStorage.setItem(KEY, token);
      form.hidden = true;
      asking = null;
      resolve();
    };
  });
  return asking;
}

const codePoint = (character) => `U+${character.codePointAt(0).toString(16).toUpperCase().padStart(4, "0")}`;

/** The bearer token of a service that asks for one; kept until the tab is closed. */

import { byId } from "./dom.js";

const KEY = "anchorflow-token";
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
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      sessionStorage.setItem(KEY, byId("token").value.trim());
      form.hidden = true;
      asking = null;
      resolve();
    }, { once: true });
  });
  return asking;
}

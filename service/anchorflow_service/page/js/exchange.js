/** In and out: dropped files; requests for other programs, by way of the clipboard. */

import { byId, make } from "./dom.js";
import { authorization } from "./token.js";

/** Where a copied request finds the token; the token itself is not copied. */
const TOKEN = "ANCHORFLOW_TOKEN";
const needsToken = () => "Authorization" in authorization();

/** A request in JSON, for a shell; nothing in it is the shell's. */
export function toCurl(json) {
  const url = new URL("anchors", document.baseURI);
  const token = needsToken() ? ` -H "Authorization: Bearer $${TOKEN}"` : "";
  return `curl -s ${url} -H 'Content-Type: application/json'${token} --data-binary @- <<'JSON'\n${json}JSON\n`;
}

/** A value of JSON as Python writes it. */
export function python(value) {
  if (typeof value === "boolean") return value ? "True" : "False";
  if (Array.isArray(value)) return `[${value.map(python).join(", ")}]`;
  if (value && typeof value === "object") {
    return `{${Object.entries(value).map(([key, part]) => `${python(key)}: ${python(part)}`).join(", ")}}`;
  }
  return value === null ? "None" : JSON.stringify(value);
}

/** {imports, opened}: what opens a client in Python; `options`: arguments beyond address and token. */
export function pythonClient(options = []) {
  const address = new URL(".", document.baseURI).href.replace(/\/$/, "");
  const token = needsToken() ? [`token=os.environ["${TOKEN}"]`] : [];
  const given = [`"${address}"`, ...options, ...token].join(", ");
  return { imports: token.length ? "import os\n\n" : "", opened: `AnchorClient(${given})` };
}

/** Keyword arguments, a line each. */
export function pythonArguments(fields, indent) {
  return Object.entries(fields).map(([name, value]) => `${indent}${name}=${python(value)},\n`).join("");
}

/** The buttons that copy: `write.curl()` and `write.python()` give what is copied. */
export function listenForCopies(isShown, write) {
  const buttons = { "copy-curl": ["curl", write.curl], "copy-python": ["Python", write.python] };
  for (const [id, [name, text]] of Object.entries(buttons)) {
    byId(id).addEventListener("click", async () => {
      if (!isShown()) return;
      try {
        await copy(text());
        byId("scene-note").textContent = `Copied for ${name}${needsToken() ? `; it takes the token from ${TOKEN}` : ""}.`;
      } catch (error) {
        byId("scene-note").textContent = error.message;
      }
    });
  }
}

/** `read(files)` gets what is dropped anywhere on the page while `isShown()`; the board says so. */
export function listenForDrops(board, isShown, read) {
  const root = document.documentElement;
  for (const type of ["dragenter", "dragover"]) {
    root.addEventListener(type, (event) => {
      if (!isShown() || !event.dataTransfer.types.includes("Files")) return;
      // An input may take it for itself.
      board.toggleAttribute("data-drop", !event.defaultPrevented);
      event.preventDefault();
    });
  }
  root.addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) board.removeAttribute("data-drop");
  });
  root.addEventListener("drop", (event) => {
    board.removeAttribute("data-drop");
    if (!isShown() || event.defaultPrevented || !event.dataTransfer.files.length) return;
    event.preventDefault();
    read([...event.dataTransfer.files]);
  });
}

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    copyBySelection(text);
  }
}

/** The clipboard is closed to pages that came over plain HTTP from another machine. */
function copyBySelection(text) {
  const focused = document.activeElement;
  const field = make("textarea", { value: text, className: "unseen" });
  document.body.append(field);
  field.select();
  document.execCommand("copy");
  field.remove();
  focused.focus();
}

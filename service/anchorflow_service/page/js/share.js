/** Requests as text for a shell and for Python, the clipboard, and files that are dropped on the page. */

import { byId, make, note } from "./dom.js";
import { authorization } from "./service.js";

/** The environment variable from which a copied request reads the token; the token itself is not copied. */
const TOKEN = "ANCHORFLOW_TOKEN";
const needsToken = () => "Authorization" in authorization();

/** A request in JSON as a command for a shell. */
export function toCurl(json) {
  const token = needsToken() ? ` -H "Authorization: Bearer $${TOKEN}"` : "";
  return `curl -s ${new URL("anchors", document.baseURI)} -H 'Content-Type: application/json'${token} --data-binary @- <<'JSON'\n${json}JSON\n`;
}

/** A value of JSON as a literal of Python. */
export function python(value) {
  if (typeof value === "boolean") return value ? "True" : "False";
  if (Array.isArray(value)) return `[${value.map(python).join(", ")}]`;
  if (value && typeof value === "object") {
    return `{${Object.entries(value).map(([key, part]) => `${python(key)}: ${python(part)}`).join(", ")}}`;
  }
  return value === null ? "None" : JSON.stringify(value);
}

/** A program that calls `plan` with `named` arguments, whose text is given, and with `fields`. */
export function pythonProgram({ imports, before = "", options = [], named, fields, after }) {
  const address = new URL(".", document.baseURI).href.replace(/\/$/, "");
  const token = needsToken() ? [`token=os.environ["${TOKEN}"]`] : [];
  const keywords = Object.entries(fields).map(([name, value]) => `        ${name}=${python(value)},\n`);
  return `${token.length ? "import os\n\n" : ""}${imports}
${before}
with AnchorClient(${[`"${address}"`, ...options, ...token].join(", ")}) as client:
    anchors = client.plan(
${named}${keywords.join("")}    )

${after}
print(anchors.trajectories[anchors.best])
`;
}

/** The buttons that copy the request: `write.curl()` and `write.python()` return the text. */
export function listenForCopies(isShown, write) {
  const buttons = { "copy-curl": ["curl", write.curl], "copy-python": ["Python", write.python] };
  for (const [id, [name, text]] of Object.entries(buttons)) {
    byId(id).addEventListener("click", async () => {
      if (!isShown()) return;
      try {
        await copy(text());
        note(`Copied for ${name}${needsToken() ? `; it takes the token from ${TOKEN}` : ""}.`);
      } catch (error) {
        note(error.message);
      }
    });
  }
}

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    // Browsers close the clipboard to pages that came over plain HTTP from another machine.
    const focused = document.activeElement;
    const field = make("textarea", { value: text, className: "unseen" });
    document.body.append(field);
    field.select();
    document.execCommand("copy");
    field.remove();
    focused.focus();
  }
}

/** `read(files)` gets the files that are dropped anywhere on the page while `isShown()`. */
export function listenForDrops(board, isShown, read) {
  const root = document.documentElement;
  for (const type of ["dragenter", "dragover"]) {
    root.addEventListener(type, (event) => {
      if (!isShown() || !event.dataTransfer.types.includes("Files")) return;
      // An input field may handle the drop by itself.
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

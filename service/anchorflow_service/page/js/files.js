/** Open, drop, save and copy scenes. */

import { byId, make } from "./dom.js";
import { fromJson, toCurl, toJson, toPython } from "./exchange.js";
import { readMap } from "./maps.js";

export class Files {
  constructor(scene, controls) {
    Object.assign(this, { scene, controls });
    byId("open").addEventListener("click", () => byId("files").click());
    byId("files").addEventListener("change", () => {
      this.#read([...byId("files").files]);
      byId("files").value = "";
    });
    byId("save").addEventListener("click", () => this.#save());
    byId("copy-curl").addEventListener("click", () => this.#copy(toCurl, "curl"));
    byId("copy-python").addEventListener("click", () => this.#copy(toPython, "Python"));
    this.#listenForDrops(byId("board"));
  }

  #listenForDrops(board) {
    for (const type of ["dragenter", "dragover"]) {
      board.addEventListener(type, (event) => {
        event.preventDefault();
        board.dataset.drop = "";
      });
    }
    board.addEventListener("dragleave", (event) => {
      if (!board.contains(event.relatedTarget)) delete board.dataset.drop;
    });
    board.addEventListener("drop", (event) => {
      event.preventDefault();
      delete board.dataset.drop;
      this.#read([...event.dataTransfer.files]);
    });
  }

  async #read(files) {
    if (!files.length) return;
    try {
      const json = files.find((file) => /\.json$/i.test(file.name));
      if (json) {
        const { grid, ends, options } = fromJson(await json.text(), this.scene.card);
        Object.assign(this.scene.options, options);
        this.#show(grid, ends, `${json.name} is open.`);
      } else if (files.some((file) => /\.(pgm|png|ya?ml)$/i.test(file.name))) {
        const { grid, note } = await readMap(files);
        this.#show(grid, undefined, note);
      } else {
        throw new Error(`${files[0].name}: expected .json, .yaml with its picture, .pgm or .png.`);
      }
    } catch (error) {
      this.#say(error.message);
    }
  }

  #show(grid, ends, note) {
    byId("sample").value = "own";
    this.scene.useMap(grid, ends);
    this.controls.show();
    this.#say(note);
  }

  #save() {
    const url = URL.createObjectURL(new Blob([toJson(this.scene.request())], { type: "application/json" }));
    make("a", { href: url, download: "anchorflow-scene.json" }).click();
    URL.revokeObjectURL(url);
    this.#say("Saved: the file is a request that POST /anchors takes.");
  }

  async #copy(write, name) {
    const text = write(this.scene.request());
    try {
      await navigator.clipboard.writeText(text);
      this.#say(`Copied for ${name}.`);
    } catch {
      copyBySelection(text);
      this.#say(`Copied for ${name}.`);
    }
  }

  #say(text) {
    byId("scene-note").textContent = text;
  }
}

/** The clipboard is closed to pages that came over plain HTTP from another machine. */
function copyBySelection(text) {
  const field = make("textarea", { value: text, className: "unseen" });
  document.body.append(field);
  field.select();
  document.execCommand("copy");
  field.remove();
}

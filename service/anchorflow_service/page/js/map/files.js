/** Open, drop, save and copy scenes. */

import { byId, make } from "../dom.js";
import { listenForCopies, listenForDrops, toCurl } from "../exchange.js";
import { readMap } from "./maps.js";
import { fromRequest, parse, toJson, toPython } from "./scene_json.js";

export class Files {
  /** `isShown()`: whether scenes are what the page is about; `onOpen()`: one is about to be shown. */
  constructor(scene, controls, models, { isShown, onOpen }) {
    Object.assign(this, { scene, controls, models, onOpen });
    byId("open").addEventListener("click", () => byId("files").click());
    byId("files").addEventListener("change", () => {
      this.#read([...byId("files").files]);
      byId("files").value = "";
    });
    byId("save").addEventListener("click", () => this.#save());
    listenForCopies(isShown, {
      curl: () => toCurl(toJson(scene.request())),
      python: () => toPython(scene.request()),
    });
    listenForDrops(byId("board"), isShown, (files) => this.#read(files));
  }

  async #read(files) {
    if (!files.length) return;
    try {
      const json = files.find((file) => /\.json$/i.test(file.name));
      if (json) {
        const text = await json.text();
        this.#open(json.name, naming(json.name, () => parse(text)));
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

  /** A scene, asked of the bundle that it names; what it does not give is the bundle's own. */
  #open(name, request) {
    if (typeof request.format === "string") throw new Error(`${name} is no scene but of the format ${request.format}: choose ${bundleOf(request)} first.`);
    const named = this.models.like(request.model);
    const card = named ?? this.scene.card;
    const { grid, ends, options, left } = naming(name, () => fromRequest(request, card.answer.components.length));
    if (request.model && !named) left.push(`model, as no ${request.model} with a map is served`);
    if (card.name === this.scene.card.name) this.scene.useCard(this.scene.card);
    else this.models.choose(card);
    Object.assign(this.scene.options, options);
    this.#show(grid, ends, `${name} is open.${left.length ? ` Left out: ${left.join(", ")}.` : ""}`);
  }

  #show(grid, ends, note) {
    this.onOpen();
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

  #say(text) {
    byId("scene-note").textContent = text;
  }
}

/** What `read()` gives; what it throws names the file. */
function naming(name, read) {
  try {
    return read();
  } catch (cause) {
    throw new Error(`${name}: ${cause.message}`, { cause });
  }
}

/** In words, which bundle a file of another format, such as a drive, is for. */
function bundleOf({ bundle }) {
  return typeof bundle === "string" ? `the bundle ${bundle}` : "the bundle that it is for";
}

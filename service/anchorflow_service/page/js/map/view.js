/** The view of planners with a cost map: one draws a scene, and the anchors follow. */

import { Anchors } from "../anchors.js";
import { byId, clamp, make, note, press } from "../dom.js";
import { drawCharts, say } from "../figures.js";
import { plan } from "../service.js";
import { listenForCopies, listenForDrops, toCurl } from "../share.js";
import { AnchorView } from "../view.js";
import { BodyControl } from "./body.js";
import { readMap } from "./map_files.js";
import { TimeBar } from "./people.js";
import { EndFields, tellPlace } from "./places.js";
import { Replay } from "./replay.js";
import { Robot } from "./robot.js";
import { sampleMap } from "./samples.js";
import { Scene } from "./scene.js";
import { readScene, toJson, toPython } from "./scene_file.js";
import { Stage } from "./stage.js";
import { StyleControl } from "./style.js";
import { Handles, Painting } from "./tools.js";
import { Zoom } from "./zoom.js";

/** The number of the sample that is shown first, by kind; the dice counts on from here. */
const FIRST_SAMPLE = { forest: 5, rooms: 4, city: 5, maze: 2, empty: 0 };
/** What an anchor can be coloured by, and the array of the response that it needs. */
const COLOURED = { score: "scores", speed: "velocities", clearance: "clearance" };
/** Fields of a request that have a place on the map, and what helps. */
const PLACES = { x_goal: "goal", x_curr: "start" };
const ADVICE = { goal: "Drag it to free ground, or set a goal tolerance.", start: "Drag it to free ground, or switch on Clear start." };
/** Refusals that are not about one field, in plain words. */
const CODES = {
  too_large: "The map is too large for this service.",
  deadline_exceeded: "The time budget ran out.",
  unknown_model: "This bundle is no longer served.",
  internal: "The service failed; its log says why.",
};
const FIELDS = { cost_map: "The map cannot be used.", obstacles: "The people cannot be used.", footprint: "The shape of the robot cannot be used." };

export class MapView extends AnchorView {
  #samples = { ...FIRST_SAMPLE };
  /** The question whose answer is on the screen. */
  #answered = null;

  constructor({ planner, form, bundles }) {
    const scene = new Scene(form.fields);
    super(new Stage(byId("canvas"), scene), byId("legend"));
    Object.assign(this, { planner, form, bundles, scene });
    this.handles = new Handles(this.surface, scene);
    this.ends = new EndFields(scene);
    this.painting = new Painting(this.surface, scene, new Zoom(this.surface), {
      onHover: (left, top) => this.#hover(left, top),
      onPlace: (at) => tellPlace(scene.grid, at),
      onPerson: () => this.handles.selectLast(),
    });
    this.timeBar = new TimeBar(this.surface, scene);
    this.bubble = new Bubble(this.surface, scene);
    this.style = new StyleControl((style) => this.#set({ style }));
    this.body = new BodyControl((body) => this.#set({ body }));
    this.replay = new Replay(this.surface, () => press("replay", false, "Replay the flow"));
    this.robot = new Robot(this.surface, scene, {
      ask: () => planner.busy || planner.ask(),
      onFrame: (note) => this.#showRobot(note),
    });
    this.surface.onFit = () => {
      byId("zoom-all").disabled = this.surface.zoom === 1;
      this.handles.place();
      this.bubble.place();
    };
    this.#listen();
  }

  #listen() {
    const isShown = () => this.active;
    this.scene.onChange((what) => this.#changed(what));
    byId("drive").addEventListener("click", () => this.#toggleDrive());
    byId("replay").addEventListener("click", () => this.#toggleReplay());
    byId("sample").addEventListener("change", () => this.#showSample(0));
    byId("another").addEventListener("click", () => this.#showSample(1));
    document.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.#rest();
    });
    for (const radio of document.querySelectorAll("[name=colour]")) {
      radio.addEventListener("change", () => {
        this.surface.show.colourBy = radio.value;
        this.showAnchors();
        this.surface.draw();
      });
    }
    byId("open").addEventListener("click", () => byId("files").click());
    byId("files").addEventListener("change", () => {
      this.#read([...byId("files").files]);
      byId("files").value = "";
    });
    byId("save").addEventListener("click", () => this.#save());
    const { scene } = this;
    listenForCopies(isShown, { curl: () => toCurl(toJson(scene.request())), python: () => toPython(scene.request()) });
    listenForDrops(byId("board"), isShown, (files) => this.#read(files));
  }

  get card() {
    return this.scene.card;
  }

  /** Ask another bundle; the map stays. */
  useCard(card) {
    this.active = true;
    this.#rest();
    this.clear();
    this.timeBar.fit(null);
    this.bubble.clear();
    this.scene.useCard(card);
    this.#showForm();
    const gives = (...names) => names.every((name) => card.answer.arrays.includes(name));
    byId("drive").disabled = !gives("velocities", "accelerations");
    for (const [by, array] of Object.entries(COLOURED)) document.querySelector(`[name=colour][value=${by}]`).disabled = !gives(array);
    if (this.scene.grid) this.scene.changed("options");
    else this.#useMap(sampleMap("forest", FIRST_SAMPLE.forest));
  }

  leave() {
    this.active = false;
    this.#rest();
  }

  /** Take options of the form. */
  choose(options) {
    this.scene.choose(options);
    this.#set({});
  }

  #set(parts) {
    Object.assign(this.scene, parts);
    this.#showForm();
    this.scene.changed("options");
  }

  #showForm() {
    const { scene, card } = this;
    this.form.show(scene.options, card, scene.unused);
    this.style.show(scene.style);
    this.body.show(scene.body);
    this.ends.show();
    const { horizon_s: horizon } = card.conditioning.limits;
    byId("bundle-hint").textContent = `What answers: ${horizon === null ? "each anchor in its own time" : `${horizon} s`}, in ${card.time.steps} steps.`;
  }

  /** The request about the scene as it is now. */
  question() {
    const { scene, robot } = this;
    const { card, limits } = scene;
    const asked = robot.active ? robot.question() : { body: scene.request() };
    return { ...asked, send: plan, card, limits, driven: robot.active };
  }

  #changed(what) {
    this.replay.end();
    if (what === "map" || what === "options") this.surface.redraw();
    if (what === "map") this.kept = null;
    byId("replay").disabled = !this.scene.hasFlow || this.robot.active;
    this.surface.drawTop();
    if (this.active && !this.robot.active) this.planner.ask();
  }

  async answered({ question, answer, sentAt }) {
    if (question.card !== this.card || question.driven !== this.robot.active) return;
    this.replay.end();
    const anchors = new Anchors(answer, question.card, question.limits);
    this.#answered = question;
    this.bubble.clear();
    if (this.robot.active) this.robot.take(anchors, question);
    this.timeBar.fit(Math.max(...anchors.order.map((n) => anchors.duration(n))));
    await this.present(anchors, { card: question.card, sentAt });
  }

  refused({ error }) {
    if (this.robot.active) this.robot.refused(error.message);
    const label = this.form.fields.all.find(({ path }) => path === error.field)?.label;
    this.bubble.refuse(error, label ? `${label}: this value cannot be used.` : undefined);
    this.#fadeBecause("The service refused");
  }

  down() {
    this.#fadeBecause("Waiting for the service");
  }

  #fadeBecause(reason) {
    say(`${reason}${this.surface.show.anchors ? ": what is shown is its last answer" : ""}.`);
    this.fade();
  }

  summarize({ count, numSafe, reason, durationsText }) {
    say(numSafe ? `${numSafe} of ${count} anchors are safe, ${durationsText}.` : `${reason || "no anchor is safe"}.`.replace(/^n/, "N"));
  }

  showDetails(anchors, n, step) {
    drawCharts(anchors, n, step);
  }

  #hover(left, top) {
    if (!this.replay.active && !this.robot.active) this.hover(left, top);
  }

  #showSample(further) {
    const kind = byId("sample").value === "own" ? "forest" : byId("sample").value;
    this.#rest();
    this.#samples[kind] += further;
    byId("sample").value = kind;
    this.#useMap(sampleMap(kind, this.#samples[kind]));
  }

  #useMap(...parts) {
    this.scene.useMap(...parts);
    this.surface.showAll();
  }

  #toggleDrive() {
    if (this.robot.active) {
      this.#rest();
      return;
    }
    this.replay.end();
    this.kept = null;
    this.surface.show.focus = null;
    byId("board").dataset.drive = "";
    press("drive", true, "Stop", "stop");
    this.timeBar.rewind();
    byId("replay").disabled = true;
    this.robot.begin();
  }

  #showRobot(note) {
    byId("drive-note").hidden = false;
    if (byId("drive-note").textContent !== note) byId("drive-note").textContent = note;
    this.handles.place();
    this.ends.show();
  }

  async #toggleReplay() {
    const { anchors } = this.surface.show;
    const isOpen = byId("replay").getAttribute("aria-pressed") === "true";
    this.replay.end();
    if (isOpen || !anchors) return;
    press("replay", true, "Close");
    try {
      await this.replay.begin(this.#answered, anchors);
    } catch (error) {
      say(error.message);
      press("replay", false, "Replay the flow");
    }
  }

  /** End the drive and the replay. */
  #rest() {
    this.replay.end();
    if (!this.robot.active) return;
    this.robot.end();
    delete byId("board").dataset.drive;
    byId("drive-note").hidden = true;
    press("drive", false, "Drive", "play");
    this.scene.changed("ends");
  }

  async #read(files) {
    if (!files.length) return;
    try {
      const json = files.find(({ name }) => /\.json$/i.test(name));
      if (json) this.#openScene(json.name, await json.text());
      else if (files.some(({ name }) => /\.(pgm|png|ya?ml)$/i.test(name))) {
        const { grid, note: text } = await readMap(files);
        this.#openMap(grid, {}, text);
      } else throw new Error(`${files[0].name}: expected .json, .yaml with its picture, .pgm or .png.`);
    } catch (error) {
      note(error.message);
    }
  }

  /** Open a scene for the bundle that it names, if that is served. */
  #openScene(name, text) {
    const { card, grid, ends, people, body, style, options, left } = readScene(name, text, this.card, this.bundles, this.form.fields);
    if (card.name !== this.card.name) this.bundles.choose(card);
    else this.scene.useCard(card);
    Object.assign(this.scene.options, options);
    Object.assign(this.scene, { body, ...(style ? { style } : {}) });
    this.#openMap(grid, { ends, people }, `${name} is open.${left.length ? ` Left out: ${left.join(", ")}.` : ""}`);
  }

  #openMap(grid, { ends, people }, text) {
    this.#rest();
    byId("sample").value = "own";
    this.#useMap(grid, ends, people);
    this.#showForm();
    note(text);
  }

  #save() {
    const url = URL.createObjectURL(new Blob([toJson(this.scene.request())], { type: "application/json" }));
    make("a", { href: url, download: "anchorflow-scene.json" }).click();
    URL.revokeObjectURL(url);
    note("Saved: the file is a request that POST /anchors takes.");
  }
}

/** The reason for a refusal, beside the place on the map that it is about. */
class Bubble {
  constructor(stage, scene) {
    Object.assign(this, { stage, scene });
    scene.onChange(() => this.place());
  }

  clear() {
    byId("bubble").hidden = true;
  }

  refuse({ code, field, message }, labelled) {
    const [group] = field?.split(".") ?? [];
    this.at = PLACES[group] ?? null;
    const title = this.at ? `The ${this.at} cannot be there.` : labelled ?? FIELDS[group] ?? CODES[code] ?? "The service refused.";
    byId("bubble").replaceChildren(make("b", {}, title), ...(this.at ? [`${ADVICE[this.at]} `] : []), make("span", {}, message));
    byId("bubble").hidden = false;
    this.place();
  }

  /** Stay on the board, above or below the place. */
  place() {
    const bubble = byId("bubble");
    if (bubble.hidden) return;
    const { width, height } = this.stage;
    const end = this.at && this.scene[this.at];
    const [left, top] = end ? this.stage.toScreen(end.x, end.y) : [width / 2, 60];
    const { offsetWidth: wide, offsetHeight: tall } = bubble;
    const x = clamp(left - wide / 2, 10, Math.max(10, width - wide - 10));
    const y = top - tall - 26 > 8 ? top - tall - 26 : top + 26;
    bubble.style.transform = `translate(${x}px, ${clamp(y, 8, Math.max(8, height - tall - 8))}px)`;
  }
}

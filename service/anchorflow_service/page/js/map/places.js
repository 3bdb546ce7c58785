/** Places as numbers: under the pointer, and the start and the goal, which one can type. */

import { byId, figure } from "../dom.js";
import { UNKNOWN } from "./grid.js";

/** How the soft layers are named. */
const LAYERS = { traversability: "hard ground", risk: "risk", further: "further cost" };
const DECIMALS = 2;
const degrees = (radians) => (radians * 180) / Math.PI;
/** The inputs of an end; a heading is between −180° and 180°. */
const PARTS = {
  x: { read: ({ x }) => x, write: (scene, end, x) => scene.put(end, [x, end.y]) },
  y: { read: ({ y }) => y, write: (scene, end, y) => scene.put(end, [end.x, y]) },
  heading: {
    read: (end, scene) => degrees(Math.atan2(Math.sin(scene.headingOf(end)), Math.cos(scene.headingOf(end)))),
    write: (scene, end, angle) => scene.turn(end, (angle * Math.PI) / 180, Math.hypot(end.vx, end.vy)),
  },
};

/** What is at a point of a grid: its obstacle, or the soft costs of its layers. */
export function groundAt(grid, x, y) {
  const [row, column] = grid.toCells(x, y).map(Math.floor);
  if (!grid.contains(row, column)) return "off the map";
  const cell = grid.at(row, column);
  if (cell) return cell === UNKNOWN ? "unknown" : "obstacle";
  const costs = Object.entries(LAYERS).map(([layer, name]) => [name, grid.softAt(layer, row, column)]);
  return costs.filter(([, cost]) => cost).map(([name, cost]) => `${name} ${figure(cost, 1)}`).join(", ") || "free";
}

/** Tell where the pointer is, [x, y] in m; null: nowhere. */
export function tellPlace(grid, at) {
  byId("cursor").hidden = !at;
  if (at) byId("cursor").value = `${at.map((value) => figure(value)).join(", ")} m · ${groundAt(grid, ...at)}`;
}

export class EndFields {
  constructor(scene) {
    this.scene = scene;
    this.inputs = [...document.querySelectorAll("[data-end]")].map((input) => {
      const { end, part } = input.dataset;
      input.addEventListener("change", () => {
        if (Number.isFinite(input.valueAsNumber)) PARTS[part].write(scene, scene[end], input.valueAsNumber);
        this.show();
      });
      return { input, end, ...PARTS[part], part };
    });
    scene.onChange(() => this.show());
  }

  show() {
    const { scene } = this;
    if (!scene.grid) return;
    byId("ends").toggleAttribute("data-turns", scene.hasBody);
    const drives = "drive" in byId("board").dataset;
    for (const { input, end, part, read } of this.inputs) {
      input.closest("label").hidden = part === "heading" && !scene.hasBody;
      input.disabled = drives && end === "start"; // the robot moves it
      const text = Number(read(scene[end], scene).toFixed(part === "heading" ? 0 : DECIMALS));
      if (input.valueAsNumber !== text) input.value = text;
    }
  }
}

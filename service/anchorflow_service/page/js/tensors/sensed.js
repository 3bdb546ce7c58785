/** What the sensors saw: a picture of every input of a drive that is one. */

import { byId, make } from "../dom.js";
import { Raster } from "./raster.js";
import { axesOf, isPlaces, unpacked } from "./tensor.js";

/** Times as wide as high, from which on a picture does not stand beside another. */
const WIDE = 2;

/** Axes of a picture, with channels or without, along which there are more than a few values. */
const isPicture = (spec) => !isPlaces(spec) && [2, 3].includes(axesOf(spec).length) && axesOf(spec).slice(-2).every((size) => size > 1);

/** Show them beside the scene; `palette` colours the layers of those with many channels. */
export function showSensed(card, values, palette) {
  const figures = card.inputs.filter((spec) => isPicture(spec) && values[spec.name]?.base64).map((spec) => {
    const { shape, values: numbers } = unpacked(values[spec.name]);
    const channels = { shape: [1, ...shape].slice(-3), values: numbers };
    const raster = new Raster(pictured(spec), channels, palette, true);
    const canvas = make("canvas", { width: raster.width, height: raster.height });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${spec.name} of the drive`);
    canvas.getContext("2d").drawImage(raster.canvas, 0, 0);
    return make("figure", {}, canvas, make("figcaption", {}, spec.name));
  });
  const isWide = figures.some(({ firstChild: { width, height } }) => width > WIDE * height);
  byId("sensed").toggleAttribute("data-wide", isWide);
  byId("sensed").replaceChildren(...figures);
  byId("sensed").hidden = !figures.length;
}

export function hideSensed() {
  byId("sensed").replaceChildren();
  byId("sensed").hidden = true;
}

/** Bytes are as bright as they are, not as bright as the brightest of them. */
const pictured = (spec) => (spec.dtype === "uint8" ? { ...spec, range: [0, 255] } : spec);

/** Colours, as the style sheet has them for the light or the dark theme. */

import { clamp } from "./dom.js";

/** Colours in a ramp that lines are sorted into; one stroke each. */
export const SHADES = 24;

const NAMES = ["map", "grid", "wall", "halo", "unknown", "outline", "focus", "start", "goal", "ink", "soft", "accent", "bad", "card", "verge", "road", "zebra"];
const RAMPS = ["score", "speed", "clearance"];

/** {map: "#…", …, ramps: {score: [SHADES colours], …}, classes: [[r, g, b]]} of the theme that is shown. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => style.getPropertyValue(`--${name}`).trim();
  const list = (name) => read(name).split(/,\s*/);
  const ramps = RAMPS.map((name) => [name, spread(list(`ramp-${name}`))]);
  const classes = list("classes").map(channels);
  return { ...Object.fromEntries(NAMES.map((name) => [name, read(name)])), ramps: Object.fromEntries(ramps), classes };
}

/** Which of SHADES a value between low and high has. */
export function shade(value, low, high) {
  const share = high > low ? (value - low) / (high - low) : 1;
  return clamp(Math.floor(share * SHADES), 0, SHADES - 1);
}

/** SHADES colours between the stops "#rrggbb". */
function spread(stops) {
  const parts = stops.map(channels);
  return Array.from({ length: SHADES }, (_, k) => {
    const place = (k / (SHADES - 1)) * (parts.length - 1);
    const at = Math.min(Math.floor(place), parts.length - 2);
    const mixed = parts[at].map((low, axis) => Math.round(low + (place - at) * (parts[at + 1][axis] - low)));
    return `rgb(${mixed.join(" ")})`;
  });
}

/** [r, g, b] of "#rrggbb". */
function channels(colour) {
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
}

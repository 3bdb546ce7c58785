/** What the tests of the page's modules share: references from Python, cards, and comparisons. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";

export const references = JSON.parse(readFileSync(process.env.REFERENCES, "utf8"));

/** The parts of a card with a map that the page reads. */
export const mapCard = {
  name: "flowmp",
  conditioning: {
    kind: "cost_map",
    limits: { horizon_s: null, v_max: 2, a_max: 3, robot_radius: 0.25 },
    ranges: { robot_radius: [0.1, 0.6], v_max: [0.2, 6], a_max: [0.3, 8], horizon_s: [1, 120] },
  },
  sampler: { kind: "ode", method: "rk4", schedule: [0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1] },
  finish: { kind: "spline", smooth: true, project: true, safety_margin: 0.1, guidance: 0, barrier: false, certified_margin: 0 },
  answer: { components: ["x", "y"] },
};
/** The same for a planner without a map. */
export const tensorCard = {
  name: "goalflow",
  conditioning: { kind: "tensors" },
  sampler: { kind: "vocabulary", size: 6 },
  finish: { kind: "none" },
  answer: { components: ["x", "y", "heading"] },
};

/** Numbers are equal up to a tolerance. */
export function close(actual, expected, tolerance = 1e-6) {
  assert.equal(actual.length, expected.length);
  Array.from(expected).forEach((value, k) => assert.ok(Math.abs(actual[k] - value) <= tolerance, `${k}: ${actual[k]} is not ${value}`));
}

export const range = (count) => Array.from({ length: count }, (_, k) => k);

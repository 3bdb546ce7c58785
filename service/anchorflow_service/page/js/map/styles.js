/** The named styles of the contract: weights of safety, energy and smoothness. */

export const STYLES = {
  conservative: [0.8, 0.1, 0.1],
  balanced: [0.4, 0.3, 0.3],
  efficient: [0.1, 0.8, 0.1],
  comfortable: [0.1, 0.1, 0.8],
};
/** What weights without a name are called. */
export const CUSTOM = "custom";
/** By which weights of one style may differ. */
const ROUNDING = 1e-3;

/** The name of these weights. */
export function styleName(weights) {
  const same = ([, own]) => own.every((weight, k) => Math.abs(weight - weights[k]) < ROUNDING);
  return Object.entries(STYLES).find(same)?.[0] ?? CUSTOM;
}

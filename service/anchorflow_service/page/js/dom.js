/** Elements of the page, and numbers as text. */

const SVG = "http://www.w3.org/2000/svg";
/** If every number of a kind is smaller, two decimals would print 0 for all of them. */
const TINY = 0.01;
/** How long a note stays. */
const TOLD_MS = 12_000;

export const byId = (id) => document.getElementById(id);

/** A new element with properties and children. */
export function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** A new SVG element with attributes. */
export function makeSvg(tag, attributes = {}, text = "") {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.textContent = text;
  return element;
}

/**
 * A number with a fixed count of decimals and a true minus sign; 0 has no sign. If all numbers of
 * its kind (`all`) are tiny, it has two significant digits instead.
 */
export function figure(value, digits = 2, all = null) {
  const isTiny = value !== 0 && all !== null && all.every((other) => Math.abs(other) < TINY);
  const text = isTiny ? value.toPrecision(2) : Number(value.toFixed(digits)).toFixed(digits);
  return text.replaceAll("-", "−");
}

/** A number without trailing zeros, with at most three decimals. */
export const plain = (value) => String(Number(value.toFixed(3))).replace("-", "−");

export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** Tell something beside the toolbar for a while. */
export function note(text) {
  const toast = byId("scene-note");
  toast.textContent = text;
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => toast.replaceChildren(), TOLD_MS);
}

/** Whether a key goes into a field. */
export const isTyping = ({ target }) => target.matches("input:not([type=range], [type=checkbox], [type=radio]), select, textarea");

/** Colour a range input up to its thumb. */
export function showFill(input) {
  const share = (input.value - input.min) / (input.max - input.min);
  input.style.setProperty("--fill", `${100 * share}%`);
}

/** A button that is pressed or not, with its text and icon. */
export function press(id, pressed, text, icon) {
  const button = byId(id);
  button.setAttribute("aria-pressed", pressed);
  if (icon) button.querySelector("use").setAttribute("href", `#i-${icon}`);
  if (button.querySelector("span")) button.querySelector("span").textContent = text;
  else button.setAttribute("aria-label", text);
}

/** Short ways to the elements of the page. */

const SVG = "http://www.w3.org/2000/svg";
/** Where no number of a kind is as large, digits behind the point would say 0 of all. */
const TINY = 0.01;

/** The element with this id. */
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
 * A number with so many digits and a true minus sign, which 0 has none of; with two significant
 * digits where `all` numbers of its kind are tiny.
 */
export function figure(value, digits = 2, all = null) {
  const isTiny = value !== 0 && all !== null && all.every((other) => Math.abs(other) < TINY);
  const text = isTiny ? value.toPrecision(2) : Number(value.toFixed(digits)).toFixed(digits);
  return text.replaceAll("-", "−");
}

/** A number with no more digits than it needs, three behind the point at most. */
export const plain = (value) => String(Number(value.toFixed(3))).replace("-", "−");

/** A number between low and high. */
export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** Lets a range input show how far it is filled. */
export function showFill(input) {
  const share = (input.value - input.min) / (input.max - input.min);
  input.style.setProperty("--fill", `${100 * share}%`);
}

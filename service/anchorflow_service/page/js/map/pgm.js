/** PGM pictures, P2 (text) and P5 (bytes), 8 or 16 bits a pixel. */

/** Larger pictures would take the page's time and memory for maps that are made coarser anyway. */
const MOST_PIXELS = 16e6;

/** Throws an Error that names the file where its picture is too large to be read. */
export function checkSize(width, height, name) {
  if (width * height > MOST_PIXELS) throw new Error(`${name}: expected at most ${MOST_PIXELS / 1e6} million pixels, got ${width} × ${height}.`);
}

/** {width, height, shade: [H*W] in [0, 1]}, top row first. Throws an Error that names the file. */
export function readPgm(bytes, name) {
  const wrong = (expected) => new Error(`${name}: expected ${expected}.`);
  let at = 0;
  // Words of the header; a comment runs from # to the end of its line.
  const word = () => {
    let text = "";
    while (at < bytes.length) {
      const character = String.fromCharCode(bytes[at++]);
      if (character === "#") while (at < bytes.length && bytes[at++] !== 10);
      else if (!/\s/.test(character)) text += character;
      else if (text) break;
    }
    return text;
  };
  const kind = word();
  if (kind !== "P5" && kind !== "P2") throw wrong("a PGM picture that begins with P5 or P2");
  const [width, height, most] = [word(), word(), word()].map(Number);
  const isSize = (value) => Number.isInteger(value) && value > 0;
  if (!isSize(width) || !isSize(height) || !(most > 0 && most < 65536)) throw wrong("width, height and greatest value");
  checkSize(width, height, name);
  const size = most < 256 ? 1 : 2;
  if (kind === "P5" && bytes.length - at < width * height * size) {
    throw wrong(`${width} × ${height} pixels, but the file ends before`);
  }
  const pixel = () => {
    if (kind === "P2") return Number(word() || NaN);
    return size === 1 ? bytes[at++] : 256 * bytes[at++] + bytes[at++];
  };
  const shade = Float32Array.from({ length: width * height }, () => pixel() / most);
  if (shade.some(Number.isNaN)) throw wrong(`${width} × ${height} numbers`);
  return { width, height, shade };
}

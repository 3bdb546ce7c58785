/** The YAML file of a ROS map, read and refused as `anchorflow plan` does. */

const MODES = ["trinary", "scale", "raw"];
/** m, as the contract takes them. */
const MOST_COORDINATE = 1e7;
/** As YAML 1.1 writes them. */
const NUMBER = /^[-+]?(\d+|(\d+\.\d*|\.\d+)(e[-+]\d+)?)$/i;
const WORDS = { true: true, yes: true, on: true, false: false, no: false, off: false, null: null, "~": null, "": null };

/** {image, resolution, origin: [x, y], negate, mode, free_thresh, occupied_thresh}. Throws an Error that names the field. */
export function readYaml(text, name) {
  const lines = linesOf(text);
  if (/^(---)?\s*\{/.test(lines.join("\n").trim())) throw new Error(`${name}: expected a line for each field; a flow mapping, {…}, is not read here.`);
  const found = topLevel(lines);
  if (!Object.keys(found).length) throw new Error(`${name}: expected a map_server YAML file with named fields.`);
  const fields = { mode: "trinary", negate: 0, ...found };
  const wrong = (key, expected, came = fields[key]) => new Error(`${name}: ${key}: expected ${expected}, got ${JSON.stringify(came ?? null)}.`);
  if (typeof fields.image !== "string") throw wrong("image", "a file name");
  if (!MODES.includes(fields.mode)) throw wrong("mode", `one of ${MODES.join(", ")}`);
  const isWithin = (key, low, high) => isNumber(fields[key]) && fields[key] >= low && fields[key] <= high;
  for (const key of ["free_thresh", "occupied_thresh"]) {
    if (!isWithin(key, 0, 1)) throw wrong(key, "a number from 0 to 1");
  }
  if (fields.free_thresh >= fields.occupied_thresh) throw wrong("free_thresh", "less than occupied_thresh");
  if (![0, 1, false, true].includes(fields.negate)) throw wrong("negate", "one of 0, 1");
  if (!isWithin("resolution", 1e-6, 100)) throw wrong("resolution", "a number from 1e-06 to 100");
  const { origin } = fields;
  if (!Array.isArray(origin) || origin.length !== 3 || !origin.every(isNumber)) throw wrong("origin", "three numbers x, y, yaw");
  if (origin[2] !== 0) throw wrong("origin", "a yaw of 0 (turned maps are not supported)", origin[2]);
  if (origin.some((value) => Math.abs(value) > MOST_COORDINATE)) throw wrong("origin", "numbers in [-1e+07, 1e+07] m");
  return { ...fields, origin: origin.slice(0, 2) };
}

const isNumber = (value) => typeof value === "number";

/** Without comments. */
const linesOf = (text) => text.replace(/^\ufeff/, "").split(/\r?\n/).map((line) => line.replace(/(^|\s)#.*$/, ""));

/** {key: value} of the keys that are not indented; of their values scalars and lists are read. */
function topLevel(lines) {
  const values = {};
  let last;
  for (const line of lines) {
    const [, key, value] = line.match(/^(\w+)\s*:(?:\s+(.*))?$/) ?? [];
    if (key) values[(last = key)] = [value ?? ""];
    else values[last]?.push(line);
  }
  return Object.fromEntries(Object.entries(values).map(([key, parts]) => [key, valueOf(parts.join("\n").trim())]));
}

function valueOf(text) {
  if (text.startsWith("- ")) return text.split(/^\s*-\s+/m).slice(1).map(scalar);
  if (text.startsWith("[")) return text.replace(/^\[|,?\s*\]$/g, "").split(",").map(scalar);
  return scalar(text);
}

function scalar(text) {
  const word = text.trim();
  if (NUMBER.test(word)) return Number(word);
  const known = WORDS[word.toLowerCase()];
  return known === undefined ? word.replace(/^(["'])(.*)\1$/, "$2") : known;
}

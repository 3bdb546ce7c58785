/** A request with named inputs as text: JSON for a shell, a program for Python. */

import { python, pythonArguments, pythonClient } from "../exchange.js";

/** The contract's JSON, an input a line. */
export function toJson({ inputs, ...rest }) {
  const lines = Object.entries(inputs).map(([name, value]) => `  ${JSON.stringify(name)}: ${JSON.stringify(value)}`);
  return `{"inputs": {\n${lines.join(",\n")}},\n${JSON.stringify(rest).slice(1)}\n`;
}

/** The same request for Python. */
export function toPython({ inputs, ...rest }) {
  const lines = Object.entries(inputs).map(([name, value]) => `            ${python(name)}: ${python(value)},\n`);
  // The client's binary form carries pixels, and JSON alone carries files.
  const needsJson = Object.values(inputs).some(isFile);
  const { imports, opened } = pythonClient(needsJson ? ["codec=JsonCodec()"] : []);
  return `${imports}from anchorflow_client import AnchorClient${needsJson ? ", JsonCodec" : ""}

with ${opened} as client:
    anchors = client.plan(
        inputs={
${lines.join("")}        },
${pythonArguments(rest, " ".repeat(8))}    )

print(f"{len(anchors.trajectories)} anchors, the best:")
print(anchors.trajectories[anchors.best])
`;
}

const isFile = (value) => Boolean(value?.png ?? value?.jpeg);

// The same call from a program: what to type for what the page shows.

import {queryOf} from "./api.js";

/** A command of curl, and a program in Python, that get the depth of the page's photo. */
export function programs(root, question, {token}) {
  const {name} = question,
    stem = name.replace(/\.[^.]*$/, "");
  const query = new URLSearchParams({...queryOf(question), format: "npz"});
  const calibration = `${stem}_calibration.json`;
  const curl = [
    "curl --fail-with-body",
    ...(token ? ["  -H 'Authorization: Bearer TOKEN'"] : []),
    `  -F ${quoted(`photo=@"${name}"`)}`,
    ...(question.calibration ? [`  -F ${quoted(`calibration=@"${calibration}"`)}`] : []),
    `  ${quoted(new URL(`v1/depth?${query}`, root))}`,
    `  --output ${quoted(`${stem}.npz`)}`,
  ].join(" \\\n");
  const files = [`    "photo": open(${JSON.stringify(name)}, "rb"),`];
  if (question.calibration) files.push(`    "calibration": open(${JSON.stringify(calibration)}, "rb"),`);
  const python = [
    "import io",
    "",
    "import numpy as np",
    "import requests",
    "",
    "answer = requests.post(",
    `    "${new URL("v1/depth", root)}",`,
    `    params=${JSON.stringify(Object.fromEntries(query))},`,
    "    files={",
    ...files.map((line) => `    ${line}`),
    "    },",
    ...(token ? ['    headers={"Authorization": "Bearer TOKEN"},'] : []),
    ")",
    "answer.raise_for_status()",
    'depth = np.load(io.BytesIO(answer.content))["depth"]  # metres',
  ].join("\n");
  return {curl, python};
}

function quoted(text) {
  return `'${String(text).replace(/'/g, "'\\''")}'`;
}

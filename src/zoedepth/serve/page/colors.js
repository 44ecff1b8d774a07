// Colours of depth, as zoedepth.colors has them, and round numbers for the bar.

import {TABLES} from "./colormaps.js";

const AUTOMATIC = [0.01, 0.99]; // shares of the usable pixels that are nearer than the first and the last colour

const tables = Object.fromEntries(Object.entries(TABLES).map(([name, digits]) => [name, bytes(digits)]));
tables.gray = Uint8Array.from({length: 768}, (_, i) => Math.floor(i / 3));

function bytes(digits) {
  return Uint8Array.from({length: digits.length / 2}, (_, i) => parseInt(digits.slice(2 * i, 2 * i + 2), 16));
}

/** The red, green and blue of step 0 (near) to 255 (far) of a table; `_r` at the end of a name reverses it. */
export function color(name, step) {
  const table = tables[name.replace(/_r$/, "")],
    place = 3 * (name.endsWith("_r") ? 255 - step : step);
  return [table[place], table[place + 1], table[place + 2]];
}

/** The 256 colours as numbers that a picture's memory takes: alpha, blue, green, red from the highest byte down. */
export function packedColors(name) {
  return Uint32Array.from({length: 256}, (_, step) => pack(color(name, step)));
}

export function pack([red, green, blue]) {
  return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}

/** The depths of the first and the last colour: fixed ones, or those that nearly all of the photo lies between. */
export function colorRange(depth, fixed) {
  let [low, high] = depth.quantiles(AUTOMATIC);
  low = fixed.near ?? low;
  high = fixed.far ?? high;
  if (high - low >= 1e-6) return [low, high];
  const span = (metres) => Math.max(0.01 * Math.abs(metres), 1e-3);
  return fixed.far == null ? [low, low + span(low)] : [high - span(high), high];
}

/** About `count` round numbers between two, 1, 2 or 5 times a power of ten apart, as texts. */
export function ticks(low, high, count) {
  const power = 10 ** Math.floor(Math.log10((high - low) / count));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => (high - low) / each <= count) ?? 10 * power;
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) {
    found.push({value: i * step, text: (i * step).toFixed(decimals)});
  }
  return found;
}

// What the colours mean, how long a metre is, and what is read: everything that explains the picture.

import {color, ticks} from "./colors.js";
import {metres} from "./depth.js";
import {element, move} from "./dom.js";

const RULER_LEAST = 56; // CSS pixels

/** Draw the bar of colours with its numbers. */
export function drawBar({bar, marks, text}, colormap, [near, far]) {
  const context = bar.getContext("2d"),
    picture = context.createImageData(bar.width, 1);
  for (let x = 0; x < bar.width; x++) {
    picture.data.set([...color(colormap, Math.round((255 * x) / (bar.width - 1))), 255], 4 * x);
  }
  context.putImageData(picture, 0, 0);
  marks.replaceChildren(
    ...ticks(near, far, 6).map(({value, text: label}) => {
      const tick = element("span", {textContent: `${label} m`});
      const share = (value - near) / (far - near);
      tick.style.left = `${share * 100}%`;
      tick.className = share < 0.04 ? "first" : share > 0.96 ? "last" : ""; // no label goes beyond the bar
      return tick;
    }),
  );
  text.textContent = `Colours from ${metres(near)}, near, to ${metres(far)}, far.`;
}

/** Mark a depth at the bar; null marks none. */
export function markBar(mark, depth, [near, far]) {
  mark.hidden = depth === null;
  if (depth !== null) mark.style.left = `${Math.min(Math.max((depth - near) / (far - near), 0), 1) * 100}%`;
}

/** Show how long a round number of metres is in the picture, at one depth. */
export function drawRuler(ruler, viewer, depth, away) {
  const [label, bar] = ruler.children;
  const pixels = (depth.camera.fx * viewer.scale) / away; // CSS pixels of a metre that lies across, so far away
  const least = RULER_LEAST / pixels,
    power = 10 ** Math.floor(Math.log10(least));
  const length = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= least);
  ruler.hidden = !Number.isFinite(pixels);
  bar.style.width = `${(length * pixels).toFixed(1)}px`;
  const text =
    length >= 1 ? `${length} m` : length >= 0.01 ? `${Math.round(length * 100)} cm` : `${Math.round(length * 1000)} mm`;
  label.textContent = `${text} across, ${metres(away)} away`;
}

/** Write what is read at a pixel, beside the pointer and below the picture. */
export function showReading({value, place, cursor}, viewer, reading) {
  cursor.hidden = !reading;
  if (!reading) {
    value.textContent = "–";
    place.textContent = "Move over the picture to read metres; click to pin.";
    return;
  }
  const {column, row, depth, std, confidence, valid} = reading;
  const where = `column ${column}, row ${row}`;
  if (valid) {
    value.replaceChildren(metres(depth), element("small", {textContent: std === null ? "" : ` ± ${metres(std)}`}));
    place.textContent = confidence === null ? where : `${where}, confidence ${confidence.toFixed(2)}`;
  } else {
    value.textContent = "no depth here";
    place.textContent = `${where}: at the border of a thing, or outside of the model's range`;
  }
  cursor.firstElementChild.textContent = valid ? metres(depth) : "no depth";
  const at = viewer.toStage(column, row);
  cursor.classList.toggle("flip", at.x > viewer.width - 80);
  move(cursor, at);
}

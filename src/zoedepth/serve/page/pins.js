// Pins: pixels that were picked, their readings, the distances between one and the next, and what was measured of them.

import {SAYS} from "./camera-panel.js";
import {metres} from "./depth.js";
import {element, move} from "./dom.js";

/** Dispatches "change" when pins come or go, and "measured" when somebody types what was measured. */
export class Pins extends EventTarget {
  constructor({viewer, list, marks, lines}) {
    super();
    Object.assign(this, {viewer, list, marks, lines, depth: null});
    this.pins = []; // {column, row, measured, length}: typed metres, of it and of the way from the one before
    viewer.addEventListener("view", () => this.place());
    this.marks.replaceChildren();
  }

  /** True where a pixel is pinned. */
  has(pixel) {
    return this.pins.some((pin) => pin.column === pixel.column && pin.row === pixel.row);
  }

  add(pixel) {
    if (this.has(pixel)) return;
    this.pins.push({...pixel, measured: null, length: null});
    this.changed();
  }

  remove(index) {
    this.pins.splice(index, 1);
    if (this.pins[index]) this.pins[index].length = null; // it was the length from the pin that went
    if (this.pins[0]) this.pins[0].length = null;
    this.changed();
  }

  removeLast() {
    if (this.pins.length) this.remove(this.pins.length - 1);
  }

  clear() {
    this.pins = [];
    this.changed();
  }

  /** Read all pins again, from another depth of the same photo; null while there is none. */
  read(depth) {
    this.depth = depth;
    this.render();
  }

  /** What was typed, as the service takes it. */
  get measured() {
    const readings = [],
      distances = [];
    this.pins.forEach((pin, i) => {
      if (pin.measured) readings.push([pin.column, pin.row, pin.measured]);
      const before = this.pins[i - 1];
      if (before && pin.length) distances.push([[before.column, before.row], [pin.column, pin.row], pin.length]);
    });
    return {readings, distances};
  }

  changed() {
    this.render();
    this.dispatchEvent(new Event("change"));
  }

  /** Metres between a pin and the one before; null where one of them cannot be read. */
  between(index) {
    const [one, other] = [this.pins[index - 1], this.pins[index]];
    if (!one || !this.depth.read(one).valid || !this.depth.read(other).valid) return null;
    return this.depth.distance(one, other);
  }

  render() {
    const focused = document.activeElement?.dataset?.field;
    this.list.replaceChildren();
    this.marks.replaceChildren();
    this.lines.replaceChildren();
    if (!this.depth) return;
    this.pins.forEach((pin, i) => {
      const reading = this.depth.read(pin),
        number = i + 1,
        length = this.between(i);
      const text = reading.valid ? metres(reading.depth) : "no depth here";
      if (i > 0) this.list.append(this.lengthRow(pin, number, length));
      this.list.append(this.pinRow(pin, i, reading, text));
      pin.mark = element(
        "div",
        {className: "mark"},
        element("i"),
        element("span", {}, element("b", {textContent: number}), text),
      );
      this.marks.append(pin.mark);
      if (i > 0) {
        pin.line = document.createElementNS("http://www.w3.org/2000/svg", "line");
        this.lines.append(pin.line);
        pin.between = element("div", {className: "between", textContent: length === null ? "" : metres(length)});
        pin.between.hidden = length === null;
        this.marks.append(pin.between);
      }
    });
    this.place();
    if (focused) this.list.querySelector(`[data-field="${focused}"]`)?.focus();
  }

  pinRow(pin, index, reading, text) {
    const number = index + 1;
    const sure = reading.valid && reading.std !== null ? `± ${metres(reading.std)}` : "";
    const value = element(
      "div",
      {},
      element("strong", {textContent: text}),
      " ",
      element("em", {textContent: sure}),
      element("small", {textContent: `column ${pin.column}, row ${pin.row}`}),
    );
    const remove = element("button", {type: "button", className: "plain small", textContent: "✕"});
    remove.setAttribute("aria-label", `Remove pin ${number}`);
    remove.addEventListener("click", () => this.remove(index));
    const measured = this.field(pin, "measured", `Measured metres at pin ${number}`, index, reading.valid);
    return element("li", {}, element("span", {className: "number", textContent: number}), value, measured, remove);
  }

  lengthRow(pin, number, length) {
    const value = element(
      "div",
      {},
      element("strong", {textContent: length === null ? "–" : metres(length)}),
      element("small", {textContent: `${number - 1} to ${number}, camera: ${SAYS[this.depth.camera.source]}`}),
    );
    const measured = this.field(
      pin,
      "length",
      `Measured metres from pin ${number - 1} to pin ${number}`,
      number - 1,
      length !== null,
    );
    return element(
      "li",
      {className: "length"},
      element("span", {className: "number", textContent: "↕"}),
      value,
      measured,
      element("span"),
    );
  }

  field(pin, name, label, index, usable) {
    const field = element("input", {
      type: "number",
      min: "0.001",
      step: "any",
      inputMode: "decimal",
      placeholder: "measured",
      value: pin[name] ?? "",
      disabled: !usable,
    });
    field.setAttribute("aria-label", label);
    field.dataset.field = `${name}-${index}`;
    field.addEventListener("input", () => {
      const value = field.valueAsNumber;
      pin[name] = value > 0 && Number.isFinite(value) ? value : null;
      this.dispatchEvent(new Event("measured"));
    });
    return field;
  }

  /** Put the marks where their pixels are seen. */
  place() {
    this.pins.forEach((pin, i) => {
      if (!pin.mark) return;
      const at = this.viewer.toStage(pin.column, pin.row);
      move(pin.mark, at);
      pin.mark.classList.toggle("flip", at.x > this.viewer.width - 110);
      const before = this.pins[i - 1];
      if (!before || !pin.line) return;
      const from = this.viewer.toStage(before.column, before.row);
      for (const [name, value] of [
        ["x1", from.x],
        ["y1", from.y],
        ["x2", at.x],
        ["y2", at.y],
      ]) {
        pin.line.setAttribute(name, value.toFixed(1));
      }
      move(pin.between, {x: (from.x + at.x) / 2 - 24, y: (from.y + at.y) / 2 - 11});
    });
  }
}

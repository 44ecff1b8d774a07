// The picture: the photo and its depth with a border between them that can be moved, enlarged and moved about. It says
// which pixel of the photo is under the pointer, at the size of the photo, whatever the size on the screen.
//
// Three units: pixels of the photo (x, y; the centre of the first is at 0), CSS pixels from the corner of the stage,
// and pixels of the screen (devicePixelRatio to one of CSS).

import {packedColors, pack} from "./colors.js";

const LARGEST = 40; // CSS pixels that one pixel of the photo takes at most
const STEP = 1.4; // of the buttons and keys for nearer and farther
const STILL = 5; // CSS pixels that a pointer may move in a click
const HATCH = [pack([116, 116, 122]), pack([172, 172, 178])],
  HATCH_WIDTH = 4;
const UNSURE = [0, 214, 200],
  UNSURE_MOST = 0.92; // colour of what the model is least sure of, and how much of it

/**
 * Dispatches: "point" (detail: a pixel or null), when the pointer is elsewhere; "pick" (detail: a pixel), at a click;
 * "view", when another part of the photo is seen; "undo", when the last pick is taken back by a key.
 */
export class Viewer extends EventTarget {
  constructor(stage, canvas, splitter) {
    super();
    this.stage = stage;
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.layer = document.createElement("canvas"); // the depth as it is seen, so that moving the border costs little
    this.splitter = splitter;
    this.photo = null;
    this.depth = null;
    this.size = null; // height and width of the photo
    this.look = {colormap: "magma_r", range: [0, 1], confidence: null};
    this.scale = 1; // CSS pixels of one pixel of the photo
    this.left = 0; // CSS pixels from the corner of the stage to the corner of the photo
    this.top = 0;
    this.cursor = null; // the pixel that the keyboard or the pointer is at
    this.pointers = new Map();
    this.listen();
    new ResizeObserver(() => this.resize()).observe(stage);
  }

  /**
   * Show a photo with its depth.
   *
   * @param {?ImageBitmap} photo null where the browser cannot read it
   * @param {?Depth} depth null while it is not known
   * @param {?number[]} size height and width; null while neither is there
   */
  show(photo, depth, size) {
    const other = photo !== this.photo || String(size) !== String(this.size);
    Object.assign(this, {photo, depth, size});
    this.splitter.hidden = !photo || !depth;
    if (other) {
      this.cursor = null;
      this.fit();
    }
    this.changed();
  }

  /** Colour the depth otherwise. `confidence` is null, or the two confidences between which the overlay fades. */
  paint(look) {
    Object.assign(this.look, look);
    this.changed();
  }

  /** Show all of the photo, as large as it goes. */
  fit() {
    if (!this.size || !this.width) return;
    this.scale = this.smallest;
    this.place();
  }

  /** Enlarge by a factor, about a place of the stage in CSS pixels; about the middle where none is given. */
  zoom(factor, at = {x: this.width / 2, y: this.height / 2}) {
    if (!this.size) return;
    const scale = Math.min(Math.max(this.scale * factor, this.smallest), Math.max(LARGEST, this.smallest));
    this.left = at.x - ((at.x - this.left) * scale) / this.scale;
    this.top = at.y - ((at.y - this.top) * scale) / this.scale;
    this.scale = scale;
    this.place();
  }

  nearer() {
    this.zoom(STEP);
  }
  farther() {
    this.zoom(1 / STEP);
  }

  /** True while not all of the photo is in the stage. */
  get enlarged() {
    return this.size !== null && this.scale > this.smallest * 1.001;
  }

  get smallest() {
    return Math.min(this.width / this.size[1], this.height / this.size[0]);
  }

  /** The place on the stage, in CSS pixels, of a place in the photo. */
  toStage(x, y) {
    return {x: (x + 0.5) * this.scale + this.left, y: (y + 0.5) * this.scale + this.top};
  }

  /** The pixel of the photo at a place in the window (clientX, clientY); null outside of the photo. */
  pixelAt(clientX, clientY) {
    if (!this.depth) return null;
    const at = this.onStage(clientX, clientY);
    return this.depth.pixelAt((at.x - this.left) / this.scale - 0.5, (at.y - this.top) / this.scale - 0.5);
  }

  onStage(clientX, clientY) {
    const box = this.canvas.getBoundingClientRect();
    // The box may be drawn larger or smaller than it was laid out, by the zoom of a phone.
    return {x: ((clientX - box.left) * this.width) / box.width, y: ((clientY - box.top) * this.height) / box.height};
  }

  /** Column on the stage, in CSS pixels, where the photo ends and its depth begins. */
  get border() {
    const share = Number(this.splitter.value) / Number(this.splitter.max);
    const thumb = parseFloat(getComputedStyle(this.splitter).getPropertyValue("--thumb"));
    if (share === 0 || share === 1) return share * this.width;
    return thumb / 2 + share * (this.width - thumb); // where the middle of its handle is
  }

  resize() {
    const {width, height} = this.stage.getBoundingClientRect();
    if (!width || !height) return;
    const wasFit = !this.enlarged,
      middle =
        this.size && this.width
          ? {x: (this.width / 2 - this.left) / this.scale, y: (this.height / 2 - this.top) / this.scale}
          : null;
    this.width = this.stage.clientWidth;
    this.height = this.stage.clientHeight;
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(this.width * this.ratio);
    this.canvas.height = Math.round(this.height * this.ratio);
    if (!this.size) return;
    if (wasFit || !middle) return this.fit();
    this.left = this.width / 2 - middle.x * this.scale; // what was in the middle stays there
    this.top = this.height / 2 - middle.y * this.scale;
    this.place();
  }

  /** Keep the photo in the stage: in the middle where there is room, without a gap where there is none. */
  place() {
    const within = (offset, room, side) =>
      side <= room ? (room - side) / 2 : Math.min(0, Math.max(room - side, offset));
    this.left = within(this.left, this.width, this.size[1] * this.scale);
    this.top = within(this.top, this.height, this.size[0] * this.scale);
    this.changed();
    this.dispatchEvent(new Event("view"));
  }

  changed() {
    this.stale = true;
    this.request();
  }

  /** Draw at the next frame, once, however much has changed. */
  request() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.draw();
    });
  }

  draw() {
    const {context, canvas, ratio} = this;
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (!this.size) return;
    if (this.depth && this.stale) this.drawDepth();
    this.stale = false;
    const border = Math.round((this.depth ? this.border : this.width) * ratio);
    if (this.photo) {
      context.save();
      context.beginPath();
      context.rect(0, 0, border, canvas.height);
      context.clip();
      context.imageSmoothingEnabled = this.scale * ratio < 3;
      context.imageSmoothingQuality = "high";
      context.drawImage(
        this.photo,
        this.left * ratio,
        this.top * ratio,
        this.size[1] * this.scale * ratio,
        this.size[0] * this.scale * ratio,
      );
      context.restore();
    }
    if (!this.depth) return;
    const first = this.photo ? border : 0;
    if (first < canvas.width) {
      context.drawImage(
        this.layer,
        first,
        0,
        canvas.width - first,
        canvas.height,
        first,
        0,
        canvas.width - first,
        canvas.height,
      );
    }
    if (this.photo && border > 0 && border < canvas.width) {
      context.fillStyle = "#fff";
      context.fillRect(border - ratio, 0, 2 * ratio, canvas.height);
    }
  }

  /** Colour what is seen of the depth, each pixel of the screen by the pixel of the photo that it lies in. */
  drawDepth() {
    const {depth, ratio, layer} = this;
    const width = (layer.width = this.canvas.width),
      height = (layer.height = this.canvas.height);
    const context = layer.getContext("2d"),
      picture = context.createImageData(width, height);
    const screen = new Uint32Array(picture.data.buffer),
      colors = packedColors(this.look.colormap);
    const columns = Int32Array.from({length: width}, (_, i) =>
      Math.floor(((i + 0.5) / ratio - this.left) / this.scale),
    );
    const [near, far] = this.look.range.map((value) => value / depth.gain);
    const {values, valid, std} = depth,
      steps = 255 / (far - near),
      hatch = HATCH_WIDTH * ratio;
    const [low, high] = this.look.confidence ?? [0, 0],
      fades = this.look.confidence && std;
    for (let y = 0; y < height; y++) {
      const row = Math.floor(((y + 0.5) / ratio - this.top) / this.scale);
      if (row < 0 || row >= depth.height) continue;
      for (let x = 0; x < width; x++) {
        const column = columns[x];
        if (column < 0 || column >= depth.width) continue;
        const i = row * depth.width + column;
        if (!valid[i]) {
          screen[y * width + x] = HATCH[Math.floor((x + y) / hatch) & 1];
          continue;
        }
        const step = Math.round((values[i] - near) * steps);
        const plain = colors[step < 0 ? 0 : step > 255 ? 255 : step];
        screen[y * width + x] = fades
          ? mixed(plain, Math.min(Math.max((high - values[i] / (values[i] + std[i])) / (high - low || 1), 0), 1))
          : plain;
      }
    }
    context.putImageData(picture, 0, 0);
  }

  listen() {
    const {stage} = this;
    stage.addEventListener("pointerdown", (event) => this.down(event));
    stage.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, (event) => this.up(event));
    stage.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") this.point(null);
    });
    stage.addEventListener(
      "wheel",
      (event) => {
        if (!this.size) return;
        event.preventDefault();
        this.zoom(
          Math.exp((-event.deltaY * (event.deltaMode ? 30 : 1)) / 500),
          this.onStage(event.clientX, event.clientY),
        );
        this.point(this.pixelAt(event.clientX, event.clientY));
      },
      {passive: false},
    );
    stage.addEventListener("keydown", (event) => this.key(event));
    this.splitter.addEventListener("input", () => this.request());
  }

  down(event) {
    if (!this.size || event.target === this.splitter || event.button > 0) return;
    this.stage.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    this.still = this.pointers.size === 1 ? {x: event.clientX, y: event.clientY} : null;
    this.point(this.pixelAt(event.clientX, event.clientY));
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      if (event.pointerType === "mouse") this.point(this.pixelAt(event.clientX, event.clientY));
      return;
    }
    if (this.still && Math.hypot(event.clientX - this.still.x, event.clientY - this.still.y) > STILL) this.still = null;
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const apart = (one) => Math.hypot(one.x - other.x, one.y - other.y);
      const middle = (one) => this.onStage((one.x + other.x) / 2, (one.y + other.y) / 2);
      const now = {x: event.clientX, y: event.clientY};
      this.left += middle(now).x - middle(before).x;
      this.top += middle(now).y - middle(before).y;
      this.zoom(apart(now) / Math.max(1, apart(before)), middle(now));
      this.point(null);
    } else if (this.enlarged && !this.still) {
      this.left += event.clientX - before.x;
      this.top += event.clientY - before.y;
      this.place();
      this.point(this.pixelAt(event.clientX, event.clientY));
    } else {
      this.point(this.pixelAt(event.clientX, event.clientY));
    }
    this.pointers.set(event.pointerId, {x: event.clientX, y: event.clientY});
  }

  up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    const pixel = this.still && event.type === "pointerup" ? this.pixelAt(event.clientX, event.clientY) : null;
    this.still = null;
    if (pixel) this.dispatchEvent(new CustomEvent("pick", {detail: pixel}));
  }

  key(event) {
    if (!this.depth || event.target !== this.stage || event.ctrlKey || event.metaKey || event.altKey) return;
    const moves = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (moves) {
      // One pixel of the photo, or of the screen where those are smaller; with Shift ten times as far.
      const far = Math.max(1, Math.round(1 / this.scale)) * (event.shiftKey ? 10 : 1);
      const from = this.cursor ?? {column: this.size[1] >> 1, row: this.size[0] >> 1};
      const clipped = (value, side) => Math.min(Math.max(value, 0), side - 1);
      const pixel = {
        column: clipped(from.column + moves[0] * far, this.size[1]),
        row: clipped(from.row + moves[1] * far, this.size[0]),
      };
      this.reveal(pixel);
      this.point(pixel);
    } else if (event.key === "Enter" || event.key === " ") {
      if (this.cursor) this.dispatchEvent(new CustomEvent("pick", {detail: this.cursor}));
    } else if (event.key === "Delete" || event.key === "Backspace") {
      this.dispatchEvent(new Event("undo"));
    } else if (event.key === "+" || event.key === "=") {
      this.nearer();
    } else if (event.key === "-") {
      this.farther();
    } else if (event.key === "0") {
      this.fit();
    } else if (event.key === "Escape") {
      this.point(null);
    } else {
      return;
    }
    event.preventDefault();
  }

  /** Move the photo so far that a pixel is seen. */
  reveal({column, row}) {
    const at = this.toStage(column, row),
      margin = 24;
    this.left += Math.max(0, margin - at.x) - Math.max(0, at.x - (this.width - margin));
    this.top += Math.max(0, margin - at.y) - Math.max(0, at.y - (this.height - margin));
    this.place();
  }

  point(pixel) {
    this.cursor = pixel;
    this.dispatchEvent(new CustomEvent("point", {detail: pixel}));
  }
}

function mixed(color, unsure) {
  const share = unsure * UNSURE_MOST,
    mix = (part, other) => Math.round(part + (other - part) * share);
  return pack([mix(color & 255, UNSURE[0]), mix((color >> 8) & 255, UNSURE[1]), mix((color >> 16) & 255, UNSURE[2])]);
}

// The depth of a photo in the browser: what the service answered, and what can be asked of it without asking again.
// Pixels are counted as the package does: the centre of the top left one is at (0, 0), x is the column, y the row.

/** A pinhole camera at the size of the photo. `source` is "given", "exif" or "assumed". */
export class Camera {
  constructor({size, fx, fy, cx, cy, source}) {
    [this.height, this.width] = size;
    Object.assign(this, {fx, fy, cx, cy, source});
  }

  /** The camera with square pixels that looks through the middle, from a focal length in pixels. */
  static fromFocal(focal, [height, width], source = "given") {
    return new Camera({size: [height, width], fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2, source});
  }

  /** The point at depth 1 that a pixel sees: x to the right, y down, z forward. */
  ray(x, y) {
    return [(x - this.cx) / this.fx, (y - this.cy) / this.fy, 1];
  }

  /** Degrees from the left to the right border. */
  get fovX() {
    const angle = (side) => Math.atan2(side, this.fx);
    return ((angle(this.cx + 0.5) + angle(this.width - this.cx - 0.5)) * 180) / Math.PI;
  }
}

/** The focal length in pixels that sees so many degrees across a photo of this width. */
export function focalOfView(degrees, width) {
  return width / 2 / Math.tan((degrees * Math.PI) / 360);
}

/** The depth of one photo, in metres along the optical axis, at the size of the photo. */
export class Depth {
  /**
   * @param {number[]} size height and width
   * @param {Float32Array} values metres, row by row
   * @param {?Float32Array} std metres; null where the model has no distribution
   * @param {Uint8Array} valid 1 where the depth can be used
   * @param {Camera} camera
   */
  constructor({size, values, std, valid, camera}) {
    [this.height, this.width] = size;
    if (values.length !== this.height * this.width || valid.length !== values.length) {
      throw new Error("the answer of the service has arrays of other sizes than it says");
    }
    Object.assign(this, {values, std, valid, camera});
    this.gain = 1; // all metres are multiplied by it, while the service is asked again with another camera
  }

  /** The pixel in which a place lies, or null outside of the photo. */
  pixelAt(x, y) {
    const column = Math.floor(x + 0.5),
      row = Math.floor(y + 0.5);
    return column >= 0 && row >= 0 && column < this.width && row < this.height ? {column, row} : null;
  }

  /** What is known of a pixel: its depth and ± in metres, its confidence, and whether it can be used. */
  read({column, row}) {
    const i = row * this.width + column;
    const depth = this.values[i] * this.gain;
    const std = this.std ? this.std[i] * this.gain : null;
    const confidence = std === null ? null : depth / (depth + std);
    return {column, row, depth, std, confidence, valid: this.valid[i] !== 0};
  }

  /** The point in space that a pixel sees, metres, in the axes of the camera. */
  point({column, row}) {
    const {depth} = this.read({column, row});
    return this.camera.ray(column, row).map((part) => part * depth);
  }

  /** Metres between the points that two pixels see. */
  distance(one, other) {
    const a = this.point(one),
      b = this.point(other);
    return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  }

  /** The depths, in metres, below which these shares of the usable pixels lie. */
  quantiles(shares) {
    return this.sorted(shares, (i) => (this.valid[i] ? this.values[i] * this.gain : null));
  }

  /** The confidences below which these shares of the pixels lie. */
  confidences(shares) {
    if (!this.std) return null;
    return this.sorted(shares, (i) => this.values[i] / (this.values[i] + this.std[i]));
  }

  /** What stands at these shares of the pixels, or of many of them, in order; `read` gives null for one to leave out. */
  sorted(shares, read) {
    const step = Math.max(1, Math.floor(this.values.length / 100000)),
      some = [];
    for (let i = 0; i < this.values.length; i += step) {
      const value = read(i);
      if (value !== null) some.push(value);
    }
    some.sort((a, b) => a - b);
    return shares.map((share) => (some.length ? some[Math.round(share * (some.length - 1))] : 0));
  }
}

/** Metres as one reads them: three digits, never more than millimetres. */
export function metres(value) {
  if (!Number.isFinite(value)) return "–";
  if (value >= 100) return `${value.toFixed(0)} m`;
  return `${value.toFixed(value >= 10 ? 1 : value >= 1 ? 2 : 3)} m`;
}

// The panel of the camera: who says how much of the world the photo shows, and what it is.

import {Camera, focalOfView} from "./depth.js";
import {byId, element} from "./dom.js";

const LEAST = 2.8,
  MOST = 160; // degrees of the field of view that the service takes
const DELAY = 250; // milliseconds that a moving slider must rest before the service is asked
/** Who says the camera, in a few words. */
export const SAYS = {exif: "from EXIF", assumed: "a guess", given: "as you say"};

/** Dispatches "change" at once with each movement, and "settled" when the service should be asked. */
export class CameraPanel extends EventTarget {
  constructor() {
    super();
    this.radios = Object.fromEntries([...document.getElementsByName("camera")].map((radio) => [radio.value, radio]));
    this.fov = byId("fov");
    this.slider = byId("fov-slider");
    this.focal = byId("focal");
    this.size = null;
    for (const radio of Object.values(this.radios)) radio.addEventListener("change", () => this.changed());
    this.slider.addEventListener("input", () => this.typed("fov", this.slider.valueAsNumber));
    this.fov.addEventListener("input", () => this.typed("fov", this.fov.valueAsNumber));
    this.focal.addEventListener("input", () => this.typed("focal", this.focal.valueAsNumber));
    for (const kind of ["fov", "focal"]) this[kind].addEventListener("change", () => this.checked(kind));
  }

  /** What is chosen, as a question has it. */
  get choice() {
    const kind = Object.keys(this.radios).find((name) => this.radios[name].checked);
    return kind === "exif"
      ? {kind, value: null}
      : {kind, value: (kind === "fov" ? this.fov : this.focal).valueAsNumber};
  }

  /** The camera that is chosen; null where the photo's notes say it, which the service reads. */
  get camera() {
    const {kind, value} = this.choice;
    if (kind === "exif" || !this.size) return null;
    return Camera.fromFocal(kind === "fov" ? focalOfView(value, this.size[1]) : value, this.size);
  }

  /** Ask the photo's own notes again, as for a new photo. */
  reset() {
    this.choose({kind: "exif", value: null});
  }

  /** Choose what was chosen for a question; nothing is asked. */
  choose({kind, value}) {
    clearTimeout(this.timer);
    this.radios[kind].checked = true;
    if (kind !== "exif") this[kind].value = value;
  }

  /** Show what the service says of the camera; `whole`: in the field that somebody types in, too. */
  show({camera, camera_note: note, focal_correction: factor}, {whole = false} = {}) {
    const known = new Camera(camera);
    this.size = camera.size;
    const badge = element("span", {
      className: camera.source === "assumed" ? "badge guess" : "badge",
      textContent: SAYS[camera.source],
    });
    const corrected =
      Math.abs(factor - 1) > 5e-4 ? ` Metres are multiplied by ${factor.toFixed(3)} for this lens.` : "";
    const reason = note ? ` The photo: ${note}.` : "";
    byId("camera-text").replaceChildren(
      badge,
      ` ${known.fovX.toFixed(1)}° across, focal length ${known.fy.toFixed(0)} pixels.`,
      camera.source === "given" ? "" : reason,
      corrected,
    );
    const {kind} = this.choice;
    const isTyped = (field) => !whole && document.activeElement === field;
    if (kind !== "fov" || !isTyped(this.fov)) this.fov.value = known.fovX.toFixed(1);
    if (!isTyped(this.slider)) this.slider.value = known.fovX;
    if (kind !== "focal" || !isTyped(this.focal)) this.focal.value = known.fy.toFixed(1);
  }

  typed(kind, value) {
    this.radios[kind].checked = true;
    this[kind].setCustomValidity("");
    if (!this.size) return;
    if (kind === "fov" && isPossible(kind, value)) {
      if (document.activeElement !== this.fov) this.fov.value = value.toFixed(1);
      if (document.activeElement !== this.slider) this.slider.value = value;
      this.focal.value = focalOfView(value, this.size[1]).toFixed(1);
    } else if (kind === "focal" && isPossible(kind, value)) {
      const degrees = Camera.fromFocal(value, this.size).fovX;
      this.fov.value = degrees.toFixed(1);
      this.slider.value = degrees;
    } else {
      return; // not typed to its end
    }
    this.changed();
  }

  /** Say what is wrong with a number, now that it is typed to its end. */
  checked(kind) {
    const field = this[kind];
    if (isPossible(kind, field.valueAsNumber)) return;
    field.setCustomValidity(
      kind === "fov" ? `A field of view has from ${LEAST} to ${MOST} degrees.` : "A focal length is above 0 pixels.",
    );
    field.reportValidity();
  }

  changed() {
    const {kind, value} = this.choice;
    if (kind !== "exif" && !isPossible(kind, value)) return;
    this.dispatchEvent(new Event("change"));
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.dispatchEvent(new Event("settled")), DELAY);
  }
}

/** Can a camera have this field of view in degrees, or this focal length in pixels? */
function isPossible(kind, value) {
  return kind === "fov" ? value >= LEAST && value <= MOST : value > 0;
}

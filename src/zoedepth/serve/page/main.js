// The page: one photo, what is asked about it, and what the service answers.

import {Problem, Service} from "./api.js";
import {CameraPanel} from "./camera-panel.js";
import {colorRange} from "./colors.js";
import {Camera, metres} from "./depth.js";
import {byId, element, press, save} from "./dom.js";
import {drawBar, drawRuler, markBar, showReading} from "./legend.js";
import {Pins} from "./pins.js";
import {programs} from "./program.js";
import {hasQuickLook, QuickLook} from "./quick-look.js";
import {canShowRoom, Room} from "./room.js";
import {Scene} from "./scene.js";
import {Viewer} from "./viewer.js";
import {asStored, turned} from "./webp.js";

const MOST_SIDE = 4096; // pixels of a photo that is drawn; phones draw no larger ones
const SURFACE_TRIANGLES = 150_000;
const UNSURE_SHARES = [0.02, 0.6]; // shares of the pixels that are covered wholly, and at all
const FILES = [
  {format: "png", name: "PNG", ending: "_depth.png", what: "16 bits"},
  {format: "exr", name: "EXR", ending: ".exr", what: "exact metres"},
  {format: "npz", name: "NPZ", ending: ".npz", what: "all arrays"},
  {format: "ply", name: "PLY", ending: ".ply", what: "points"},
  {format: "glb", name: "GLB", ending: ".glb", what: "surface"},
  {format: "usdz", name: "USDZ", ending: ".usdz", what: "for iPhones"},
];
const CALIBRATION_ENDING = "_calibration.json";

const service = new Service();
const viewer = new Viewer(byId("stage"), byId("picture"), byId("splitter"));
const pins = new Pins({viewer, list: byId("pins"), marks: byId("marks"), lines: byId("lines")});
const cameraPanel = new CameraPanel();
const scene = new Scene(byId("scene"));
const room = new Room(scene, {
  overlay: byId("room"),
  hint: byId("room-hint"),
  again: byId("room-again"),
  leave: byId("room-leave"),
});
const quickLook = new QuickLook(byId("augmented"), byId("quick-look"));

const state = {
  photo: null, // {blob, name, picture}
  calibrating: false, // true while metres are to be put right by what was typed
  answered: null, // the question that `facts` and `depth` answer, with the calibration that was used
  shown: null, // the question that the metres shown answer: `answered`, but for a camera that was changed at once
  facts: null,
  depth: null, // of the photo, as the service answered last
  range: [0, 1], // metres of the first and the last colour
  middle: 1, // median of the depth, metres
  references: {}, // focal length in pixels, by the name of the head, at which its metres need no correction
  surface: null, // the GLB of `depth`, once it was asked for
  space: null, // null, "cloud" or "surface": what is shown in place of the picture
};
const running = new Set(); // an AbortController of each thing that the page waits for
let again = null; // what "Try again" does

// ---------------------------------------------------------------------------------------------- choosing a photo

async function open(blob, name) {
  hideProblem();
  stop();
  cameraPanel.reset();
  const picture = await asking(() => decoded(blob));
  Object.assign(state, {
    photo: {blob, name, picture},
    calibrating: false,
    answered: null,
    shown: null,
    facts: null,
    depth: null,
    surface: null,
    references: {},
  });
  document.title = `${name} – ZoeDepth`;
  pins.clear();
  pins.read(null);
  byId("domain").replaceChildren();
  showPoint(null);
  showCalibration();
  byId("legend").hidden = true;
  byId("unshown").hidden = true;
  byId("about").textContent = name;
  scene.otherPhoto = true;
  quickLook.drop();
  showSpace(null);
  byId("start").hidden = true;
  byId("work").hidden = false;
  byId("another").hidden = false;
  viewer.show(picture, null, picture ? [picture.height, picture.width] : null);
  await ask();
}

/** Show what there was before there was a photo. */
function chooseAnother() {
  byId("work").hidden = true;
  byId("another").hidden = true;
  byId("start").hidden = false;
  document.title = "ZoeDepth";
}

/** The upright picture in a file, or null where this browser cannot read its kind. */
async function decoded(blob) {
  try {
    const {file, orientation} = await asStored(blob);
    const whole = await createImageBitmap(file, {imageOrientation: "from-image"});
    const shrink = MOST_SIDE / Math.max(whole.width, whole.height);
    if (shrink >= 1) return turned(whole, orientation);
    const small = await createImageBitmap(whole, {
      resizeWidth: Math.round(whole.width * shrink),
      resizeHeight: Math.round(whole.height * shrink),
      resizeQuality: "high",
    });
    whole.close();
    return turned(small, orientation);
  } catch {
    return null;
  }
}

function openFirst(files) {
  const file = [...files].find((each) => each.size || each.type) ?? files[0];
  if (!file) return;
  guarded(async () => {
    if (isOtherKind(file.type)) {
      const detail = `${file.name || "It"} is of the type ${file.type}. Choose a JPEG, PNG, WebP, HEIC or another picture.`;
      throw new Problem({title: "This file is no photo", detail, status: 415});
    }
    await open(file, file.name || "photo");
  });
}

/** True where the system knows a file's type, and it is none of a picture: what is open can stay open. */
function isOtherKind(type) {
  return type !== "" && type !== "application/octet-stream" && !type.startsWith("image/");
}

function listenForPhotos() {
  for (const id of ["choose", "take"]) {
    byId(id).addEventListener("change", (event) => {
      openFirst(event.target.files);
      event.target.value = ""; // the same one may be chosen again
    });
  }
  byId("another").addEventListener("click", () => {
    stop();
    chooseAnother();
    hideProblem();
    byId("choose").focus();
  });
  byId("retry").addEventListener("click", () => {
    hideProblem();
    again();
  });
  for (const button of document.querySelectorAll("[data-example]")) {
    button.addEventListener("click", () =>
      guarded(async () => {
        const {example} = button.dataset;
        stop();
        const blob = await asking(async ({signal}) => {
          const response = await fetch(example, {signal});
          if (!response.ok)
            throw new Problem({
              title: "The example is missing",
              detail: "The service did not send it.",
              status: response.status,
            });
          return response.blob();
        });
        await open(blob, example.split("/").pop());
      }),
    );
  }
  document.addEventListener("paste", (event) => {
    const {files} = event.clipboardData;
    if (files.length) {
      event.preventDefault();
      openFirst(files);
    }
  });
  const dropping = (wanted) => document.body.classList.toggle("dropping", wanted);
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    dropping(true);
  });
  document.addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) dropping(false);
  });
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    dropping(false);
    openFirst(event.dataTransfer.files);
  });
}

// ---------------------------------------------------------------------------------------------- asking the service

/** Do what the page waits for, until `stop`: what comes after that is dropped. `action` gets the service's options. */
async function asking(action) {
  const mine = new AbortController();
  running.add(mine);
  waiting();
  try {
    return await action({signal: mine.signal, progress: showProgress});
  } finally {
    running.delete(mine);
    if (!running.size) atRest();
    mine.signal.throwIfAborted();
  }
}

/** Drop everything that the page waits for. */
function stop() {
  for (const each of running) each.abort();
}

/** What is set on the page now. The calibration is found when it is asked. */
function question() {
  return {
    photo: state.photo.blob,
    name: state.photo.name,
    model: byId("model").value,
    domain: byId("domain").value || null,
    camera: cameraPanel.choice,
    calibrating: state.calibrating,
    calibration: null,
  };
}

/** Ask for the depth of the photo as everything is set now, and show it. What was being asked before is dropped. */
async function ask() {
  stop();
  const wanted = question();
  try {
    const {asked, facts, depth} = await asking(async (options) => {
      showProgress("send", null);
      const calibration = wanted.calibrating ? await calibrate(wanted, options) : null;
      const asked = {...wanted, calibrating: calibration !== null, calibration};
      return {asked, ...(await service.maps(asked, options))};
    });
    const {calibrating} = asked;
    Object.assign(state, {calibrating, answered: asked, shown: asked, facts, depth, surface: null});
    quickLook.drop();
    learnReference(facts);
    hideProblem();
    showAnswer();
  } catch (error) {
    if (error.name === "AbortError") return;
    showLast();
    showProblem(error, () => {
      choose(wanted);
      return ask();
    });
  }
}

/** The calibration that the pins tell. Where all were taken away, it stays as it was. */
async function calibrate(wanted, options) {
  const {readings, distances} = pins.measured;
  if (!readings.length && !distances.length) return state.answered?.calibration ?? null;
  return service.calibrate(wanted, {readings, distances, alongRay: byId("along-ray").checked}, options);
}

/** Show what was answered last, after a question that was refused or stopped. */
function showLast() {
  const {depth, facts, answered} = state;
  if (!depth) {
    state.calibrating = false;
    byId("place").textContent = "There is no depth of this photo.";
    if (!state.photo.picture) chooseAnother(); // it may be no photo at all
    return;
  }
  state.shown = answered;
  choose(answered);
  cameraPanel.show(facts, {whole: true});
  depth.gain = 1;
  depth.camera = new Camera(facts.camera);
  showCalibration();
  showDepth();
  if (state.space) guarded(() => showSpace(state.surface ? state.space : "cloud")); // which asks for nothing
}

/** Set the page as it was for a question. */
function choose({model, domain, camera, calibrating}) {
  if (byId("model").value !== model) {
    byId("model").value = model;
    forgetHeads();
  }
  if (model === state.answered?.model) {
    learnReference(state.facts);
    showDomains();
  }
  byId("domain").value = domain ?? "";
  cameraPanel.choose(camera);
  state.calibrating = calibrating;
}

/** Forget what is known of the heads of a model: another one has others. */
function forgetHeads() {
  byId("domain").replaceChildren();
  state.references = {};
}

/** Say that the page waits for something, which may not yet be worth a word. */
function waiting() {
  byId("work").setAttribute("aria-busy", "true");
}

function atRest() {
  byId("work").setAttribute("aria-busy", "false");
  byId("busy").hidden = true;
}

function showProgress(stage, share) {
  waiting();
  const words = {send: "Sending the photo", compute: "Computing depth", receive: "Receiving depth"};
  byId("busy").hidden = false;
  byId("busy-text").textContent = words[stage];
  if (share === null) byId("progress").removeAttribute("value");
  else byId("progress").value = share;
}

/** Keep what an answer tells of how metres depend on the camera: depth is multiplied by focal length / reference. */
function learnReference({domain, camera, focal_correction: factor}) {
  if (factor !== 1) state.references[domain] = camera.fy / factor;
}

/** Show the metres of a camera that was changed at once, where they are known; the service is asked in any case. */
function rescale() {
  const {depth, facts} = state,
    {camera} = cameraPanel,
    reference = state.references[facts?.domain];
  if (!depth || !camera || !reference || state.calibrating) return;
  depth.gain = camera.fy / reference / facts.focal_correction;
  depth.camera = camera;
  state.shown = {...state.answered, camera: cameraPanel.choice};
  showDepth();
}

async function guarded(action) {
  try {
    await action();
  } catch (error) {
    if (error.name !== "AbortError") showProblem(error, action);
  }
}

/** Say what went wrong, and offer to do `action` where it may go better later. */
function showProblem(error, action) {
  again = () => guarded(action);
  if (error.status === 401) {
    byId("token-form").hidden = false;
    byId("token").focus();
  }
  byId("retry").hidden = ![0, 408, 429, 503].includes(error.status) || (byId("work").hidden && action !== start);
  byId("problem-title").textContent =
    error instanceof Problem ? `${error.title}.` : "Something went wrong in this page.";
  byId("problem-detail").textContent = error instanceof Problem ? error.detail : error.message;
  byId("problem").hidden = false;
}

function hideProblem() {
  byId("problem").hidden = true;
}

// ---------------------------------------------------------------------------------------------- showing the answer

function showAnswer() {
  const {facts, depth, photo} = state;
  if (photo.picture && !isOf(photo.picture, depth)) photo.picture = null;
  viewer.show(photo.picture, depth, [depth.height, depth.width]);
  cameraPanel.show(facts);
  showDomains();
  showCalibration();
  const sure = facts.domain_probability?.[facts.domain];
  const scene =
    Object.keys(facts.domain_probability ?? {}).length > 1 ? `, ${facts.domain} (${Math.round(100 * sure)} %)` : "";
  byId("about").textContent = `${photo.name}, ${depth.width} × ${depth.height}${scene}`;
  byId("unshown").hidden = photo.picture !== null;
  byId("confidence-label").hidden = !depth.std;
  showDepth();
  if (state.space) guarded(() => showSpace(state.space));
}

/** True where a picture has the proportions of its depth; each side of both may have been rounded to whole pixels. */
function isOf(picture, depth) {
  const apart = Math.abs(picture.width * depth.height - picture.height * depth.width);
  return apart < (picture.width + picture.height + depth.width + depth.height) / 2;
}

/** Show the depth in its colours, and everything that is read from it. */
function showDepth() {
  const {depth} = state;
  if (!depth) return;
  byId("legend").hidden = state.space !== null;
  const typed = (id) => (byId(id).valueAsNumber > 0 || byId(id).value === "0" ? byId(id).valueAsNumber : undefined);
  const fixed = {near: typed("near"), far: typed("far")};
  const contrary = fixed.near >= fixed.far;
  byId("far").setCustomValidity(contrary ? "must be beyond the near one" : "");
  state.range = colorRange(depth, contrary ? {} : fixed);
  [state.middle] = depth.quantiles([0.5]);
  const colormap = byId("colormap").value,
    overlay = byId("confidence").checked && depth.std !== null;
  byId("unsure-chip").hidden = byId("confidence-hint").hidden = !overlay;
  viewer.paint({colormap, range: state.range, confidence: overlay ? depth.confidences(UNSURE_SHARES) : null});
  drawBar({bar: byId("bar"), marks: byId("ticks"), text: byId("legend-text")}, colormap, state.range);
  pins.read(depth);
  showPoint(viewer.cursor);
}

function showPoint(pixel) {
  const {depth} = state;
  const reading = pixel && depth ? depth.read(pixel) : null;
  const usable = reading?.valid ? reading.depth : null;
  showReading({value: byId("value"), place: byId("place"), cursor: byId("cursor")}, viewer, reading);
  byId("cursor").hidden ||= pins.has(pixel ?? {}); // the pin says the same
  markBar(byId("bar-mark"), usable, state.range);
  if (depth) drawRuler(byId("ruler"), viewer, depth, usable ?? state.middle);
  else byId("ruler").hidden = true;
}

function showDomains() {
  const {facts} = state,
    select = byId("domain"),
    names = Object.keys(facts.domain_probability ?? {});
  byId("domain-label").hidden = names.length < 2;
  if (select.options.length) return;
  select.append(new Option("as the model finds", ""), ...names.map((name) => new Option(name, name)));
}

function showCalibration() {
  const found = state.shown?.calibration?.calibration,
    {readings, distances} = pins.measured;
  byId("calibrated").hidden = !found;
  if (found) {
    const percent = (share) => `${Math.round(100 * share)} %`;
    const left = found.readings.filter((reading) => reading.outlier).length;
    const outliers = left
      ? ` ${left} of ${found.n_readings} did not fit the others and ${left > 1 ? "were" : "was"} left out.`
      : "";
    byId("calibrated-text").textContent =
      `Calibrated: all metres times ${found.scale.toFixed(3)}. Four pixels of five are ` +
      `expected to be right within ${percent(found.expected_error)}.${outliers}`;
  }
  byId("no-pins").hidden = pins.pins.length > 0;
  byId("calibrate-tools").hidden = pins.pins.length === 0;
  byId("calibrate").disabled = !readings.length && !distances.length;
  byId("calibrate").textContent = found ? "Calibrate again" : "Calibrate";
  byId("file-calibration").disabled = !found;
  showProgram();
}

// ---------------------------------------------------------------------------------------------- three dimensions

async function showSpace(kind) {
  state.space = kind;
  const flat = kind === null;
  press(...(flat ? [byId("show-picture"), byId("show-space")] : [byId("show-space"), byId("show-picture")]));
  byId("stage").hidden = !flat;
  byId("zoom-tools").hidden = !flat;
  byId("space").hidden = flat;
  byId("reading").hidden = !flat;
  byId("legend").hidden = !flat || !state.depth;
  if (flat || !state.depth) return;
  press(
    ...(kind === "cloud" ? [byId("show-cloud"), byId("show-surface")] : [byId("show-surface"), byId("show-cloud")]),
  );
  const {depth, photo, answered} = state;
  const isStale = () => state.depth !== depth || state.space !== kind; // something else is wanted by now
  try {
    await scene.start();
  } catch (error) {
    byId("extent").textContent = `Three dimensions cannot be shown here: ${error.message}`;
    return;
  }
  if (isStale()) return;
  let what;
  if (kind === "cloud") {
    what = `${scene.showPoints(depth, photo.picture).toLocaleString("en")} points`;
  } else {
    byId("extent").textContent = "";
    if (!state.surface) {
      const file = await fetchFile(answered, {format: "glb", max_triangles: SURFACE_TRIANGLES});
      const glb = await file.arrayBuffer();
      if (state.depth === depth) state.surface = glb;
      if (isStale()) return;
    }
    const surface = await scene.readSurface(state.surface);
    if (isStale()) return;
    what = `${Math.round(scene.showSurface(surface, depth)).toLocaleString("en")} triangles`;
  }
  byId("augmented").disabled = false;
  const [width, height, far] = scene.extent.map(metres);
  byId("extent").textContent = `${what}; ${width} wide, ${height} high, ${far} deep`;
}

/** Find out how this device shows the scene in the room around, and offer it, or say which other one does. */
async function offerRoom() {
  const button = byId("augmented"),
    quick = hasQuickLook();
  button.disabled = !quick; // until there is something to show
  button.hidden = !quick && !(await canShowRoom());
  byId("room-elsewhere").hidden = !button.hidden;
  button.addEventListener("click", () => guarded(quick ? openQuickLook : enterRoom));
}

async function enterRoom() {
  try {
    await room.enter();
  } catch (error) {
    throw new Problem({title: "This room cannot be shown", detail: error.message, status: null});
  }
}

async function openQuickLook() {
  const {depth, answered} = state,
    name = stem();
  const usdz = await fetchFile(answered, {format: "usdz", max_triangles: SURFACE_TRIANGLES});
  if (state.depth === depth) quickLook.open(usdz, name);
}

// ---------------------------------------------------------------------------------------------- files and programs

function fetchFile(asked, query) {
  return asking((options) => {
    showProgress("send", null);
    return service.file(asked, query, options);
  });
}

/** The name of the photo's file without its ending. */
function stem() {
  return state.photo.name.replace(/\.[^.]*$/, "");
}

function listFiles(formats) {
  const tile = (name, what, action) => {
    const button = element("button", {type: "button"}, name, element("small", {textContent: what}));
    button.addEventListener("click", () => guarded(action));
    byId("files").append(element("li", {}, button));
    return button;
  };
  for (const {format, name, ending, what} of FILES) {
    const known = formats.find((each) => each.name === format || each.aliases?.includes(format));
    const button = tile(name, what, async () => {
      const path = `${stem()}${ending}`;
      save(await fetchFile(state.shown ?? question(), {format}), path);
    });
    button.id = `file-${format}`;
    if (known && !known.available) {
      button.disabled = true;
      button.lastElementChild.textContent = "not installed";
    }
  }
  const calibration = tile("JSON", "calibration", () => {
    save(
      new Blob([`${JSON.stringify(state.shown.calibration, null, 2)}\n`], {type: "application/json"}),
      `${stem()}${CALIBRATION_ENDING}`,
    );
  });
  calibration.id = "file-calibration";
  calibration.disabled = true;
}

function showProgram() {
  if (!state.photo) return;
  const {curl, python} = programs(service.root, state.shown ?? question(), {token: service.token !== null});
  byId("code").textContent = byId("show-curl").getAttribute("aria-pressed") === "true" ? curl : python;
  byId("copied").textContent = "";
}

async function copyProgram() {
  const text = byId("code").textContent;
  try {
    await navigator.clipboard.writeText(text);
    byId("copied").textContent = "Copied.";
  } catch {
    // only https and this machine itself may write to the clipboard
    getSelection().selectAllChildren(byId("code"));
    byId("copied").textContent = "Selected: copy it with Ctrl+C.";
  }
}

// ---------------------------------------------------------------------------------------------- everything together

function listen() {
  listenForPhotos();
  viewer.addEventListener("point", (event) => showPoint(event.detail));
  viewer.addEventListener("view", () => showPoint(viewer.cursor));
  viewer.addEventListener("pick", (event) => pins.add(event.detail));
  viewer.addEventListener("undo", () => pins.removeLast());
  pins.addEventListener("change", () => {
    showCalibration();
    showPoint(viewer.cursor);
  });
  pins.addEventListener("measured", showCalibration);
  byId("nearer").addEventListener("click", () => viewer.nearer());
  byId("farther").addEventListener("click", () => viewer.farther());
  byId("fit").addEventListener("click", () => viewer.fit());
  byId("clear-pins").addEventListener("click", () => pins.clear());
  byId("calibrate").addEventListener("click", () => {
    state.calibrating = true;
    ask();
  });
  byId("uncalibrate").addEventListener("click", () => {
    state.calibrating = false;
    ask();
  });
  cameraPanel.addEventListener("change", () => {
    waiting();
    rescale();
  });
  cameraPanel.addEventListener("settled", () => {
    if (state.photo) ask();
  });
  for (const id of ["model", "domain"]) {
    byId(id).addEventListener("change", () => {
      if (id === "model") forgetHeads();
      if (state.photo) ask();
    });
  }
  for (const id of ["colormap", "near", "far", "confidence"]) byId(id).addEventListener("input", showDepth);
  byId("show-picture").addEventListener("click", () => guarded(() => showSpace(null)));
  byId("show-space").addEventListener("click", () => guarded(() => showSpace("cloud")));
  byId("show-cloud").addEventListener("click", () => guarded(() => showSpace("cloud")));
  byId("show-surface").addEventListener("click", () => guarded(() => showSpace("surface")));
  byId("home").addEventListener("click", () => scene.home());
  byId("stop").addEventListener("click", () => {
    stop();
    showLast();
  });
  byId("problem-close").addEventListener("click", hideProblem);
  byId("show-curl").addEventListener("click", () => {
    press(byId("show-curl"), byId("show-python"));
    showProgram();
  });
  byId("show-python").addEventListener("click", () => {
    press(byId("show-python"), byId("show-curl"));
    showProgram();
  });
  byId("copy").addEventListener("click", copyProgram);
  byId("token-form").addEventListener("submit", (event) => {
    event.preventDefault();
    service.token = byId("token").value;
    byId("token-form").hidden = true;
    hideProblem();
    guarded(start);
  });
}

/** Ask what there is to choose from. */
async function start() {
  const {models, default: chosen, formats = []} = await service.models();
  byId("model").replaceChildren(
    ...models.map(({name, what, licence}) => {
      const option = new Option(name, name, false, name === chosen);
      option.title = [what, licence && `licence: ${licence}`].filter(Boolean).join("; ");
      return option;
    }),
  );
  if (!byId("files").children.length) listFiles(formats);
  if (state.photo) await ask();
}

listen();
offerRoom();
guarded(start);

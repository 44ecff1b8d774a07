// The service, as the page calls it. Every call sends the photo again: the service keeps nothing.

import {Camera, Depth} from "./depth.js";

const MARK = "ZOEDMAPS"; // the first bytes of the maps
const MEGABYTE = 1e6;

/** A refusal or failure, in words for people. `status` is that of HTTP, 0 where the service did not answer. */
export class Problem extends Error {
  constructor({title, detail, status}) {
    super(title);
    Object.assign(this, {name: "Problem", title, detail: detail ?? "", status});
  }
}

/**
 * What to ask the service for a photo.
 *
 * @typedef {Object} Question
 * @property {Blob} photo the file as it is
 * @property {string} name the name of the file
 * @property {string} model
 * @property {?string} domain the head; null leaves it to the model's router
 * @property {{kind: "exif"|"fov"|"focal", value: ?number}} camera degrees across, or pixels of the photo
 * @property {?Object} calibration as the service gave it
 */

export class Service {
  constructor(root = new URL(".", document.baseURI)) {
    this.root = root;
    this.token = null;
    this.limits = {};
  }

  /** The models, the kinds of files, and the limits. */
  async models(signal) {
    const answer = parsed(await this.send("GET", "v1/models", null, {signal}));
    this.limits = answer.limits ?? {};
    return answer;
  }

  /** The depth of a photo: {facts, depth}. */
  async maps(question, options) {
    return readMaps(await this.post("v1/depth", question, {format: "maps"}, {}, options));
  }

  /** A file of a photo's depth, as a program would get it. */
  async file(question, query, options) {
    return new Blob([await this.post("v1/depth", question, query, {}, options)]);
  }

  /** The calibration that readings tell: [x, y, metres] of pixels, [[x, y], [x, y], metres] of two. */
  async calibrate(question, {readings, distances, alongRay}, options) {
    const parts = {readings: JSON.stringify(readings), distances: JSON.stringify(distances)};
    const uncalibrated = {...question, calibration: null};
    return parsed(await this.post("v1/calibrate", uncalibrated, {along_ray: alongRay}, parts, options));
  }

  post(path, question, query, parts, options) {
    const most = this.limits.max_body;
    if (most && question.photo.size > most) {
      // a service that refuses while a browser still sends is not heard
      throw new Problem({
        title: "The photo is too large",
        status: 413,
        detail: `It is ${(question.photo.size / MEGABYTE).toFixed(0)} MB, and the service takes ${most / MEGABYTE} MB.`,
      });
    }
    const body = new FormData();
    body.append("photo", question.photo, question.name);
    if (question.calibration)
      body.append("calibration", new Blob([JSON.stringify(question.calibration)]), "calibration.json");
    for (const [name, value] of Object.entries(parts)) body.append(name, value);
    return this.send("POST", `${path}?${new URLSearchParams({...queryOf(question), ...query})}`, body, options);
  }

  /** Send a request, and return the body of the answer; XMLHttpRequest tells how much has been sent. */
  send(method, path, body, {signal, progress} = {}) {
    return new Promise((resolve, reject) => {
      const request = new XMLHttpRequest();
      const failed = (title, detail) => reject(new Problem({title, detail, status: 0}));
      request.open(method, new URL(path, this.root));
      request.responseType = "arraybuffer";
      if (this.token) request.setRequestHeader("Authorization", `Bearer ${this.token}`);
      request.upload.onprogress = ({loaded, total}) => progress?.("send", total ? loaded / total : null);
      request.upload.onload = () => progress?.("compute", null);
      request.onprogress = ({loaded, total}) => progress?.("receive", total ? loaded / total : null);
      request.onload = () => {
        if (request.status >= 200 && request.status < 300) resolve(request.response);
        else reject(problemOf(request));
      };
      request.onerror = () =>
        failed(
          "The service does not answer",
          "Is it still running, and is the network there? The " +
            "photo may also have been changed on the disk since you chose it.",
        );
      request.ontimeout = () => failed("The service takes too long", "Try again.");
      request.onabort = () => reject(new DOMException("stopped", "AbortError"));
      if (signal?.aborted) return request.onabort();
      signal?.addEventListener("abort", () => request.abort(), {once: true});
      request.send(body);
      return undefined;
    });
  }
}

/** The query of a question, as /v1/depth, /v1/measure and /v1/calibrate take it. */
export function queryOf({model, domain, camera}) {
  const query = {};
  if (model) query.model = model;
  if (domain) query.domain = domain;
  if (camera.kind === "fov") query.fov_x = String(camera.value);
  if (camera.kind === "focal") query.focal_px = String(camera.value);
  return query;
}

function parsed(buffer) {
  return JSON.parse(new TextDecoder().decode(buffer));
}

/** What the service says of a request that it refused (RFC 9457). */
function problemOf(request) {
  let said = {};
  try {
    said = parsed(request.response);
  } catch {
    // A proxy in between may answer in its own way.
  }
  const seconds = Number(request.getResponseHeader("Retry-After"));
  const wait = seconds ? ` Try again in ${seconds} s.` : "";
  return new Problem({
    title: said.title ?? `The service answered ${request.status}`,
    detail: (said.detail ?? "") + wait,
    status: request.status,
  });
}

/** Read the maps: a mark, the length of a header of JSON, the header, and the arrays at the places that it says. */
function readMaps(buffer) {
  const mark = buffer.byteLength >= 12 ? String.fromCharCode(...new Uint8Array(buffer, 0, MARK.length)) : "";
  if (mark !== MARK)
    throw new Problem({
      title: "The answer cannot be read",
      detail: "It was cut off, or is of another service.",
      status: 0,
    });
  const length = new DataView(buffer).getUint32(MARK.length, true);
  const facts = parsed(buffer.slice(MARK.length + 4, MARK.length + 4 + length));
  const kinds = {float32: Float32Array, uint8: Uint8Array};
  const array = (name) => {
    const about = facts.arrays[name];
    return about ? new kinds[about.type](buffer, about.offset, about.shape[0] * about.shape[1]) : null;
  };
  const depth = new Depth({
    size: facts.arrays.depth.shape,
    values: array("depth"),
    std: array("std"),
    valid: array("valid"),
    camera: new Camera(facts.camera),
  });
  return {facts, depth};
}

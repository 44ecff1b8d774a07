// The scene in the room around (AR) by WebXR, as Chrome on Android has it: at true scale, first as if the photo had been
// taken from here, then where the floor or a table is tapped.

/** True where the browser can do that: only over https, or from this machine itself. */
export async function canShowRoom() {
  try {
    return Boolean(await navigator.xr?.isSessionSupported("immersive-ar"));
  } catch {
    return false; // forbidden by a setting
  }
}

export class Room {
  /**
   * @param {Scene} scene what is shown
   * @param {Object} parts of the page: `overlay`, which lies over the room, `hint`, and the buttons `again` and `leave`
   */
  constructor(scene, {overlay, hint, again, leave}) {
    Object.assign(this, {scene, overlay, hint, session: null});
    again.addEventListener("click", () => {
      this.placed = null;
    });
    leave.addEventListener("click", () => this.session?.end());
    // A tap on a button is none on the room.
    for (const button of [again, leave]) button.addEventListener("beforexrselect", (event) => event.preventDefault());
  }

  /** Show the scene until the one who looks at it leaves; returns when it is shown. */
  async enter() {
    const {scene} = this,
      {renderer} = scene;
    const session = await navigator.xr.requestSession("immersive-ar", {
      optionalFeatures: ["hit-test", "dom-overlay"],
      domOverlay: {root: this.overlay},
    });
    Object.assign(this, {session, placed: null, tapped: null, surfaces: null});
    // The camera of the page's own view stays where it is.
    this.camera = new THREE.PerspectiveCamera(60, 1, scene.camera.near, scene.camera.far);
    session.addEventListener("selectstart", () => {
      this.tapped = null;
    });
    session.addEventListener("select", () => this.select());
    renderer.xr.addEventListener("sessionend", this.left); // when three.js has left, too
    renderer.xr.enabled = true;
    renderer.xr.setReferenceSpaceType("local");
    renderer.setAnimationLoop((time, frame) => frame && this.draw(frame));
    try {
      await renderer.xr.setSession(session);
      this.surfaces = await session
        .requestHitTestSourceForTransientInput?.({profile: "generic-touchscreen"})
        ?.catch(() => null); // refused, or a device that knows no surfaces
    } catch (error) {
      await session.end();
      throw error;
    }
    this.say(this.surfaces ? "Tap the floor or a table to put it there." : "Tap to have it in front of you again.");
    this.overlay.hidden = false;
  }

  say(what) {
    this.hint.textContent = `At its true size. ${what}`;
  }

  draw(frame) {
    const {xr} = this.scene.renderer,
      space = xr.getReferenceSpace(),
      pose = frame.getViewerPose(space);
    if (pose) {
      this.viewer = pose.transform.matrix;
      if (this.placed !== this.scene.content) this.putInFront();
      const [view] = xr.getCamera().cameras;
      this.scene.sizePoints((view.projectionMatrix.elements[5] * view.viewport.w) / 2);
    }
    if (this.surfaces) {
      for (const {results} of frame.getHitTestResultsForTransientInput(this.surfaces)) {
        if (results.length) this.tapped = results[0].getPose(space).transform.position;
      }
    }
    this.scene.renderer.render(this.scene.world, this.camera);
  }

  /** Tapped: put it there, where a surface is known there. */
  select() {
    if (!this.surfaces) this.placed = null;
    else if (!this.tapped) this.say("No surface is known there yet: move the phone about, and tap again.");
    else this.putOn(this.tapped);
  }

  /** Put the camera of the photo where the viewer is, level, looking where the viewer looks. */
  putInFront() {
    this.turn();
    this.scene.content.position.set(...this.viewer.slice(12, 15));
    this.placed = this.scene.content;
  }

  /** Put the middle of its foot on a place, as seen from the viewer's side. */
  putOn({x, y, z}) {
    const {content, box} = this.scene,
      foot = box.getCenter(new THREE.Vector3()).setY(box.min.y);
    this.turn();
    content.position.set(x, y, z).sub(foot.applyEuler(content.rotation));
  }

  /** Turn the photo's direction to the viewer's, seen from above. */
  turn() {
    const {viewer} = this; // columns: to the right, up, backward, place
    const ahead = (axis) => -viewer[8 + axis] + viewer[9] * viewer[4 + axis]; // up or down, the phone's top tells
    this.scene.content.rotation.set(0, Math.atan2(-ahead(0), -ahead(2)), 0);
  }

  /** Show the page again as it was. */
  left = () => {
    const {scene} = this,
      {renderer, content} = scene;
    this.session = null;
    this.overlay.hidden = true;
    renderer.setAnimationLoop(null);
    renderer.xr.enabled = false;
    content.position.set(0, 0, 0);
    content.rotation.set(0, 0, 0);
    scene.resize();
  };
}

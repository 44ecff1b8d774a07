// A room that is not there, for tests: WebXR as a phone has it, as far as the page and three.js use it.

(() => {
  const [WIDTH, HEIGHT, NEAR, FAR] = [120, 160, 0.01, 1000];

  const room = (window.fakeRoom = {
    asked: [], // what sessions were asked for
    focal: 150, // pixels
    place: [0, 0, 0], // of the phone
    yaw: 0, // of the phone, to the left, radians
    surface: null, // what a finger touches: a place, or null for nothing that is known
    touching: false,
    session: null,

    /** Touch the screen for some frames. */
    async tap() {
      room.touching = true;
      room.session.dispatchEvent(new Event("selectstart"));
      await frames(3);
      room.touching = false;
      room.session.dispatchEvent(new Event("select"));
    },

    /** The next picture but one: RGBA, from the bottom, in base64. */
    async look() {
      await frames(2);
      return new Promise((resolve) => {
        room.looking = (layer) => resolve([HEIGHT, WIDTH, btoa(String.fromCharCode(...layer.pixels()))]);
      });
    },
  });

  async function frames(n) {
    for (let i = 0; i < n; i++) await new Promise((resolve) => requestAnimationFrame(resolve));
  }

  /** The phone, column by column. */
  function viewer() {
    const [x, y, z] = room.place,
      [sine, cosine] = [Math.sin(room.yaw), Math.cos(room.yaw)];
    return Float32Array.of(cosine, 0, -sine, 0, 0, 1, 0, 0, sine, 0, cosine, 0, x, y, z, 1);
  }

  function projection() {
    const [across, along, deep] = [(2 * room.focal) / WIDTH, (2 * room.focal) / HEIGHT, FAR - NEAR];
    const depths = [-(FAR + NEAR) / deep, -1, 0, 0, (-2 * FAR * NEAR) / deep, 0];
    return Float32Array.of(across, 0, 0, 0, 0, along, 0, 0, 0, 0, ...depths);
  }

  class Layer {
    framebufferWidth = WIDTH;
    framebufferHeight = HEIGHT;

    constructor(session, gl) {
      this.gl = gl;
      this.framebuffer = gl.createFramebuffer();
      const [color, depth] = [gl.createRenderbuffer(), gl.createRenderbuffer()];
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      for (const [buffer, format, attachment] of [
        [color, gl.RGBA8, gl.COLOR_ATTACHMENT0],
        [depth, gl.DEPTH24_STENCIL8, gl.DEPTH_STENCIL_ATTACHMENT],
      ]) {
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorage(gl.RENDERBUFFER, format, WIDTH, HEIGHT);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
      }
      gl.bindRenderbuffer(gl.RENDERBUFFER, null);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }

    getViewport() {
      return {x: 0, y: 0, width: WIDTH, height: HEIGHT};
    }

    pixels() {
      const {gl} = this,
        bytes = new Uint8Array(4 * WIDTH * HEIGHT),
        bound = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.framebuffer);
      gl.readPixels(0, 0, WIDTH, HEIGHT, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, bound);
      return bytes;
    }
  }

  class Frame {
    getViewerPose() {
      const transform = {matrix: viewer()};
      return {transform, views: [{eye: "none", projectionMatrix: projection(), transform}]};
    }

    getHitTestResultsForTransientInput() {
      if (!room.touching) return [];
      const [x, y, z] = room.surface ?? [];
      return [{results: room.surface ? [{getPose: () => ({transform: {position: {x, y, z}}})}] : []}];
    }
  }

  class Session extends EventTarget {
    environmentBlendMode = "alpha-blend";
    enabledFeatures = ["hit-test", "dom-overlay"];
    inputSources = [];
    renderState = {};

    updateRenderState(state) {
      Object.assign(this.renderState, state);
    }

    async requestReferenceSpace(kind) {
      return {kind};
    }

    async requestHitTestSourceForTransientInput() {
      return {};
    }

    requestAnimationFrame(callback) {
      return requestAnimationFrame((time) => {
        callback(time, new Frame());
        room.looking?.(this.renderState.baseLayer);
        room.looking = null;
      });
    }

    cancelAnimationFrame(handle) {
      cancelAnimationFrame(handle);
    }

    async end() {
      room.session = null;
      this.dispatchEvent(new Event("end"));
    }
  }

  window.XRWebGLLayer = Layer;
  window.XRWebGLBinding = undefined; // as browsers that know no other layers
  WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
  Object.defineProperty(navigator, "xr", {
    value: {
      isSessionSupported: async (mode) => mode === "immersive-ar",
      requestSession: async (mode, options) => {
        room.asked.push([mode, options.optionalFeatures, options.domOverlay.root.id]);
        return (room.session = new Session());
      },
    },
  });
})();

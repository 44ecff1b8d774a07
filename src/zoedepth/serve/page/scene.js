// The photo in three dimensions, at true scale: its points, made here of the depth, or its surface, the GLB of the API.
// Axes are those of glTF: x to the right, y up, and the photo looks along -z from the origin; one unit is a metre.

const MOST_POINTS = 400_000;
const BACKGROUND = 0x14191a;

let loading = null;

/** Load three.js, a classic script, when it is first wanted. */
function loadThree() {
  loading ??= new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = "three.min.js";
    script.onload = () => resolve(window.THREE);
    script.onerror = () => reject(new Error("three.js could not be loaded from the service"));
    document.head.append(script);
  });
  return loading;
}

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.content = null;
  }

  /** Get ready to draw; to be called before anything is shown. */
  async start() {
    const THREE = await loadThree();
    if (this.renderer) return;
    this.renderer = new THREE.WebGLRenderer({canvas: this.canvas, antialias: true, alpha: true});
    this.renderer.setClearColor(BACKGROUND);
    this.world = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(60, 1, 0.01, 1000);
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    this.controls.listenToKeyEvents(this.canvas);
    this.controls.keyPanSpeed = 20;
    this.controls.addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.resize()).observe(this.canvas);
  }

  /** Show the points of the usable pixels in the colours of the photo. Returns how many there are. */
  showPoints(depth, photo) {
    const step = Math.ceil(Math.sqrt((depth.width * depth.height) / MOST_POINTS));
    const columns = Math.floor((depth.width - 1) / step) + 1,
      rows = Math.floor((depth.height - 1) / step) + 1;
    const colors = pixelColors(photo, depth, columns, rows);
    const places = new Float32Array(3 * columns * rows),
      shades = new Float32Array(3 * columns * rows);
    let n = 0;
    for (let j = 0; j < rows; j++) {
      for (let i = 0; i < columns; i++) {
        const pixel = {column: i * step, row: j * step};
        if (!depth.read(pixel).valid) continue;
        const [x, y, z] = depth.point(pixel);
        places.set([x, -y, -z], 3 * n);
        for (let k = 0; k < 3; k++) shades[3 * n + k] = LINEAR[colors ? colors[4 * (j * columns + i) + k] : 200];
        n++;
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places.slice(0, 3 * n), 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(shades.slice(0, 3 * n), 3));
    // A point stands for step x step pixels of its depth: sizePoints.
    const material = new THREE.PointsMaterial({vertexColors: true, size: 1, sizeAttenuation: false});
    this.pointStep = step;
    this.replace(new THREE.Points(geometry, material), depth);
    return n;
  }

  /** Read a surface, a GLB, to be shown. */
  async readSurface(glb) {
    const {scene} = await new Promise((resolve, reject) => {
      new THREE.GLTFLoader().parse(glb, "", resolve, (error) =>
        reject(new Error(`the surface cannot be shown: ${error.message}`)),
      );
    });
    return scene;
  }

  /** Show a surface that was read. Returns its number of triangles. */
  showSurface(surface, depth) {
    let triangles = 0;
    surface.traverse((part) => {
      if (part.isMesh) triangles += (part.geometry.index?.count ?? part.geometry.attributes.position.count) / 3;
    });
    this.replace(surface, depth);
    return triangles;
  }

  replace(content, depth) {
    const first = !this.content;
    if (this.content) {
      this.world.remove(this.content);
      this.content.traverse((part) => {
        part.geometry?.dispose();
        part.material?.map?.dispose();
        part.material?.dispose();
      });
    }
    this.content = content;
    this.depth = depth;
    this.world.add(content);
    this.box = new THREE.Box3().setFromObject(content);
    const size = this.box.getSize(new THREE.Vector3());
    this.camera.far = Math.max(100, size.length() * 10);
    this.camera.near = Math.max(this.camera.far / 1e5, 0.005);
    this.resize();
    if (first || this.otherPhoto) this.home();
    this.otherPhoto = false;
  }

  /** Width, height and depth of what is shown, metres. */
  get extent() {
    return this.box.getSize(new THREE.Vector3()).toArray();
  }

  /** Look from where the photo was taken. */
  home() {
    const [middle] = this.depth.quantiles([0.5]);
    this.camera.position.set(0, 0, 0);
    this.controls.target.set(0, 0, -middle);
    this.resize();
    this.controls.update();
    this.draw();
  }

  /** Fit the canvas, and see at home what the photo shows, whatever the shape of the window. */
  resize() {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    if (!width || !height || !this.depth || this.renderer.xr.isPresenting) return;
    const {fx, fy} = this.depth.camera;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    const tangent = Math.max(this.depth.height / 2 / fy, this.depth.width / 2 / fx / this.camera.aspect);
    this.camera.fov = (2 * Math.atan(tangent) * 180) / Math.PI;
    this.camera.updateProjectionMatrix();
    this.sizePoints(height / 2 / tangent);
    this.draw();
  }

  /** Make points twice as large as the gaps between them, for a picture of this focal length in CSS pixels. */
  sizePoints(focal) {
    if (!this.content.isPoints) return;
    this.content.material.size = Math.max(1.8, (2.1 * this.pointStep * focal) / this.depth.camera.fy);
  }

  /** Draw at the next frame, once, however much has changed: a page at rest costs nothing. */
  draw() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      if (!this.renderer.xr.isPresenting) this.renderer.render(this.world, this.camera);
    });
  }
}

// Values of sRGB, as photos have them, in linear light, as three.js takes the colours of points.
const LINEAR = Float32Array.from({length: 256}, (_, value) => {
  const share = value / 255;
  return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
});

function pixelColors(photo, depth, columns, rows) {
  if (!photo) return null;
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d", {willReadFrequently: true});
  context.drawImage(photo, 0, 0, columns, rows);
  return context.getImageData(0, 0, columns, rows).data;
}

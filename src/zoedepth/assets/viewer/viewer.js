// Shows the content of the page, a mesh or a cloud, on a turntable. The page says what it is:
//   #facts: {kind: "glb" | "ply" | "pcd", up: "y" | "-y" | "z", place: "photo" | "around" | "outside"}
//     place: where the first look is from. photo: the camera of the photo, at the origin. around: the origin of a
//     panorama, which is inside. outside: wherever all can be seen.
//   #content: the file, base64.
// The address may end in #angle=30: turned so far about the vertical, in degrees, and at rest; for pictures of it.
// With #angle=30&bare there is nothing else in the picture.
"use strict";

(() => {
  const facts = JSON.parse(document.getElementById("facts").textContent);
  const canvas = document.getElementById("view");
  const about = document.getElementById("about");
  const motionButton = document.getElementById("motion");
  const homeButton = document.getElementById("home");
  const AXIS = new THREE.Vector3(0, 1, 0);
  const SWING = 22, SWING_SECONDS = 9; // degrees to either side, and seconds there and back
  const TURN_SECONDS = 30; // seconds once around
  const LIFT = 14; // degrees above the horizon from which a thing is seen from outside
  const INSIDE_FOV = 80, OUTSIDE_FOV = 40;

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({canvas, antialias: true, preserveDrawingBuffer: true});
  } catch (error) {
    return failed(error);
  }
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  renderer.setClearColor(0x1c1d21);
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(OUTSIDE_FOV, 1, 0.01, 1000);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = true;
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8a8a, 2.2));
  const sun = new THREE.DirectionalLight(0xffffff, 1.2);
  sun.position.set(0.5, 1, 0.8);
  scene.add(sun);

  const home = {position: new THREE.Vector3(), target: new THREE.Vector3(), fovX: 0, fovY: OUTSIDE_FOV};
  const cloudMaterials = [];
  let clouds = 0; // points of all clouds
  let moving = false, phase = 0, last = null;

  function failed(error) {
    about.textContent = `It cannot be shown: ${error.message || error}`;
    document.documentElement.dataset.state = "failed";
  }

  function bytes() {
    const element = document.getElementById("content");
    const text = atob(element.textContent);
    element.remove(); // it is large
    const result = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) result[i] = text.charCodeAt(i);
    return result.buffer;
  }

  function load() {
    const content = bytes();
    if (facts.kind === "ply") {
      const geometry = new THREE.PLYLoader().parse(content);
      return Promise.resolve({object: geometry.index ? surface(geometry) : cloud(geometry), cameras: []});
    }
    if (facts.kind === "pcd") {
      return Promise.resolve({object: cloud(new THREE.PCDLoader().parse(content).geometry), cameras: []});
    }
    return new Promise((resolve, reject) => {
      new THREE.GLTFLoader().parse(content, "", (gltf) => resolve({object: gltf.scene, cameras: gltf.cameras}), reject);
    });
  }

  function surface(geometry) {
    if (!geometry.attributes.normal) geometry.computeVertexNormals();
    const colored = Boolean(geometry.attributes.color);
    return new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({vertexColors: colored, side: THREE.DoubleSide}));
  }

  function cloud(geometry) {
    const colored = Boolean(geometry.attributes.color);
    const material = new THREE.PointsMaterial({
      vertexColors: colored, color: colored ? 0xffffff : 0xb8bcc8, sizeAttenuation: false,
    });
    cloudMaterials.push(material);
    clouds += geometry.attributes.position.count;
    return new THREE.Points(geometry, material);
  }

  function count(object) {
    const total = {triangles: 0, points: 0};
    object.traverse((part) => {
      if (!part.geometry) return;
      const position = part.geometry.attributes.position;
      if (part.isPoints) total.points += position.count;
      else total.triangles += (part.geometry.index ? part.geometry.index.count : position.count) / 3;
    });
    return total;
  }

  // Some of the points, in the axes of the page: at most `limit` of each part.
  function sample(object, limit) {
    const points = [];
    object.updateMatrixWorld(true);
    object.traverse((part) => {
      const position = part.geometry && part.geometry.attributes.position;
      if (!position) return;
      const step = Math.max(1, Math.ceil(position.count / limit));
      for (let i = 0; i < position.count; i += step) {
        const point = new THREE.Vector3().fromBufferAttribute(position, i).applyMatrix4(part.matrixWorld);
        if (Number.isFinite(point.x + point.y + point.z)) points.push(point);
      }
    });
    return points;
  }

  function median(numbers) {
    return numbers.sort((a, b) => a - b)[Math.floor(numbers.length / 2)];
  }

  function lookFrom(object, cameras) {
    const points = sample(object, 20000);
    if (!points.length) throw new Error("there is nothing in it to be seen");
    const box = new THREE.Box3().setFromPoints(points);
    const size = box.getSize(new THREE.Vector3());
    const radius = Math.max(size.length() / 2, 1e-6);
    camera.near = radius / 1000;
    camera.far = radius * 100;
    if (facts.place === "photo") {
      let tangentX = 0, tangentY = 0;
      for (const point of points) {
        if (point.z >= 0) continue;
        tangentX = Math.max(tangentX, Math.abs(point.x / point.z));
        tangentY = Math.max(tangentY, Math.abs(point.y / point.z));
      }
      home.fovX = 2 * Math.atan(tangentX);
      home.fovY = 2 * Math.atan(tangentY);
      if (cameras.length) {
        home.fovY = THREE.MathUtils.degToRad(cameras[0].fov);
        home.fovX = 2 * Math.atan(Math.tan(home.fovY / 2) * cameras[0].aspect);
      }
      home.position.set(0, 0, 0);
      home.target.set(0, 0, -median(points.map((point) => point.length())));
    } else if (facts.place === "around") {
      home.position.set(0, 0, 0);
      home.target.set(0, 0, -radius / 500);
      home.fovX = home.fovY = THREE.MathUtils.degToRad(INSIDE_FOV);
      camera.near = radius / 5000;
    } else {
      box.getCenter(home.target);
      const distance = 1.05 * radius / Math.sin(THREE.MathUtils.degToRad(OUTSIDE_FOV / 2));
      const lift = THREE.MathUtils.degToRad(LIFT);
      home.position.set(0, Math.sin(lift), Math.cos(lift)).multiplyScalar(distance).add(home.target);
      home.fovX = home.fovY = THREE.MathUtils.degToRad(OUTSIDE_FOV);
    }
    return size;
  }

  // The field of view at which all is seen that the first look shows, whatever the shape of the window.
  function fit() {
    const width = canvas.clientWidth, height = canvas.clientHeight;
    renderer.setSize(width, height, false);
    camera.aspect = width / Math.max(1, height);
    const tangent = Math.max(Math.tan(home.fovY / 2), Math.tan(home.fovX / 2) / camera.aspect);
    camera.fov = THREE.MathUtils.radToDeg(2 * Math.atan(tangent));
    camera.updateProjectionMatrix();
    // Points as large as the gaps between them, when they fill the window.
    const size = Math.sqrt(width * height / Math.max(1, clouds)) * 1.3 * renderer.getPixelRatio();
    for (const material of cloudMaterials) material.size = Math.min(Math.max(size, 1.5), 12);
  }

  // Look from where the first look is from, turned by so many degrees about the vertical.
  function turn(degrees) {
    const angle = THREE.MathUtils.degToRad(degrees);
    if (facts.place === "around") {
      camera.position.copy(home.position);
      controls.target.copy(home.target).applyAxisAngle(AXIS, -angle);
    } else {
      camera.position.copy(home.position).sub(home.target).applyAxisAngle(AXIS, angle);
      // From the side, what the photo shows is deeper than wide: step back.
      if (facts.place === "photo") camera.position.multiplyScalar(1 + 0.9 * (1 - Math.cos(angle)) / 2);
      camera.position.add(home.target);
      controls.target.copy(home.target);
    }
    controls.update();
  }

  function setMoving(wanted) {
    moving = wanted;
    last = null;
    motionButton.setAttribute("aria-pressed", String(moving));
    motionButton.textContent = moving ? "stop" : "turn";
  }

  function frame(now) {
    if (moving) {
      if (last !== null) phase += (now - last) / 1000;
      last = now;
      const swings = facts.place === "photo";
      turn(swings ? SWING * Math.sin(2 * Math.PI * phase / SWING_SECONDS) : 360 * phase / TURN_SECONDS);
    } else {
      controls.update();
    }
    renderer.render(scene, camera);
    requestAnimationFrame(frame);
  }

  function start({object, cameras}) {
    const root = new THREE.Group();
    if (facts.up === "-y") root.rotation.x = Math.PI;
    if (facts.up === "z") root.rotation.x = -Math.PI / 2;
    root.add(object);
    scene.add(root);
    const size = lookFrom(root, cameras);
    const {triangles, points} = count(root);
    const what = [
      triangles ? `${Math.round(triangles).toLocaleString("en")} triangles` : "",
      points ? `${points.toLocaleString("en")} points` : "",
    ].filter(Boolean).join(", ");
    about.textContent = `${what}; ${size.x.toPrecision(3)} m wide, ${size.y.toPrecision(3)} m high, ` +
      `${size.z.toPrecision(3)} m deep`;
    if (facts.place !== "photo") homeButton.textContent = "first view";
    if (facts.place === "around") {
      controls.enableZoom = controls.enablePan = false;
      controls.rotateSpeed = -0.35; // the content follows the pointer
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        camera.fov = Math.min(Math.max(camera.fov * Math.exp(event.deltaY / 1000), 20), 110);
        camera.updateProjectionMatrix();
      }, {passive: false});
    }
    fit();
    new ResizeObserver(fit).observe(canvas);
    controls.addEventListener("start", () => setMoving(false));
    motionButton.addEventListener("click", () => setMoving(!moving));
    homeButton.addEventListener("click", () => { setMoving(false); phase = 0; fit(); turn(0); });
    window.addEventListener("keydown", (event) => {
      if (event.key === " " && event.target.tagName !== "BUTTON") { event.preventDefault(); setMoving(!moving); }
    });
    const asked = /[#&]angle=(-?[\d.]+)/.exec(window.location.hash);
    if (/[#&]bare/.test(window.location.hash)) {
      for (const part of document.querySelectorAll("header, footer")) part.remove();
    }
    turn(asked ? Number(asked[1]) : 0);
    setMoving(!asked && !window.matchMedia("(prefers-reduced-motion: reduce)").matches);
    requestAnimationFrame(frame);
    // A second frame shows the textures as well.
    requestAnimationFrame(() => requestAnimationFrame(() => { document.documentElement.dataset.state = "ready"; }));
  }

  load().then(start).catch(failed);
})();

#!/bin/sh
# Makes src/zoedepth/assets/viewer/three.min.js anew: the parts of three.js that viewer.js and the page of the service
# (serve/page) use, in one file, with its licence. Needs npm and the network.
set -eu
version=0.187.0
target="$(cd "$(dirname "$0")/.." && pwd)/src/zoedepth/assets/viewer/three.min.js"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-save "three@$version" esbuild@0.28.2
cat > parts.js <<'PARTS'
export {
  Box3, BufferAttribute, BufferGeometry, DirectionalLight, DoubleSide, Group, HemisphereLight, MathUtils, Mesh,
  MeshBasicMaterial, MeshStandardMaterial, PerspectiveCamera, Points, PointsMaterial, Scene, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
export { PCDLoader } from "three/addons/loaders/PCDLoader.js";
export { PLYLoader } from "three/addons/loaders/PLYLoader.js";
PARTS
npx esbuild parts.js --bundle --minify --format=iife --global-name=THREE --target=es2020 --outfile=three.min.js
{
  echo "/*! three.js (three@$version of npm) with OrbitControls, GLTFLoader, PCDLoader and PLYLoader."
  echo
  cat node_modules/three/LICENSE
  echo "*/"
  cat three.min.js
} > "$target"

// WebP photos upright. Browsers differ in whether they heed the orientation that stands in a WebP's EXIF, as the service
// does; so it is taken out of the file before they read the picture, which is turned here.

const ORIENTATION = 0x0112; // the tag
const ENTRY = 12; // bytes of an entry in EXIF's directory: tag, kind, count and value

/** A file that no browser turns, and the orientation (1 to 8) by which it is to be turned; other kinds as they are. */
export async function asStored(blob) {
  const start = new TextDecoder("latin1").decode(await blob.slice(0, 12).arrayBuffer());
  if (!/^RIFF[^]{4}WEBP$/.test(start)) return {file: blob, orientation: 1};
  const view = new DataView(await blob.arrayBuffer()),
    found = findOrientation(view);
  if (!found) return {file: blob, orientation: 1};
  const orientation = view.getUint16(found.place, found.little);
  view.setUint16(found.place, 1, found.little);
  return {file: new Blob([view], {type: blob.type}), orientation};
}

/** Where a WebP has its orientation, and whether the low byte comes first; null where it has none. */
function findOrientation(view) {
  const exif = findExif(view);
  if (exif === null) return null;
  const little = view.getUint16(exif) === 0x4949; // "II"
  const directory = exif + view.getUint32(exif + 4, little);
  const end = directory + 2 + ENTRY * view.getUint16(directory, little);
  for (let entry = directory + 2; entry < end; entry += ENTRY) {
    if (view.getUint16(entry, little) === ORIENTATION) return {place: entry + 8, little};
  }
  return null;
}

/** Where the EXIF of a WebP begins; null where it has none. */
function findExif(view) {
  for (let chunk = 12; chunk + 8 < view.byteLength; ) {
    const content = chunk + 8,
      length = view.getUint32(chunk + 4, true);
    if (view.getUint32(chunk) === 0x45584946) {
      return view.getUint32(content) === 0x45786966 ? content + 6 : content; // some begin as in JPEG: "Exif", 0, 0
    }
    chunk = content + length + (length % 2);
  }
  return null;
}

/** A picture turned upright by EXIF's orientation; as it is where that is nonsense. */
export function turned(picture, orientation) {
  const {width, height} = picture;
  const moves = {
    2: [-1, 0, 0, 1, width, 0],
    3: [-1, 0, 0, -1, width, height],
    4: [1, 0, 0, -1, 0, height],
    5: [0, 1, 1, 0, 0, 0],
    6: [0, 1, -1, 0, height, 0],
    7: [0, -1, -1, 0, height, width],
    8: [0, -1, 1, 0, 0, width],
  };
  if (!moves[orientation]) return picture;
  const canvas = document.createElement("canvas"),
    context = canvas.getContext("2d");
  [canvas.width, canvas.height] = orientation > 4 ? [height, width] : [width, height];
  context.setTransform(...moves[orientation]);
  context.drawImage(picture, 0, 0);
  return canvas;
}

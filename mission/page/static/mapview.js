// @ts-check
// Where the map looks: metres to pixels and back. Zoom 1 shows the whole field; a robot may be followed.
/** @import { FieldShape, Robot } from "./protocol" */
/** @typedef {[east: number, north: number]} Place */
/** @typedef {[x: number, y: number]} Pixel */
/** @typedef {[upperLeft: Place, upperRight: Place, lowerLeft: Place]} Corners of a picture */
/**
 * What of the field is in sight: pixel (x, y) shows (east, north); `whole` and `scale` are pixels a metre.
 * @typedef {{ width: number, height: number, whole: number, scale: number, east: number, north: number, x: number, y: number }} MapView
 */
const MOST_ZOOM = 400;
const LEAST_ZOOM = 0.2;
const PAD = { left: 44, right: 18, top: 54, bottom: 50 }; // axis labels, and the switch for the layers

/** @type {{ zoom: number, east: number | null, north: number | null, following: string, version: number }} */
const camera = { zoom: 1, east: null, north: null, following: "", version: 0 };
/** @type {MapView} */
export let view = { width: 0, height: 0, whole: 0, scale: 0, east: 0, north: 0, x: 0, y: 0 }; // of a map that is not drawn yet

export const looking = {
  get version() { return camera.version; },
  get following() { return camera.following; },
  get isWhole() { return camera.zoom === 1 && camera.east === null && !camera.following; },
};

/** @param {number} east */
export const X = (east) => view.x + (east - view.east) * view.scale;
/** @param {number} north */
export const Y = (north) => view.y - (north - view.north) * view.scale;
/** @type {(place: Place) => Pixel} */
export const toPixels = ([east, north]) => [X(east), Y(north)];
/** @type {(pixel: Pixel) => Place} */
export const toMetres = ([x, y]) => [view.east + (x - view.x) / view.scale, view.north - (y - view.y) / view.scale];

// To the centimetre, as people say a place.
/** @type {(place: Place) => Place} */
export const rounded = ([east, north]) => [+east.toFixed(2), +north.toFixed(2)];

// Frames `view` for a canvas of so many pixels; `robots` are those of the frame shown.
/** @param {number} width @param {number} height @param {Pick<FieldShape, "east_m" | "north_m">} field @param {Robot[]} robots */
export function frameView(width, height, field, robots) {
  const room = { east: width - PAD.left - PAD.right, north: height - PAD.top - PAD.bottom };
  const whole = Math.min(room.east / field.east_m, room.north / field.north_m);
  const followed = robots.find((robot) => robot.name === camera.following && robot.east_m !== null);
  if (followed) { camera.east = followed.east_m; camera.north = followed.north_m; }
  view = {
    width, height, whole, scale: whole * camera.zoom,
    east: camera.east ?? field.east_m / 2, north: camera.north ?? field.north_m / 2,
    x: PAD.left + room.east / 2, y: PAD.top + room.north / 2,
  };
}

/** @param {number} dx @param {number} dy */
export function panBy(dx, dy) {
  if (!view.scale) return;
  camera.following = "";
  camera.east = view.east - dx / view.scale;
  camera.north = view.north + dy / view.scale;
  Object.assign(view, { east: camera.east, north: camera.north });
  camera.version += 1;
}

// What lies under the pixel stays under it.
/** @param {Pixel} pixel @param {number} factor */
export function zoomAt([x, y], factor) {
  if (!view.scale) return;
  const zoom = Math.min(MOST_ZOOM, Math.max(LEAST_ZOOM, camera.zoom * factor));
  const [east, north] = toMetres([x, y]);
  camera.zoom = zoom;
  view.scale = view.whole * zoom;
  if (!camera.following) {
    camera.east = east - (x - view.x) / view.scale;
    camera.north = north + (y - view.y) / view.scale;
    Object.assign(view, { east: camera.east, north: camera.north });
  }
  camera.version += 1;
}

/** @param {number} factor */
export function zoomBy(factor) { zoomAt([view.x, view.y], factor); }

export function showWhole() {
  Object.assign(camera, { zoom: 1, east: null, north: null, following: "" });
  camera.version += 1;
}

/** @param {number} east @param {number} north */
export function lookAt(east, north) {
  Object.assign(camera, { east, north, following: "" });
  camera.version += 1;
}

/** @param {string} name */
export function follow(name) {
  camera.following = camera.following === name ? "" : name;
  if (camera.following && camera.zoom < 2) camera.zoom = 2;
  camera.version += 1;
}

// A picture of the ground, placed by three of its corners: one affine map.
/** @param {CanvasRenderingContext2D} pen @param {CanvasImageSource} image @param {number} width @param {number} height @param {Corners} corners */
export function drawPicture(pen, image, width, height, [nw, ne, sw]) {
  const [x, y] = toPixels(nw);
  pen.save();
  pen.imageSmoothingEnabled = true;
  pen.transform((X(ne[0]) - x) / width, (Y(ne[1]) - y) / width, (X(sw[0]) - x) / height, (Y(sw[1]) - y) / height, x, y);
  pen.drawImage(image, 0, 0, width + 0.5, height + 0.5); // a little over the seam to the next tile
  pen.restore();
}

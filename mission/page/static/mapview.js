// Where the map looks: metres to pixels and back. Zoom 1 shows the whole field; a robot may be followed.
const MOST_ZOOM = 400;
const LEAST_ZOOM = 0.2;
const PAD = { left: 44, right: 18, top: 54, bottom: 50 }; // axis labels, and the switch for the layers

const camera = { zoom: 1, east: null, north: null, following: "", version: 0 };
let view = null;

export const looking = {
  get version() { return camera.version; },
  get following() { return camera.following; },
  get isWhole() { return camera.zoom === 1 && camera.east === null && !camera.following; },
};

export const X = (east) => view.x + (east - view.east) * view.scale;
export const Y = (north) => view.y - (north - view.north) * view.scale;
export const toPixels = ([east, north]) => [X(east), Y(north)];
export const toMetres = ([x, y]) => [view.east + (x - view.x) / view.scale, view.north - (y - view.y) / view.scale];

// The view for a canvas of so many pixels; `robots` are those of the frame shown.
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
  return view;
}

export function panBy(dx, dy) {
  if (!view) return;
  camera.following = "";
  camera.east = view.east - dx / view.scale;
  camera.north = view.north + dy / view.scale;
  Object.assign(view, { east: camera.east, north: camera.north });
  camera.version += 1;
}

// What lies under the pixel stays under it.
export function zoomAt([x, y], factor) {
  if (!view) return;
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

export function zoomBy(factor) { if (view) zoomAt([view.x, view.y], factor); }

export function showWhole() {
  Object.assign(camera, { zoom: 1, east: null, north: null, following: "" });
  camera.version += 1;
}

export function lookAt(east, north) {
  Object.assign(camera, { east, north, following: "" });
  camera.version += 1;
}

export function follow(name) {
  camera.following = camera.following === name ? "" : name;
  if (camera.following && camera.zoom < 2) camera.zoom = 2;
  camera.version += 1;
}

// A picture of the ground, placed by three of its corners: one affine map.
export function drawPicture(pen, image, width, height, [nw, ne, sw]) {
  const [x, y] = toPixels(nw);
  pen.save();
  pen.imageSmoothingEnabled = true;
  pen.transform((X(ne[0]) - x) / width, (Y(ne[1]) - y) / width, (X(sw[0]) - x) / height, (Y(sw[1]) - y) / height, x, y);
  pen.drawImage(image, 0, 0, width + 0.5, height + 0.5); // a little over the seam to the next tile
  pen.restore();
}

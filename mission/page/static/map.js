// @ts-check
// The field in metres, north up: belief or what was searched, tracks, plans, sources with their 90 % region, robots.
import { $, find, fitCanvas, FONT, penOf } from "./dom.js";
import { colourOf, isOld, model, placeOf, shownFrame, shownGrid } from "./model.js";
import { drawPicture, frameView, looking, rounded, toMetres, toPixels, view, X, Y } from "./mapview.js";
import { setUpGestures } from "./gestures.js";
import { grouped, Places } from "./labels.js";
import { measure, said } from "./measure.js";
import { sureness } from "./words.js";

/** @import { FieldShape, Frame, MarkedPlace, Robot, Source } from "./protocol" */
/** @import { Pixel, Place } from "./mapview.js" */
/** @import { Cells } from "./model.js" */
/** @import { Group } from "./labels.js" */

const canvas = $("map", HTMLCanvasElement);
const pen = penOf(canvas);
/** @type {Record<string, { grid: Cells, image: HTMLCanvasElement }>} */
const images = {};
/** @type {Place[]} */
let corners = []; // of an area being drawn, in metres
/** @type {Place | null} */
let pointer = null;

/** @type {{ at: Place | null }} */
export const pin = { at: null }; // what the operator has asked about

export const area = {
  get corners() { return corners; },
  drawing: false,
  begin() { this.drawing = true; corners = []; },
  end() { this.drawing = false; const drawn = corners; corners = []; return drawn; },
};

// Perceptually even ramps from clear to bright; drawn over the map's ground.
/** @type {Record<Cells["name"], number[][]>} */
const RAMPS = {
  belief: [[68, 30, 120, 0], [88, 48, 160, 150], [170, 60, 130, 215], [240, 110, 70, 235], [253, 200, 60, 245], [255, 250, 190, 255]],
  exposure: [[40, 120, 150, 0], [40, 120, 150, 60], [50, 150, 165, 110], [80, 185, 175, 150]],
};

/** @param {number[][]} stops */
function ramp(stops) {
  const table = new Uint8ClampedArray(256 * 4);
  for (let i = 0; i < 256; i += 1) {
    const at = (i / 255) * (stops.length - 1);
    const low = Math.min(stops.length - 2, Math.floor(at));
    for (let k = 0; k < 4; k += 1) {
      table[4 * i + k] = stops[low][k] + (at - low) * (stops[low + 1][k] - stops[low][k]);
    }
  }
  return table;
}
const TABLES = { belief: ramp(RAMPS.belief), exposure: ramp(RAMPS.exposure) };

/** @param {Cells} grid */
function imageOf(grid) {
  const known = images[grid.name];
  if (known && known.grid === grid) return known.image;
  const image = known?.image ?? document.createElement("canvas");
  image.width = grid.n_east;
  image.height = grid.n_north;
  const data = new ImageData(grid.n_east, grid.n_north);
  const table = TABLES[grid.name];
  for (let row = 0; row < grid.n_north; row += 1) {
    for (let column = 0; column < grid.n_east; column += 1) {
      const cell = grid.cells[row * grid.n_east + column];
      const to = 4 * ((grid.n_north - 1 - row) * grid.n_east + column); // row 0 is south, a picture's is its top
      data.data.set(table.subarray(4 * cell, 4 * cell + 4), to);
    }
  }
  penOf(image).putImageData(data, 0, 0);
  images[grid.name] = { grid, image };
  return image;
}

// The colours of the page's style.
function coloursNow() {
  const style = getComputedStyle(document.documentElement);
  /** @param {string} name */
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return {
    line: of("line"), text: of("text"), dim: of("dim"), bad: of("bad"), accent: of("accent"), map: of("map"),
    found: of("found"), candidate: of("candidate"), inconsistent: of("inconsistent"),
  };
}
let css = coloursNow();
/** @param {Source["state"]} state */
const inkOf = (state) => (state === "found" || state === "candidate" ? css[state] : css.inconsistent);
matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => { css = coloursNow(); });

/** @param {Place[]} points @param {boolean} close */
function path(points, close = false) {
  pen.beginPath();
  points.forEach(([east, north], index) => (index ? pen.lineTo(X(east), Y(north)) : pen.moveTo(X(east), Y(north))));
  if (close) pen.closePath();
}

// What is drawn twice: wide in the ground's colour, then in its own, so that it is seen on anything.
/** @type {(colour: string, under: number, over: number) => [colour: string, width: number][]} */
const outlined = (colour, under, over) => [[css.map, under], [colour, over]];

/** @param {string} text @param {number} x @param {number} y @param {string} colour @param {string} font */
function halo(text, x, y, colour, font = `600 12px ${FONT}`) {
  pen.font = font;
  pen.lineWidth = 3;
  pen.strokeStyle = css.map;
  pen.lineJoin = "round";
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

// Pictures of the ground, each by three of its corners.
/** @type {Map<string, HTMLImageElement>} */
const pictures = new Map();
function drawBackground() {
  for (const { url, corners_m } of model.hello?.background?.pictures ?? []) {
    let image = pictures.get(url);
    if (!image) {
      image = new Image();
      image.onload = () => { model.version.grids += 1; };
      image.src = url;
      pictures.set(url, image);
    }
    if (image.complete && image.naturalWidth) drawPicture(pen, image, image.naturalWidth, image.naturalHeight, corners_m);
  }
}

/** @param {FieldShape} field */
function drawAxes(field) { // Lines over the field; their numbers stay in sight.
  const step = STEPS_M.find((s) => s * view.scale >= 62) ?? COARSEST_M;
  const [west, north] = toMetres([0, 0]);
  const [east, south] = toMetres([view.width, view.height]);
  /** @param {number} low @param {number} high @param {number} most */
  const marks = (low, high, most) => {
    const from = Math.max(0, Math.ceil(low / step));
    const to = Math.floor(Math.min(most, high) / step + 1e-9);
    return Array.from({ length: Math.max(0, to - from + 1) }, (_, k) => (from + k) * step);
  };
  const [easts, norths] = [marks(west, east, field.east_m), marks(south, north, field.north_m)];
  /** @param {number} value @param {number} least @param {number} most */
  const inside = (value, least, most) => Math.min(most, Math.max(least, value));
  pen.lineWidth = 1;
  pen.strokeStyle = css.line;
  pen.fillStyle = css.dim;
  pen.font = `11px ${FONT}`;
  pen.globalAlpha = 0.55;
  pen.beginPath();
  for (const e of easts) { pen.moveTo(X(e), Y(0)); pen.lineTo(X(e), Y(field.north_m)); }
  for (const n of norths) { pen.moveTo(X(0), Y(n)); pen.lineTo(X(field.east_m), Y(n)); }
  pen.stroke();
  pen.globalAlpha = 1;
  pen.textAlign = "center";
  pen.textBaseline = "top";
  for (const e of easts) pen.fillText(`${+e.toFixed(1)}`, X(e), inside(Y(0) + 6, 56, view.height - 40));
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const n of norths) pen.fillText(`${+n.toFixed(1)}${n === 0 ? " m" : ""}`, inside(X(0) - 6, 30, view.width - 20), Y(n));
}

/** @param {FieldShape} field @param {string} layer */
function drawGround(field, layer) {
  pen.clearRect(0, 0, view.width, view.height);
  drawBackground();
  const grid = shownGrid(layer);
  if (grid) {
    pen.imageSmoothingEnabled = layer === "exposure";
    const east = grid.n_east * grid.cell_m;
    const north = grid.n_north * grid.cell_m;
    pen.save();
    path([[0, 0], [field.east_m, 0], [field.east_m, field.north_m], [0, field.north_m]], true);
    pen.clip();
    pen.drawImage(imageOf(grid), X(0), Y(north), east * view.scale, north * view.scale);
    pen.restore();
  }
  drawAxes(field);
  path(field.fence_m, true);
  pen.strokeStyle = css.dim;
  pen.lineWidth = 1.5;
  pen.stroke();
}

/** @param {Place[][]} areas */
function drawAreas(areas) {
  for (const polygon of areas) {
    path(polygon, true);
    pen.save();
    pen.clip();
    pen.strokeStyle = css.bad;
    pen.globalAlpha = 0.5;
    pen.lineWidth = 1;
    pen.beginPath();
    for (let x = -view.height; x < view.width; x += 9) { pen.moveTo(x, view.height); pen.lineTo(x + view.height, 0); }
    pen.stroke();
    pen.restore();
    path(polygon, true);
    pen.strokeStyle = css.bad;
    pen.lineWidth = 1.5;
    pen.stroke();
  }
}

/** @param {Frame} frame */
function drawTracks(frame) {
  for (const robot of frame.robots) {
    const here = placeOf(robot);
    const track = (model.tracks[robot.name] ?? []).filter((point) => point[0] <= frame.t_s);
    const colour = colourOf(robot.name);
    pen.strokeStyle = colour;
    pen.lineJoin = "round";
    if (track.length > 1) {
      const recent = track.length - Math.min(track.length, 60);
      pen.globalAlpha = 0.22; pen.lineWidth = 1.5;
      path(track.slice(0, recent + 1).map((p) => [p[1], p[2]])); pen.stroke();
      pen.globalAlpha = 0.85; pen.lineWidth = 2;
      path(track.slice(recent).map((p) => [p[1], p[2]])); pen.stroke();
    }
    if (robot.path_m.length && here) {
      pen.globalAlpha = 0.8; pen.lineWidth = 1.5; pen.setLineDash([2, 5]);
      path([here, ...robot.path_m]); pen.stroke();
      pen.setLineDash([]);
      const [east, north] = robot.path_m[robot.path_m.length - 1];
      pen.globalAlpha = 1;
      pen.beginPath(); pen.arc(X(east), Y(north), 3, 0, 7); pen.stroke();
    }
    pen.globalAlpha = 1;
  }
}

/** @param {Source} source @param {string} colour */
function drawRegion(source, colour) { // Its 90 % region.
  const [a, b] = source.half_axes_m;
  if (a === null || b === null || source.state === "removed") return;
  pen.beginPath();
  pen.ellipse(X(source.east_m), Y(source.north_m), Math.max(2, a * view.scale), Math.max(2, b * view.scale), (-source.turn_deg * Math.PI) / 180, 0, 7);
  pen.strokeStyle = colour;
  pen.lineWidth = source.state === "found" ? 2 : 1.5;
  if (source.state !== "found") pen.setLineDash([5, 4]);
  pen.stroke();
  pen.setLineDash([]);
  pen.globalAlpha = 0.12 * Math.min(1, 0.1 + 3 * source.p); pen.fillStyle = colour; pen.fill(); pen.globalAlpha = 1;
}

/** @type {Partial<Record<Source["state"], string>>} */
const SHORT = { removed: "removed", inconsistent: "?", outside: "outside" };
/** @param {Group} group */
function wordsOf({ source, also }) {
  const sure = source.state === "found" ? sureness(source).replace(", 90 % sure", "") : `${Math.round(100 * source.p)} %`;
  return `${source.ident}  ${SHORT[source.state] ?? sure}${also.length ? `  (+${also.length} near)` : ""}`;
}

const NEAR_PX = 16;
/** @param {Frame} frame @param {Places} places */
function drawSources(frame, places) {
  const groups = grouped(frame.sources, toPixels, NEAR_PX);
  for (const { source } of groups) drawRegion(source, inkOf(source.state));
  for (const { source, x, y } of groups) {
    const removed = source.state === "removed";
    pen.strokeStyle = css.map; pen.lineWidth = 5; cross(x, y, removed); pen.stroke();
    pen.strokeStyle = inkOf(source.state); pen.lineWidth = 2.5; cross(x, y, removed); pen.stroke();
    places.block(x, y, 8);
  }
  pen.textAlign = "left"; pen.textBaseline = "top";
  pen.font = `700 12px ${FONT}`;
  for (const group of groups) { // what is found has the first choice of where its words go
    const text = wordsOf(group);
    const { left, top, free } = places.place(group.x, group.y, pen.measureText(text).width, 14);
    if (free || group.source.state !== "candidate") halo(text, left, top, inkOf(group.source.state), `700 12px ${FONT}`);
  }
}
/** @param {number} x @param {number} y @param {boolean} turned */
function cross(x, y, turned) {
  pen.beginPath();
  if (turned) { pen.moveTo(x - 6, y - 6); pen.lineTo(x + 6, y + 6); pen.moveTo(x + 6, y - 6); pen.lineTo(x - 6, y + 6); return; }
  pen.moveTo(x - 8, y); pen.lineTo(x + 8, y); pen.moveTo(x, y - 8); pen.lineTo(x, y + 8);
}

/** @param {MarkedPlace[]} marks */
function drawMarks(marks) { // A person's word: a flag.
  for (const mark of marks) {
    const [x, y] = [X(mark.east_m), Y(mark.north_m)];
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(x, y - 20); pen.lineTo(x + 13, y - 15); pen.lineTo(x, y - 10);
    pen.strokeStyle = css.map; pen.lineWidth = 5; pen.stroke();
    pen.strokeStyle = css.text; pen.lineWidth = 2; pen.stroke();
    pen.textAlign = "left"; pen.textBaseline = "bottom";
    halo(`${mark.by}: here`, x + 6, y - 18, css.text);
  }
}

/** @param {Frame} frame */
function drawHearing(frame) { // A ring runs out from each robot that has just heard something.
  const now = performance.now();
  const places = new Map(frame.robots.map((robot) => [robot.name, placeOf(robot)]));
  for (const heard of model.detections.slice(-8)) {
    const age = heard.seenAt ? (now - heard.seenAt) / 1400 : 1;
    if (age >= 1) continue;
    for (const name of Object.keys(heard.heard_dbm)) {
      const place = places.get(name);
      if (!place) continue;
      pen.beginPath();
      pen.arc(...toPixels(place), 9 + 26 * age, 0, 7);
      pen.globalAlpha = 1 - age; pen.lineWidth = 2.5; pen.strokeStyle = css.text; pen.stroke(); pen.globalAlpha = 1;
    }
  }
}

/** @param {Robot} robot */
const isLost = (robot) => !robot.link_up || isOld(robot);

/** @param {Frame} frame @param {Places} places */
function drawRobots(frame, places) {
  for (const robot of frame.robots) {
    const here = placeOf(robot);
    if (!here) continue;
    const [x, y] = toPixels(here);
    places.block(x, y, 11);
    const lost = isLost(robot);
    pen.save();
    pen.translate(x, y);
    if (robot.call || lost) {
      pen.beginPath(); pen.arc(0, 0, 15, 0, 7); pen.strokeStyle = css.bad; pen.lineWidth = 2.5; pen.stroke();
    }
    pen.rotate(((robot.heading_deg ?? 0) * Math.PI) / 180);
    pen.beginPath(); pen.moveTo(0, -11); pen.lineTo(8, 8); pen.lineTo(0, 4); pen.lineTo(-8, 8); pen.closePath();
    pen.fillStyle = colourOf(robot.name); pen.globalAlpha = lost ? 0.45 : 1; pen.fill();
    pen.strokeStyle = css.map; pen.lineWidth = 1.5; pen.stroke();
    pen.restore();
  }
  pen.textAlign = "left"; pen.textBaseline = "top";
  pen.font = `600 12px ${FONT}`;
  for (const robot of frame.robots) {
    const here = placeOf(robot);
    if (!here) continue;
    const bad = robot.call || isLost(robot);
    const name = shortName(robot.name);
    const { left, top } = places.place(...toPixels(here), pen.measureText(name).width, 14, 10);
    halo(name, left, top, bad ? css.bad : css.text);
  }
}
/** @param {string} name */
const shortName = (name) => (name.length > 16 ? `${name.slice(0, 15)}…` : name);

const STEPS_M = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000];
const COARSEST_M = 20000;

/** @param {number} pixelsPerMetre */
export function scaleOf(pixelsPerMetre) { // the longest round length that fits beside the map's corner
  return STEPS_M.filter((length) => length * pixelsPerMetre <= 130).at(-1) ?? STEPS_M[0];
}

function drawNorthAndScale() {
  const length = scaleOf(view.scale);
  const right = view.width - 16;
  const [left, y] = [right - length * view.scale, view.height - 6];
  for (const [colour, width] of outlined(css.text, 6, 2)) {
    pen.strokeStyle = colour; pen.lineWidth = width;
    pen.beginPath();
    pen.moveTo(left, y - 5); pen.lineTo(left, y); pen.lineTo(right, y); pen.lineTo(right, y - 5);
    pen.stroke();
  }
  pen.textAlign = "right"; pen.textBaseline = "bottom";
  halo(length >= 1000 ? `${length / 1000} km` : `${length} m`, left - 6, y + 3, css.text);
  const [x, top] = [view.width - 24, view.height - 108];
  pen.beginPath(); pen.moveTo(x, top); pen.lineTo(x + 8, top + 24); pen.lineTo(x, top + 18); pen.lineTo(x - 8, top + 24); pen.closePath();
  pen.strokeStyle = css.map; pen.lineWidth = 4; pen.stroke();
  pen.fillStyle = css.text; pen.fill();
  pen.textAlign = "center";
  halo("N", x, top - 1, css.text, `700 13px ${FONT}`);
}

function drawPin() {
  if (!pin.at) return;
  const [x, y] = [X(pin.at[0]), Y(pin.at[1])];
  for (const [colour, width] of outlined(css.accent, 5, 2)) {
    pen.strokeStyle = colour; pen.lineWidth = width;
    pen.beginPath(); pen.arc(x, y, 7, 0, 7); pen.moveTo(x - 12, y); pen.lineTo(x - 3, y); pen.moveTo(x + 3, y); pen.lineTo(x + 12, y);
    pen.moveTo(x, y - 12); pen.lineTo(x, y - 3); pen.moveTo(x, y + 3); pen.lineTo(x, y + 12);
    pen.stroke();
  }
}

function drawArea() {
  if (!area.drawing) return;
  const points = pointer ? [...corners, pointer] : corners;
  if (!points.length) return;
  path(points, points.length > 2);
  pen.fillStyle = css.bad; pen.globalAlpha = 0.18; pen.fill(); pen.globalAlpha = 1;
  pen.strokeStyle = css.bad; pen.lineWidth = 2; pen.stroke();
  for (const [east, north] of corners) { pen.beginPath(); pen.arc(X(east), Y(north), 4, 0, 7); pen.fillStyle = css.bad; pen.fill(); }
}

function drawMeasure() {
  const points = measure.points.length === 1 && pointer ? [...measure.points, pointer] : measure.points;
  if (!points.length) return;
  for (const [colour, width] of outlined(css.accent, 6, 2.5)) { path(points); pen.strokeStyle = colour; pen.lineWidth = width; pen.stroke(); }
  for (const [east, north] of points) { pen.beginPath(); pen.arc(X(east), Y(north), 4, 0, 7); pen.fillStyle = css.accent; pen.fill(); }
  if (points.length < 2) return;
  pen.textAlign = "center"; pen.textBaseline = "bottom";
  const [from, to] = points;
  const [[x, y], [x2, y2]] = [toPixels(from), toPixels(to)];
  halo(said(from, to), (x + x2) / 2, (y + y2) / 2 - 8, css.text, `700 13px ${FONT}`);
}

/** @param {string} id @param {string} text */
function write(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }

export function draw() {
  if (!model.hello || canvas.clientWidth === 0) return;
  fitCanvas(canvas, pen);
  const frame = shownFrame();
  frameView(canvas.clientWidth, canvas.clientHeight, model.hello.field, frame?.robots ?? []);
  const layer = find(document, "#layers input:checked", HTMLInputElement).value;
  drawGround(model.hello.field, layer);
  if (frame) {
    const places = new Places(view.width, view.height);
    drawAreas(frame.areas_m);
    drawTracks(frame);
    drawSources(frame, places);
    drawMarks(frame.marks);
    if (frame === model.frame) drawHearing(frame);
    drawRobots(frame, places);
  }
  drawPin();
  drawArea();
  drawMeasure();
  drawNorthAndScale();
  const grid = shownGrid(layer);
  write("credit", model.hello.background?.credit ?? "");
  write("legend", !grid ? "" : layer === "belief"
    ? `source in a cell: up to ${+(100 * grid.largest).toPrecision(2)} %`
    : "a source there would have been heard");
}

const HIT_PX = 16;
/** @typedef {{ place: Place, source?: Source, robot?: Robot }} Thing */
/** @param {Pixel} pixel */
function hit([x, y]) { // The source or robot under a finger, the nearest first.
  const frame = shownFrame();
  if (!frame) return null;
  /** @type {Thing[]} */
  const things = frame.sources.map((source) => ({ source, place: [source.east_m, source.north_m] }));
  for (const robot of frame.robots) {
    const place = placeOf(robot);
    if (place) things.push({ robot, place });
  }
  /** @param {Thing} thing */
  const far = (thing) => Math.hypot(X(thing.place[0]) - x, Y(thing.place[1]) - y);
  const nearest = things.sort((a, b) => far(a) - far(b))[0];
  return nearest && far(nearest) <= HIT_PX ? nearest : null;
}

/** @type {{ onPlace: (...place: Place) => void, onSource: (source: Source) => void, onRobot: (robot: Robot) => void }} */
export const taps = { onPlace() {}, onSource() {}, onRobot() {} }; // what others do about them
setUpGestures(canvas, {
  onTap(pixel) {
    if (!model.hello || !view.scale) return; // before it is first drawn a tap is nowhere
    const place = rounded(toMetres(pixel));
    if (area.drawing) { corners.push(place); return; }
    if (measure.on) { measure.take(place); model.version.grids += 1; return; }
    const thing = hit(pixel);
    if (thing?.source) taps.onSource(thing.source);
    else if (thing?.robot) taps.onRobot(thing.robot);
    else taps.onPlace(...place);
  },
  onMove(pixel) {
    pointer = pixel && model.hello && view.scale && (area.drawing || measure.on) ? toMetres(pixel) : null;
    if (measure.points.length === 1) model.version.grids += 1;
  },
});
export const lookedAt = () => `${looking.version} ${measure.on}`; // the map changes with it

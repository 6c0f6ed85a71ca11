// @ts-check
// The field that is being planned: its border, fence and closed areas, drawn by taps and moved by their corners.
import { $, fitCanvas, FONT, penOf } from "./dom.js";
import { drawPicture, frameView, rounded, showWhole, toMetres, view, X, Y, zoomBy } from "./mapview.js";
import { setUpGestures } from "./gestures.js";
/** @import { Corners, Pixel, Place } from "./mapview.js" */
/** @import { Standing } from "./protocol" */
/** @typedef {{ east_m: number | null, north_m: number | null, fence: Place[] | null, keep_out: Place[][], standing: Standing[] }} Shape */
/** @typedef {{ image: ImageBitmap, corners_m: Corners }} Drawn a picture that has come */
/** @typedef {"fence" | "keep_out"} Kind of what is drawn */

const canvas = $("map", HTMLCanvasElement);
const pen = penOf(canvas);
const GRAB_PX = 16;
/** @type {{ kind: Kind | "", corners: Place[] }} */
export const drawing = { kind: "", corners: [] };
/** @type {Place | null} */
let pointer = null;
/** @type {Shape} */
let shape = { east_m: 25, north_m: 25, fence: null, keep_out: [], standing: [] };
/** @type {Drawn[]} */
let ground = []; // pictures under it
let onMoved = () => {};

/** @param {string} name */
const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** @param {Place[]} points @param {boolean} close */
function path(points, close) {
  pen.beginPath();
  points.forEach(([east, north], index) => (index ? pen.lineTo(X(east), Y(north)) : pen.moveTo(X(east), Y(north))));
  if (close) pen.closePath();
}

/** @param {Place[]} points @param {string} colour */
function polygon(points, colour) {
  path(points, points.length > 2);
  pen.strokeStyle = colour; pen.lineWidth = 2; pen.stroke();
  pen.fillStyle = colour; pen.globalAlpha = 0.14; pen.fill(); pen.globalAlpha = 1;
  for (const [east, north] of points) { pen.beginPath(); pen.arc(X(east), Y(north), 5, 0, 7); pen.fill(); }
}

/** @param {string} text @param {number} x @param {number} y */
function write(text, x, y) {
  pen.strokeStyle = ink("panel"); pen.lineWidth = 3; pen.lineJoin = "round"; pen.strokeText(text, x, y);
  pen.fillText(text, x, y);
}

/** Vehicles that were heard. */
function drawStanding() {
  pen.textAlign = "left"; pen.textBaseline = "middle"; pen.font = `12px ${FONT}`;
  for (const { name, place: [east, north] } of shape.standing) {
    const [x, y] = [X(east), Y(north)];
    pen.beginPath(); pen.moveTo(x, y - 7); pen.lineTo(x + 7, y); pen.lineTo(x, y + 7); pen.lineTo(x - 7, y); pen.closePath();
    pen.fillStyle = ink("text"); pen.fill();
    pen.strokeStyle = ink("panel"); pen.lineWidth = 2; pen.stroke();
    write(name, x + 11, y);
  }
}

export function draw() {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const { east_m, north_m } = shape;
  if (!width || !east_m || !north_m || !(east_m > 0) || !(north_m > 0)) return;
  fitCanvas(canvas, pen);
  frameView(width, height, { east_m, north_m }, []);
  pen.clearRect(0, 0, width, height);
  /** @type {Place[]} */
  const border = [[0, 0], [east_m, 0], [east_m, north_m], [0, north_m]];
  path(border, true);
  pen.fillStyle = ink("panel"); pen.fill();
  for (const { image, corners_m } of ground) drawPicture(pen, image, image.width, image.height, corners_m);
  path(border, true);
  pen.strokeStyle = ink("panel"); pen.lineWidth = 4; pen.stroke(); // also seen over a picture
  pen.strokeStyle = ink("text"); pen.lineWidth = 1.5; pen.stroke();
  pen.fillStyle = ink("text"); pen.font = `12px ${FONT}`; pen.textAlign = "center"; pen.textBaseline = "top";
  write(`${east_m} m`, X(east_m / 2), Y(0) + 8);
  pen.textAlign = "right"; pen.textBaseline = "middle";
  write(`${north_m} m`, X(0) - 8, Y(north_m / 2));
  if (shape.fence) polygon(shape.fence, ink("accent"));
  for (const area of shape.keep_out) polygon(area, ink("bad"));
  drawStanding();
  if (drawing.kind) {
    const points = pointer ? [...drawing.corners, pointer] : drawing.corners;
    polygon(points, ink(drawing.kind === "fence" ? "accent" : "bad"));
  }
}

/** @param {Drawn[]} pictures @param {string} credit */
export function showGround(pictures, credit) {
  ground = pictures;
  $("credit").textContent = credit;
  draw();
}

/** @param {Shape} given */
export function showShape(given) { shape = given; draw(); }

/** @param {() => void} moved */
export function setUpMap(moved) {
  onMoved = moved;
  /** @type {{ points: Place[], index: number } | null} */
  let held = null;
  const polygons = () => [...(shape.fence ? [shape.fence] : []), ...shape.keep_out];
  /** @param {Pixel} pixel */
  const cornerAt = ([x, y]) => {
    for (const points of polygons()) {
      const index = points.findIndex(([east, north]) => Math.hypot(X(east) - x, Y(north) - y) < GRAB_PX);
      if (index >= 0) return { points, index };
    }
    return null;
  };
  // A corner under the pointer is taken along; everything else moves the map.
  canvas.addEventListener("pointerdown", (event) => {
    const box = canvas.getBoundingClientRect();
    held = drawing.kind ? null : cornerAt([event.clientX - box.left, event.clientY - box.top]);
    if (held) { event.stopImmediatePropagation(); canvas.setPointerCapture(event.pointerId); }
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    event.stopImmediatePropagation();
    const box = canvas.getBoundingClientRect();
    held.points[held.index] = rounded(toMetres([event.clientX - box.left, event.clientY - box.top]));
    draw();
  });
  canvas.addEventListener("pointerup", (event) => {
    if (!held) return;
    event.stopImmediatePropagation();
    held = null;
    onMoved();
  });
  setUpGestures(canvas, {
    onTap(pixel) { if (drawing.kind && view.scale) { drawing.corners.push(rounded(toMetres(pixel))); draw(); } },
    onMove(pixel) { pointer = pixel && drawing.kind && view.scale ? toMetres(pixel) : null; if (drawing.kind) draw(); },
    onView: draw,
  });
  $("zoom-in").addEventListener("click", () => { zoomBy(1.6); draw(); });
  $("zoom-out").addEventListener("click", () => { zoomBy(1 / 1.6); draw(); });
  $("zoom-whole").addEventListener("click", () => { showWhole(); draw(); });
  document.fonts.ready.then(draw);
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", draw);
}

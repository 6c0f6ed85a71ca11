// The field that is being planned: its border, fence and closed areas, drawn by taps and moved by their corners.
import { drawPicture, frameView, showWhole, toMetres, X, Y, zoomBy } from "./mapview.js";
import { setUpGestures } from "./gestures.js";

const canvas = document.getElementById("map");
const pen = canvas.getContext("2d");
const GRAB_PX = 16;
export const drawing = { kind: "", corners: [] };
let pointer = null;
let shape = { east_m: 25, north_m: 25, fence: null, keep_out: [] };
let ground = { pictures: [], credit: "" };
let onMoved = () => {};

const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

function path(points, close) {
  pen.beginPath();
  points.forEach(([east, north], index) => (index ? pen.lineTo(X(east), Y(north)) : pen.moveTo(X(east), Y(north))));
  if (close) pen.closePath();
}

function polygon(points, colour, { close = true, dots = true } = {}) {
  path(points, close && points.length > 2);
  pen.strokeStyle = colour; pen.lineWidth = 2; pen.stroke();
  pen.fillStyle = colour; pen.globalAlpha = 0.14; pen.fill(); pen.globalAlpha = 1;
  if (dots) for (const [east, north] of points) { pen.beginPath(); pen.arc(X(east), Y(north), 5, 0, 7); pen.fill(); }
}

function write(text, x, y) {
  pen.strokeStyle = ink("panel"); pen.lineWidth = 3; pen.lineJoin = "round"; pen.strokeText(text, x, y);
  pen.fillText(text, x, y);
}

export function draw() {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width || !(shape.east_m > 0) || !(shape.north_m > 0)) return;
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  frameView(width, height, shape, []);
  pen.clearRect(0, 0, width, height);
  const border = [[0, 0], [shape.east_m, 0], [shape.east_m, shape.north_m], [0, shape.north_m]];
  path(border, true);
  pen.fillStyle = ink("panel"); pen.fill();
  for (const { image, corners_m } of ground.pictures) drawPicture(pen, image, image.width, image.height, corners_m);
  path(border, true);
  pen.strokeStyle = ink("panel"); pen.lineWidth = 4; pen.stroke(); // also seen over a picture
  pen.strokeStyle = ink("text"); pen.lineWidth = 1.5; pen.stroke();
  pen.fillStyle = ink("text"); pen.font = "12px system-ui"; pen.textAlign = "center"; pen.textBaseline = "top";
  write(`${shape.east_m} m`, X(shape.east_m / 2), Y(0) + 8);
  pen.textAlign = "right"; pen.textBaseline = "middle";
  write(`${shape.north_m} m`, X(0) - 8, Y(shape.north_m / 2));
  if (shape.fence) polygon(shape.fence, ink("accent"));
  for (const area of shape.keep_out) polygon(area, ink("bad"));
  if (drawing.kind) {
    const points = pointer ? [...drawing.corners, pointer] : drawing.corners;
    polygon(points, ink(drawing.kind === "fence" ? "accent" : "bad"));
  }
}

export function showGround(pictures, credit) {
  ground = { pictures, credit };
  document.getElementById("credit").textContent = credit;
  draw();
}

export function showShape(given) { shape = given; draw(); }

export function setUpMap(moved) {
  onMoved = moved;
  let held = null;
  const polygons = () => [...(shape.fence ? [shape.fence] : []), ...shape.keep_out];
  const cornerAt = ([x, y]) => {
    for (const points of polygons()) {
      const index = points.findIndex(([east, north]) => Math.hypot(X(east) - x, Y(north) - y) < GRAB_PX);
      if (index >= 0) return { points, index };
    }
    return null;
  };
  const rounded = (place) => place.map((value) => +value.toFixed(2));
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
    onTap(pixel) { if (drawing.kind) { drawing.corners.push(rounded(toMetres(pixel))); draw(); } },
    onMove(pixel) { pointer = pixel && drawing.kind ? toMetres(pixel) : null; if (drawing.kind) draw(); },
    onView: draw,
  });
  document.getElementById("zoom-in").addEventListener("click", () => { zoomBy(1.6); draw(); });
  document.getElementById("zoom-out").addEventListener("click", () => { zoomBy(1 / 1.6); draw(); });
  document.getElementById("zoom-whole").addEventListener("click", () => { showWhole(); draw(); });
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", draw);
}

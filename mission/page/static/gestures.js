// @ts-check
// Fingers, mouse and keys on the map: drag, pinch, wheel, and what is a tap.
import { panBy, showWhole, zoomAt, zoomBy } from "./mapview.js";

/** @import { Pixel } from "./mapview.js" */
const TAP_PX = 8;
const STEP_PX = 60;

// `onView` is called when the map has been moved.
/**
 * @param {HTMLCanvasElement} canvas
 * @param {{ onTap: (at: Pixel) => void, onMove: (at: Pixel | null) => void, onView?: () => void }} uses
 */
export function setUpGestures(canvas, { onTap, onMove, onView = () => {} }) {
  /** @type {Map<number, Pixel>} */
  const down = new Map(); // pointers on the map
  let travelled = 0;

  /** @type {(event: MouseEvent) => Pixel} */
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  /** @type {() => { middle: Pixel, apart: number }} */
  const spread = () => {
    const [a, b] = [...down.values()];
    return { middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2], apart: Math.hypot(a[0] - b[0], a[1] - b[1]) };
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    if (!down.size) travelled = 0;
    down.set(event.pointerId, at(event));
    try { canvas.setPointerCapture(event.pointerId); } catch { /* it is up again already */ }
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = at(event);
    const before = down.get(event.pointerId);
    if (!before) { onMove(now); return; }
    const was = down.size === 2 ? spread() : null;
    down.set(event.pointerId, now);
    travelled += Math.hypot(now[0] - before[0], now[1] - before[1]);
    if (was) {
      const is = spread();
      travelled += TAP_PX;
      panBy(is.middle[0] - was.middle[0], is.middle[1] - was.middle[1]);
      if (was.apart > 0) zoomAt(is.middle, is.apart / was.apart);
      onView();
    } else if (travelled > TAP_PX && down.size === 1) {
      panBy(now[0] - before[0], now[1] - before[1]);
      onView();
    }
  });
  canvas.addEventListener("pointerup", (event) => {
    if (!down.delete(event.pointerId)) return;
    if (!down.size && travelled <= TAP_PX) onTap(at(event));
  });
  canvas.addEventListener("pointercancel", (event) => { down.delete(event.pointerId); travelled = TAP_PX + 1; });
  canvas.addEventListener("pointerleave", () => onMove(null));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomAt(at(event), Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)));
    onView();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    /** @type {Record<string, () => void>} */
    const acts = {
      ArrowLeft: () => panBy(STEP_PX, 0), ArrowRight: () => panBy(-STEP_PX, 0), ArrowUp: () => panBy(0, STEP_PX), ArrowDown: () => panBy(0, -STEP_PX),
      "+": () => zoomBy(1.4), "=": () => zoomBy(1.4), "-": () => zoomBy(1 / 1.4), 0: showWhole,
    };
    const act = acts[event.key];
    if (act && !event.ctrlKey && !event.metaKey && !event.altKey) { event.preventDefault(); act(); onView(); }
  });
}

// @ts-check
// Probability over time: that one is still left, and that each source is where the mark is.
import { $, fitCanvas, FONT, penOf } from "./dom.js";
import { model } from "./model.js";
import { clock } from "./panels.js";

/** @typedef {[t_s: number, p: number]} Dot */
const canvas = $("chart", HTMLCanvasElement);
const pen = penOf(canvas);

export function chart() {
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (!width || !model.frame) return;
  fitCanvas(canvas, pen);
  pen.clearRect(0, 0, width, height);
  const style = getComputedStyle(document.documentElement);
  /** @param {string} name */
  const ink = (name) => style.getPropertyValue(`--${name}`).trim();
  const box = { left: 40, right: width - 12, top: 20, bottom: height - 20 };
  const last = Math.max(60, model.frame.t_s);
  /** @param {number} t */
  const x = (t) => box.left + (t / last) * (box.right - box.left);
  /** @param {number} p */
  const y = (p) => box.bottom - p * (box.bottom - box.top);
  pen.font = `11px ${FONT}`; pen.lineWidth = 1; pen.textBaseline = "middle"; pen.textAlign = "right";
  for (const p of [0, 0.5, 1]) {
    pen.strokeStyle = ink("line"); pen.beginPath(); pen.moveTo(box.left, y(p)); pen.lineTo(box.right, y(p)); pen.stroke();
    pen.fillStyle = ink("faint"); pen.fillText(`${100 * p} %`, box.left - 6, y(p));
  }
  pen.textBaseline = "top"; pen.fillText(clock(last), box.right, box.bottom + 5);
  pen.textAlign = "left"; pen.fillText("0:00", box.left, box.bottom + 5);
  pen.textBaseline = "bottom"; pen.fillStyle = ink("dim");
  pen.fillText("one still hidden", box.left + 13, box.top - 4); pen.fillText("each source", box.left + 123, box.top - 4);
  pen.fillStyle = ink("accent"); pen.fillRect(box.left, box.top - 11, 9, 3);
  pen.fillStyle = ink("found"); pen.fillRect(box.left + 110, box.top - 11, 9, 3);
  /** @param {Dot[]} points @param {string} colour @param {number} thick */
  const line = (points, colour, thick) => {
    if (!points.length) return;
    pen.strokeStyle = colour; pen.lineWidth = thick; pen.lineJoin = "round"; pen.beginPath();
    points.forEach(([t, p], index) => (index ? pen.lineTo(x(t), y(p)) : pen.moveTo(x(t), y(p))));
    pen.stroke();
  };
  for (const { ident, state } of model.frame.sources) {
    line(model.series.filter((row) => ident in row.p).map((row) => [row.t_s, row.p[ident]]), ink(state), 1.5);
  }
  /** @type {Dot[]} */
  const left = model.series.map((row) => [row.t_s, row.left]);
  line([...left, [model.frame.t_s, model.frame.left]], ink("accent"), 2.5);
}

// @ts-check
// In place of socket.js inside a report: asks no server, since the whole recording lies in the page.
import { $ } from "./dom.js";
import { model, receive } from "./model.js";
/** @import { Command, History, Question, Recorded, Sent } from "./protocol" */
/** @import { Outcome } from "./socket.js" */

const STEP_MS = 200;
/** @type {Recorded} */
const data = JSON.parse($("recorded").textContent);
/** @type {(message: Sent) => void} */
let told = () => {};
let playing = 0;

/** @param {Sent} message */
function say(message) { receive(message); told(message); }

/** @param {number} t_s */
function seek(t_s) {
  /** @type {<T extends { t_s: number }>(rows: T[]) => T[]} */
  const early = (rows) => rows.filter((row) => row.t_s <= t_s);
  /** @type {History["tracks"]} */
  const tracks = {};
  for (const [name, track] of Object.entries(data.tracks)) tracks[name] = track.filter(([at_s]) => at_s <= t_s);
  say({ kind: "history", tracks, series: early(data.series), detections: early(data.detections), notes: early(data.notes) });
  for (const name of ["belief", "exposure"]) {
    const last = early(data.grids).filter((each) => each.name === name).at(-1);
    if (last) say(last.grid);
  }
  say(early(data.frames).at(-1) ?? data.frames[0]);
}

/** @param {Question} question */
export function ask(question) {
  clearInterval(playing);
  if (question.kind === "seek") seek(question.t_s);
  if (question.kind !== "play") return;
  const { rate } = question;
  const end_s = data.hello.duration_s;
  let t_s = model.frame?.t_s ?? 0;
  if (t_s >= end_s - 1) t_s = 0;
  playing = setInterval(() => {
    t_s = Math.min(t_s + (rate * STEP_MS) / 1000, end_s);
    seek(t_s);
    if (t_s >= end_s) clearInterval(playing);
  }, STEP_MS);
}

/** @param {Command} _order @returns {Promise<Outcome>} */
export function command(_order) { return Promise.resolve({ ok: false, text: "a recording takes no commands" }); }

/** @param {(message: Sent) => void} onMessage @param {() => void} onState */
export function connect(onMessage, onState) {
  told = onMessage;
  model.connected = true;
  say(data.hello);
  onState();
}

// @ts-check
// Time below the map: finds, holds and the operator's acts as marks, and a look back while the mission goes on.
import { model } from "./model.js";
import { ask } from "./socket.js";
import { clock } from "./panels.js";
import { $, element } from "./dom.js";

const back = $("back", HTMLInputElement);
const AT_NOW_S = 2;
let marked = "";

/** @param {string} text */
function kindOf(text) {
  if (text.startsWith("found source")) return "find";
  if (text.startsWith("operator")) return "asked";
  return / holds: | needs the operator|NOTHING IS RECORDED/.test(text) ? "hold" : "";
}

// At most one mark a pixel or so: a night's holds are no thousand elements.
/** @param {HTMLElement} box @param {number} duration_s */
function marks(box, duration_s) {
  const last = model.notes.at(-1);
  const now = `${model.notes.length} ${last?.t_s} ${Math.floor(duration_s / 5)}`;
  if (now === marked || !duration_s) return;
  marked = now;
  const seen = new Set();
  const made = [];
  for (const note of model.notes) {
    const kind = kindOf(note.text);
    const at = Math.round((1000 * note.t_s) / duration_s) / 10;
    if (!kind || at > 100 || seen.has(`${kind} ${at}`)) continue;
    seen.add(`${kind} ${at}`);
    const mark = element("i", { className: kind, title: `${clock(note.t_s)}  ${note.text}` });
    mark.style.left = `${at}%`;
    made.push(mark);
  }
  box.replaceChildren(...made);
}

export function timeline() {
  const { hello, frame, past } = model;
  if (!hello || !frame) return;
  $("timeline").hidden = !hello.live;
  if (!hello.live) { marks($("past-marks"), hello.duration_s); return; }
  const now_s = frame.t_s;
  marks($("marks"), now_s);
  back.max = String(Math.max(1, Math.floor(now_s)));
  if (!past && document.activeElement !== back) back.value = back.max;
  $("now").hidden = !past;
  document.body.classList.toggle("looks-back", past !== null);
  $("back-time").textContent = past ? `map as of ${clock(now_s - past.frame.t_s)} ago` : "now";
}

function backToNow() {
  model.past = null;
  back.value = back.max;
  model.version.side += 1;
}

export function setUpTimeline() {
  back.addEventListener("input", () => {
    const t_s = Number(back.value);
    if (!model.frame || t_s >= model.frame.t_s - AT_NOW_S) backToNow();
    else ask({ kind: "look", t_s });
  });
  $("now").addEventListener("click", backToNow);
}

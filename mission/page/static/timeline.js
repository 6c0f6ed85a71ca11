// Time below the map: finds, holds and the operator's acts as marks, and a look back while the mission goes on.
import { model } from "./model.js";
import { ask } from "./socket.js";
import { clock } from "./panels.js";
import { element } from "./dom.js";

const $ = (id) => document.getElementById(id);
const AT_NOW_S = 2;
let marked = "";

function kindOf(text) {
  if (text.startsWith("found source")) return "find";
  if (text.startsWith("operator")) return "asked";
  return / holds: | needs the operator|NOTHING IS RECORDED/.test(text) ? "hold" : "";
}

// At most one mark a pixel or so: a night's holds are no thousand elements.
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
  const live = model.hello.live;
  $("timeline").hidden = !live;
  if (!live) { marks($("past-marks"), model.hello.duration_s); return; }
  const now_s = model.frame.t_s;
  marks($("marks"), now_s);
  $("back").max = Math.max(1, Math.floor(now_s));
  const looks = model.past !== null;
  if (!looks && document.activeElement !== $("back")) $("back").value = $("back").max;
  $("now").hidden = !looks;
  document.body.classList.toggle("looks-back", looks);
  const ago_s = looks ? now_s - model.past.frame.t_s : 0;
  $("back-time").textContent = looks ? `map as of ${clock(ago_s)} ago` : "now";
}

function backToNow() {
  model.past = null;
  $("back").value = $("back").max;
  model.version.side += 1;
}

export function setUpTimeline() {
  $("back").addEventListener("input", () => {
    const t_s = Number($("back").value);
    if (t_s >= model.frame.t_s - AT_NOW_S) backToNow();
    else ask({ kind: "look", t_s });
  });
  $("now").addEventListener("click", backToNow);
}

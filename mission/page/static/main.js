// @ts-check
// Puts the parts together: messages in, one drawing per screen refresh at most, and the state of the connection.
import { $, buttons, find } from "./dom.js";
import { model } from "./model.js";
import { element } from "./dom.js";
import { connect, ask } from "./socket.js";
import { area, draw, lookedAt, pin } from "./map.js";
import { setUpTools } from "./tools.js";
import { setUpTimeline, timeline } from "./timeline.js";
import { listen, setUpSound } from "./sound.js";
import { chart } from "./chart.js";
import { clock, fill, waiting } from "./panels.js";
import { walk } from "./walk.js";
import { setUpWhere } from "./where.js";
import { notice, setUp, showRights } from "./commands.js";

/** @import { Sent } from "./protocol" */

const slider = $("slider", HTMLInputElement);
const SILENT_MS = 5000;
const STALE_MS = 2000;
const SLACK_MS = 500; // frames come every half second
const RING_MS = 1500;
let filled = -1;
let drawn = { asked: "", side: -1 }; // what the map was drawn for

/** @param {Sent} message */
function onMessage(message) {
  if (message.kind === "hello") {
    $("mission").textContent = message.mission;
    document.title = `${message.mission} · fieldkit`;
    if (!message.live) { slider.max = String(Math.ceil(message.duration_s)); ask({ kind: "seek", t_s: message.duration_s }); }
    showRights();
    if (message.live && !model.frame) waiting(message);
    const files = message.files.map(([word, address]) => element("a", { href: address, download: address, textContent: word }));
    $("files").replaceChildren("Save: ", ...files);
    $("files").hidden = !files.length;
  }
  if (message.kind === "rights") {
    showRights();
    if (message.wrong_token) notice("The token is wrong: you can look, but not command. Open the address that was printed at the start.", true);
  }
  if (message.kind === "frame" && model.hello && !model.hello.live) {
    if (document.activeElement !== slider) slider.value = String(message.t_s);
    $("time").textContent = `${clock(message.t_s)} / ${clock(model.hello.duration_s)}`;
  }
}

function showState() {
  const chip = $("state");
  const live = model.hello?.live;
  const starting = live && !model.frame; // nothing comes before every robot is heard and seen
  const silent = model.connected && live && !starting && performance.now() - model.heardAt > SILENT_MS;
  const ended = model.frame?.end;
  const words = ended && live ? (innerWidth < 1000 ? "ended" : `ended: ${ended}`) : !model.connected ? "not connected" : silent ? "mission silent"
    : starting ? "not started" : live ? (model.mayCommand ? "live" : "live, only looking") : "recording";
  if (chip.textContent !== words) chip.textContent = words;
  chip.title = live && ended ? ended : "";
  chip.className = `chip ${!(ended && live) && (!model.connected || silent) ? "lost" : live && !ended && !starting ? "live" : ""}`;
}

// What is old looks like the present: it is covered by how old it is.
function showStale() {
  const box = $("stale");
  const age_s = (performance.now() - model.heardAt) / 1000;
  const stale = model.hello?.live && model.frame && !model.frame.end && (!model.connected || age_s * 1000 > STALE_MS + SLACK_MS);
  const words = !stale ? "" : `NOT THE PRESENT: nothing from the mission for ${Math.round(age_s)} s. Stop robots by remote control.`;
  if (box.textContent !== words) { box.textContent = words; box.hidden = !words; document.body.classList.toggle("stale", Boolean(words)); }
}

// Words every half second, as frames come, the map three times a second, the chart every 2 s: nobody reads faster, and a
// phone in the field has one battery. The map is drawn at once where a finger moves it.
const EVERY_MS = { words: 500, map: 330, ring: 50, chart: 2000 };
const last = { words: 0, map: 0, ring: 0, chart: 0 };
/** @param {keyof typeof last} what @param {number} now_ms */
function due(what, now_ms) {
  if (now_ms - last[what] < EVERY_MS[what]) return false;
  last[what] = now_ms;
  return true;
}

/** Shows what is new; whether a ring is still spreading. @param {number} now_ms */
function show(now_ms) {
  if (model.version.side !== filled && model.frame && due("words", now_ms)) {
    filled = model.version.side;
    fill(); walk(); timeline(); listen();
    if (due("chart", now_ms)) chart();
  }
  const newest = model.detections.at(-1)?.seenAt ?? -RING_MS;
  const ring = performance.now() - newest < RING_MS && due("ring", now_ms);
  const asked = `${lookedAt()} ${pin.at} ${innerWidth} ${innerHeight} ${layer()} ${model.version.grids} ${area.drawing && now_ms}`;
  const stale = model.version.side !== drawn.side && due("map", now_ms);
  if (asked !== drawn.asked || stale || ring) { drawn = { asked, side: model.version.side }; draw(); }
  return ring;
}

/** @param {number} now_ms */
function refresh(now_ms) {
  let ring = false;
  try {
    ring = show(now_ms);
  } finally { // what fails once must not leave a page that stands still and looks like the present
    coming = false;
    clearTimeout(later);
    later = setTimeout(lookAgain, ring ? EVERY_MS.ring : IDLE_MS);
  }
}

// A browser that is asked for every frame works for each of them, also where nothing has changed: a look each 100 ms is
// enough for news, and who moves something is answered with the next frame.
const IDLE_MS = 100;
let coming = false;
let later = 0;
function lookAgain() {
  if (coming) return;
  coming = true;
  requestAnimationFrame(refresh);
}
for (const act of ["pointermove", "pointerdown", "pointerup", "wheel", "keydown", "input", "click", "resize"]) {
  addEventListener(act, lookAgain, { passive: true, capture: true });
}
const layer = () => find(document, "#layers input:checked", HTMLInputElement).value;

for (const button of buttons("#tabs button")) {
  button.addEventListener("click", () => {
    for (const other of document.querySelectorAll("#tabs button, .tab")) other.classList.remove("on");
    button.classList.add("on");
    $(button.dataset.tab ?? "").classList.add("on");
    filled = -1;
  });
}
$("notice").addEventListener("click", () => notice(""));
setUp();
setUpWhere();
setUpTools();
setUpTimeline();
setUpSound();
connect(onMessage, showState);
setInterval(() => { showState(); showStale(); }, 500);
document.fonts.ready.then(() => { model.version.grids += 1; }); // what the canvas wrote before was in another typeface
lookAgain();
Object.assign(window, { fieldkit: model }); // for a look from the console

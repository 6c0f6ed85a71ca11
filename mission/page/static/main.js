// Puts the parts together: messages in, one drawing per screen refresh at most, and the state of the connection.
import { model } from "./model.js";
import { connect, ask } from "./socket.js";
import { area, draw, lookedAt, pin } from "./map.js";
import { setUpTools } from "./tools.js";
import { setUpTimeline, timeline } from "./timeline.js";
import { listen, setUpSound } from "./sound.js";
import { chart } from "./chart.js";
import { clock, fill } from "./panels.js";
import { walk } from "./walk.js";
import { setUpWhere } from "./where.js";
import { notice, setUp, showRights } from "./commands.js";

const $ = (id) => document.getElementById(id);
const SILENT_MS = 5000;
const STALE_MS = 2000;
const SLACK_MS = 500; // frames come every half second
const RING_MS = 1500;
let filled = -1;
let drawn = "";

function onMessage(message) {
  if (message.kind === "hello") {
    $("mission").textContent = message.mission;
    document.title = `${message.mission} · fieldkit`;
    if (!message.live) { $("slider").max = Math.ceil(message.duration_s); ask({ kind: "seek", t_s: message.duration_s }); }
    showRights();
  }
  if (message.kind === "rights") {
    showRights();
    if (message.wrong_token) notice("The token is wrong: you can look, but not command. Open the address that was printed at the start.", true);
  }
  if (message.kind === "frame" && !model.hello.live) {
    if (document.activeElement !== $("slider")) $("slider").value = message.t_s;
    $("time").textContent = `${clock(message.t_s)} / ${clock(model.hello.duration_s)}`;
  }
}

function showState() {
  const chip = $("state");
  const live = model.hello?.live;
  const silent = model.connected && live && performance.now() - model.heardAt > SILENT_MS;
  const ended = model.frame?.end;
  const words = ended && live ? (innerWidth < 700 ? "ended" : `ended: ${ended}`) : !model.connected ? "not connected" : silent ? "mission silent"
    : live ? (model.mayCommand ? "live" : "live, only looking") : "recording";
  if (chip.textContent !== words) chip.textContent = words;
  chip.className = `chip ${!(ended && live) && (!model.connected || silent) ? "lost" : live && !ended ? "live" : ""}`;
}

// What is old looks like the present: it is covered by how old it is.
function showStale() {
  const box = $("stale");
  const age_s = (performance.now() - model.heardAt) / 1000;
  const stale = model.hello?.live && model.frame && !model.frame.end && (!model.connected || age_s * 1000 > STALE_MS + SLACK_MS);
  const words = !stale ? "" : `NOT THE PRESENT: nothing from the mission for ${Math.round(age_s)} s. Stop robots by remote control.`;
  if (box.textContent !== words) { box.textContent = words; box.hidden = !words; document.body.classList.toggle("stale", Boolean(words)); }
}

function refresh() {
  if (model.version.side !== filled && model.frame) { filled = model.version.side; fill(); chart(); walk(); timeline(); listen(); }
  // Drawn only when there is something new: a phone in the field has one battery.
  const newest = model.detections.at(-1)?.seenAt ?? -RING_MS;
  const moving = area.drawing || performance.now() - newest < RING_MS;
  const now = `${model.version.side} ${model.version.grids} ${innerWidth} ${innerHeight} ${layer()} ${lookedAt()} ${pin.at} ${moving && performance.now()}`;
  if (now !== drawn) { drawn = now; draw(); }
  requestAnimationFrame(refresh);
}
const layer = () => document.querySelector("#layers input:checked").value;

for (const button of document.querySelectorAll("#tabs button")) {
  button.addEventListener("click", () => {
    for (const other of document.querySelectorAll("#tabs button, .tab")) other.classList.remove("on");
    button.classList.add("on");
    $(button.dataset.tab).classList.add("on");
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
requestAnimationFrame(refresh);
window.fieldkit = model; // for a look from the console

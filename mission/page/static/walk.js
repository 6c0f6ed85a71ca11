// For people who carry a radio: where to go next, how strong it is now, and a tone for ears that need no screen.
import { model } from "./model.js";
import { press, notice } from "./commands.js";
import { element } from "./dom.js";
import { heardWhileTurning } from "./turn.js";
import { showWhere } from "./where.js";

const $ = (id) => document.getElementById(id);
const RECENT = 8; // readings that make a trend
const MOST_FINDS = 3; // shown on the panel; all of them are under Sources
const TURNED_DEG = 20; // less than this off is straight on
let me = "";
let heardUpTo = -1;
let peak = null;
let levels = [];
let sound = null;

function people() { return (model.hello?.robots ?? []).filter((robot) => robot.on_foot).map((robot) => robot.name); }

export function isWalk() { return people().length > 0; }

function choose(names) {
  const box = $("walk-who");
  if (box.options.length !== names.length) {
    box.replaceChildren(...names.map((name) => new Option(name, name)));
    box.hidden = names.length < 2;
  }
  if (!names.includes(me)) me = names.includes(sessionStorage.getItem("me")) ? sessionStorage.getItem("me") : names[0];
  box.value = me;
}

// Which way, for somebody who looks where they walk: by the clock, as people say it.
export function turn(bearing_deg, heading_deg) {
  const off = ((bearing_deg - heading_deg + 540) % 360) - 180;
  if (Math.abs(off) < TURNED_DEG) return "straight on";
  if (Math.abs(off) > 180 - TURNED_DEG) return "turn round";
  return `${Math.abs(off) < 60 ? "half " : ""}${off > 0 ? "right" : "left"}`;
}

export function trend(values) {
  if (values.length < 4) return "";
  const half = Math.floor(values.length / 2);
  const mean = (part) => part.reduce((sum, value) => sum + value, 0) / part.length;
  const change = mean(values.slice(-half)) - mean(values.slice(0, half));
  return Math.abs(change) < 1.5 ? "steady" : change > 0 ? "warmer" : "colder";
}

const course = () => model.frame?.robots.find((robot) => robot.name === me)?.heading_deg ?? 0;

function take() {
  for (const heard of model.detections) {
    const dbm = heard.heard_dbm[me];
    if (dbm === undefined || heard.t_s <= heardUpTo) continue;
    heardUpTo = heard.t_s;
    levels.push(dbm);
    if (levels.length > RECENT) levels.shift();
    peak = peak === null ? dbm : Math.max(peak, dbm);
    if (sound && heard.seenAt) tick(dbm);
    if (heard.seenAt) heardWhileTurning(dbm, course());
  }
}

function tick(dbm) { // Higher and longer the stronger it is.
  const strength = Math.min(1, Math.max(0, (dbm + 100) / 60));
  const tone = sound.createOscillator();
  const volume = sound.createGain();
  const now = sound.currentTime;
  tone.frequency.value = 250 + 1500 * strength;
  volume.gain.setValueAtTime(0.25, now);
  volume.gain.exponentialRampToValueAtTime(0.001, now + 0.05 + 0.15 * strength);
  tone.connect(volume).connect(sound.destination);
  tone.start(now);
  tone.stop(now + 0.25);
}

function set(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }

// What has been found, nearest first: where it is from here, and by a tap where that is in other words.
function showFinds(here) {
  const finds = model.frame.sources.filter((source) => source.state === "found").map((source) => {
    const [east, north] = here ? [source.east_m - here.east_m, source.north_m - here.north_m] : [0, 0];
    const off_m = Math.hypot(east, north);
    const way = turn((Math.atan2(east, north) * 180) / Math.PI, here?.heading_deg ?? 0);
    const from = here ? `, ${Math.round(off_m)} m from you, ${way}` : "";
    return { source, off_m, words: `Source ${source.ident} found: ${source.east_m.toFixed(1)} m E, ${source.north_m.toFixed(1)} m N${from}` };
  }).sort((a, b) => a.off_m - b.off_m).slice(0, MOST_FINDS);
  const box = $("walk-found");
  box.hidden = !finds.length;
  while (box.children.length > finds.length) box.lastChild.remove();
  for (const [index, { source, words }] of finds.entries()) {
    const button = box.children[index] ?? box.appendChild(element("button", { title: "Tap: where that is, to copy" }));
    if (button.textContent !== words) button.textContent = words;
    button.onclick = () => showWhere(source.east_m, source.north_m, `Source ${source.ident}`);
  }
}

export function walk() {
  const names = people();
  $("walk").hidden = !names.length;
  if (!names.length || !model.frame) return;
  choose(names);
  take();
  const mine = model.frame.robots.find((robot) => robot.name === me);
  if (!mine) return;
  const goal = mine.target_m;
  const arrow = $("walk-arrow");
  const known = mine.east_m !== null && mine.pose_age_s <= model.hello.pose_timeout_s;
  if (model.frame.end) { set("walk-go", "The walk is over"); set("walk-why", model.frame.end); arrow.style.opacity = 0; }
  else if (!known) { set("walk-go", "No position"); set("walk-why", "go where the sky is free"); arrow.style.opacity = 0; }
  else if (mine.mode !== "guided" || !goal) {
    set("walk-go", "Stay here"); set("walk-why", mine.why || mine.mode); arrow.style.opacity = 0;
  } else {
    const [east, north] = [goal[0] - mine.east_m, goal[1] - mine.north_m];
    const bearing = (Math.atan2(east, north) * 180) / Math.PI;
    arrow.style.opacity = 1;
    arrow.style.transform = `rotate(${bearing - (mine.heading_deg ?? 0)}deg)`;
    set("walk-go", `${Math.round(Math.hypot(east, north))} m, ${turn(bearing, mine.heading_deg ?? 0)}`);
    set("walk-why", mine.doing.startsWith("resolve") ? "to pin down what was heard" : "to listen where nobody has");
  }
  showFinds(known ? mine : null);
  const silent = !mine.radio_up;
  set("walk-now", silent ? "radio down" : levels.length ? `${Math.round(levels.at(-1))} dBm` : "silence");
  set("walk-peak", peak === null ? "–" : `${Math.round(peak)} dBm`);
  const words = silent ? "" : trend(levels);
  set("walk-trend", words || "–");
  $("walk-trend").className = words;
  $("walk-mark").disabled = !model.mayCommand || !known;
  $("walk-mark").hidden = !model.hello.live;
}

$("walk-who").addEventListener("change", () => {
  me = $("walk-who").value;
  sessionStorage.setItem("me", me);
  [heardUpTo, peak, levels] = [-1, null, []];
  walk();
});
$("walk-sound").addEventListener("click", () => {
  sound = sound ? (sound.close(), null) : new AudioContext();
  $("walk-sound").textContent = sound ? "Sound off" : "Sound on";
  $("walk-sound").setAttribute("aria-pressed", String(Boolean(sound)));
});
$("walk-mark").addEventListener("click", () => {
  press($("walk-mark"), "mark", { robot: me }, true);
  if (!$("walk-mark").classList.contains("asking")) notice("Marked: your word, kept apart from what the radios say.");
});

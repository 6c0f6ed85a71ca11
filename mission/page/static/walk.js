// @ts-check
// For people who carry a radio: where to go next, how strong it is now, and a tone for ears that need no screen.
import { isOld, mayChange, model, placeOf } from "./model.js";
import { press, notice } from "./commands.js";
import { $, element, find } from "./dom.js";
import { radioDown } from "./panels.js";
import { heardWhileTurning } from "./turn.js";
import { showWhere } from "./where.js";

/** @import { Place } from "./mapview.js" */

const box = $("walk-who", HTMLSelectElement);
const arrow = $("walk-arrow", SVGElement);
const markButton = $("walk-mark", HTMLButtonElement);
const RECENT = 8; // readings that make a trend
const MOST_FINDS = 3; // shown on the panel; all of them are under Sources
const BACK_S = 5; // so much earlier than what was heard last: time has begun anew
const TURNED_DEG = 20; // less than this off is straight on
let me = "";
let heardUpTo = -1;
/** @type {number | null} */
let peak = null;
/** @type {number[]} */
let levels = [];
/** @type {AudioContext | null} */
let sound = null;

function people() { return (model.hello?.robots ?? []).filter((robot) => robot.on_foot).map((robot) => robot.name); }

export function isWalk() { return people().length > 0; }

/** @param {string[]} names */
function choose(names) {
  if (box.options.length !== names.length) {
    box.replaceChildren(...names.map((name) => new Option(name, name)));
    box.hidden = names.length < 2;
  }
  const before = sessionStorage.getItem("me") ?? "";
  if (!names.includes(me)) me = names.includes(before) ? before : names[0];
  box.value = me;
}

// Which way, for somebody who looks where they walk: by the clock, as people say it.
/** @param {number} bearing_deg @param {number} heading_deg */
export function turn(bearing_deg, heading_deg) {
  const off = ((bearing_deg - heading_deg + 540) % 360) - 180;
  if (Math.abs(off) < TURNED_DEG) return "straight on";
  if (Math.abs(off) > 180 - TURNED_DEG) return "turn round";
  return `${Math.abs(off) < 60 ? "half " : ""}${off > 0 ? "right" : "left"}`;
}

/** @param {number[]} values */
export function trend(values) {
  if (values.length < 4) return "";
  const half = Math.floor(values.length / 2);
  /** @param {number[]} part */
  const mean = (part) => part.reduce((sum, value) => sum + value, 0) / part.length;
  const change = mean(values.slice(-half)) - mean(values.slice(0, half));
  return Math.abs(change) < 1.5 ? "steady" : change > 0 ? "warmer" : "colder";
}

const course = () => model.frame?.robots.find((robot) => robot.name === me)?.heading_deg ?? 0;

function take() {
  if ((model.frame?.t_s ?? 0) < heardUpTo - BACK_S) [heardUpTo, peak, levels] = [-1, null, []]; // another mission
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

/** @param {number} dbm */
function tick(dbm) { // Higher and longer the stronger it is.
  if (!sound) return;
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

/** @param {string} id @param {string} text */
function set(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }

// What has been found, nearest first: where it is from here, and by a tap where that is in other words.
/** @param {Place | null} here @param {number} heading_deg */
function showFinds(here, heading_deg) {
  const finds = (model.frame?.sources ?? []).filter((source) => source.state === "found").map((source) => {
    const [east, north] = here ? [source.east_m - here[0], source.north_m - here[1]] : [0, 0];
    const off_m = Math.hypot(east, north);
    const way = turn((Math.atan2(east, north) * 180) / Math.PI, heading_deg);
    const from = here ? `, ${Math.round(off_m)} m from you, ${way}` : "";
    return { source, off_m, words: `Source ${source.ident} found: ${source.east_m.toFixed(1)} m E, ${source.north_m.toFixed(1)} m N${from}` };
  }).sort((a, b) => a.off_m - b.off_m).slice(0, MOST_FINDS);
  const found = $("walk-found");
  found.hidden = !finds.length;
  while (found.children.length > finds.length) found.lastElementChild?.remove();
  while (found.children.length < finds.length) found.append(element("button", { title: "Tap: where that is, to copy" }));
  for (const [index, { source, words }] of finds.entries()) {
    const button = find(found, `:nth-child(${index + 1})`, HTMLButtonElement);
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
  const here = isOld(mine) ? null : placeOf(mine);
  const heading_deg = mine.heading_deg ?? 0;
  const silent = !mine.radio_up;
  const goal = mine.mode === "guided" ? mine.target_m : null;
  arrow.style.opacity = here && goal && !model.frame.end ? "1" : "0";
  if (model.frame.end) { set("walk-go", "The walk is over"); set("walk-why", model.frame.end); }
  else if (!here) { set("walk-go", "No position"); set("walk-why", "go where the sky is free"); }
  else if (!goal) { set("walk-go", "Stay here"); set("walk-why", silent ? radioDown(mine) : mine.why || mine.mode); }
  else {
    const [east, north] = [goal[0] - here[0], goal[1] - here[1]];
    const bearing = (Math.atan2(east, north) * 180) / Math.PI;
    arrow.style.transform = `rotate(${bearing - heading_deg}deg)`;
    set("walk-go", `${Math.round(Math.hypot(east, north))} m, ${turn(bearing, heading_deg)}`);
    set("walk-why", silent ? radioDown(mine) : mine.doing.startsWith("resolve") ? "to pin down what was heard" : "to listen where nobody has");
  }
  showFinds(here, heading_deg);
  const latest = levels.at(-1);
  set("walk-now", silent ? "radio down" : latest === undefined ? "silence" : `${Math.round(latest)} dBm`);
  set("walk-peak", peak === null ? "–" : `${Math.round(peak)} dBm`);
  const words = silent ? "" : trend(levels);
  set("walk-trend", words || "–");
  $("walk-trend").className = words;
  markButton.disabled = !mayChange() || !here;
  markButton.hidden = !model.hello?.live;
}

box.addEventListener("change", () => {
  me = box.value;
  sessionStorage.setItem("me", me);
  [heardUpTo, peak, levels] = [-1, null, []];
  walk();
});
$("walk-sound").addEventListener("click", () => {
  if (sound) { sound.close(); sound = null; } else sound = new AudioContext();
  $("walk-sound").textContent = sound ? "Sound off" : "Sound on";
  $("walk-sound").setAttribute("aria-pressed", String(Boolean(sound)));
});
markButton.addEventListener("click", () => {
  press(markButton, { action: "mark", robot: me }, true);
  if (!markButton.classList.contains("asking")) notice("Marked: your word, kept apart from what the radios say.");
});

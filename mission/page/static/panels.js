// @ts-check
// Robots, sources, signals and events in words. Cards are made once and then only filled anew, so that a press on a
// button never falls between two of them.
import { colourOf, isOld, mayChange, maySteer, model } from "./model.js";
import { press, showRights } from "./commands.js";
import { $, element, find } from "./dom.js";
import { follow, lookAt } from "./mapview.js";
import { showWhere } from "./where.js";
import { STATES, sureness } from "./words.js";

/** @import { Frame, Heard, LiveHello, Note, Robot, Source, Steer } from "./protocol" */
/** @typedef {ReturnType<typeof makeCard>} Card */
/** @typedef {ReturnType<typeof makeSource>} SourceRow */

/** @type {{ robots: Map<string, Card>, sources: Map<number, SourceRow> }} */
const made = { robots: new Map(), sources: new Map() };

/** @param {number} seconds */
export function clock(seconds) {
  const s = Math.max(0, Math.floor(seconds));
  /** @param {number} n */
  const two = (n) => String(n).padStart(2, "0");
  return s >= 3600 ? `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}` : `${Math.floor(s / 60)}:${two(s % 60)}`;
}
/** @param {HTMLElement} node @param {string} text @param {string} [kind] */
function set(node, text, kind) {
  if (node.textContent !== text) node.textContent = text;
  if (kind !== undefined && node.className !== kind) node.className = kind;
}

const FIGURES = { battery: "battery", fence: "to the fence", link: "link", pose: "position" };
/** @type {[Steer["action"], string][]} */
const ACTS = [["hold", "Hold"], ["return", "Return"], ["release", "Release"], ["resume", "Resume"]];

const MANY = 6; // of more robots than these the cards are folded
/** @param {Pick<Card, "card" | "fold">} part @param {boolean} folded */
function fold(part, folded) {
  part.card.classList.toggle("folded", folded);
  part.fold.textContent = folded ? "▸" : "▾";
  part.fold.setAttribute("aria-expanded", String(!folded));
}

// Its card in sight, for a moment marked: it was tapped on the map.
/** @param {string} name */
export function showRobot(name) {
  find(document, '#tabs [data-tab="robots"]').click();
  const part = made.robots.get(name);
  if (!part) return;
  fold(part, false);
  part.card.scrollIntoView({ block: "nearest", behavior: "smooth" });
  part.card.classList.add("marked");
  setTimeout(() => part.card.classList.remove("marked"), 1500);
}

/** @param {string} name */
function makeCard(name) {
  const part = {
    card: element("article", { className: "card" }),
    mode: element("span", { className: "mode" }), doing: element("span", { className: "doing" }),
    call: element("p", { className: "call", hidden: true }), last: element("p", { className: "last" }),
    figures: { battery: element("dd"), fence: element("dd"), link: element("dd"), pose: element("dd") },
    acts: element("div", { className: "acts" }), buttons: ACTS.map(([action, words]) => makeAct(name, action, words)),
    fold: element("button", { className: "fold", title: "More or less of it" }),
  };
  const figures = element("dl", { className: "figures" });
  for (const key of /** @type {(keyof typeof FIGURES)[]} */ (Object.keys(FIGURES))) {
    figures.append(element("div", {}, element("dt", { textContent: FIGURES[key] }), part.figures[key]));
  }
  part.acts.append(...part.buttons);
  const dot = element("span", { className: "dot" });
  dot.style.background = colourOf(name);
  const called = element("button", { className: "name", textContent: name, title: "Follow it on the map" });
  called.addEventListener("click", () => { follow(name); model.version.side += 1; });
  part.fold.setAttribute("aria-label", `${name}: more or less`);
  part.fold.addEventListener("click", () => fold(part, !part.card.classList.contains("folded")));
  const head = element("div", { className: "head" }, dot, called, part.mode, part.doing, part.fold);
  part.card.append(head, part.call, figures, part.last, part.acts);
  fold(part, (model.hello?.robots.length ?? 0) > MANY);
  part.card.dataset.robot = name;
  return part;
}

/** @param {string} robot @param {Steer["action"]} action @param {string} words */
function makeAct(robot, action, words) {
  const button = element("button", { textContent: words, className: action === "hold" ? "act hold-one" : "act" });
  button.dataset.action = action;
  button.dataset.robot = robot;
  button.addEventListener("click", () => press(button, { action, robot }, action === "release"));
  return button;
}

/** @param {Robot} robot */
export const radioDown = ({ radio_why }) => (radio_why ? `radio down: ${radio_why}` : "radio down");

/** @param {Card} part @param {Robot} robot */
function fillCard(part, robot) {
  const lost = !robot.link_up;
  const standing = robot.ordered === "release" ? "released" : robot.ordered === "withdraw" ? "withdrawn" : "";
  set(part.mode, lost ? "link lost" : standing || robot.mode, `mode ${lost ? "lost" : robot.mode}`);
  set(part.doing, robot.radio_up ? robot.doing : radioDown(robot));
  part.doing.title = robot.radio_up ? "" : radioDown(robot); // the card has room for its beginning
  part.doing.classList.toggle("bad", !robot.radio_up);
  set(part.call, robot.call);
  part.call.hidden = !robot.call;
  part.card.classList.toggle("calls", Boolean(robot.call) || lost);
  const { battery, fence, link, pose } = part.figures;
  const low = robot.battery_pct !== null && robot.battery_pct <= robot.reserve_pct + 10;
  set(battery, robot.battery_pct === null ? "–" : `${Math.round(robot.battery_pct)} %`,
    robot.battery_pct !== null && robot.battery_pct <= robot.reserve_pct ? "bad" : low ? "warn" : "");
  battery.title = `goes home at ${Math.round(robot.reserve_pct)} %`;
  set(fence, robot.fence_m === null ? "–" : `${robot.fence_m.toFixed(1)} m`, robot.fence_m !== null && robot.fence_m < 0 ? "bad" : "");
  const silent_s = robot.link_age_s ?? 0;
  set(link, age(robot.link_age_s), silent_s > 5 ? "bad" : silent_s > 2 ? "warn" : "");
  set(pose, age(robot.pose_age_s), isOld(robot) ? "bad" : "");
  const answer = robot.answer === "done" ? "✓" : robot.answer === "..." ? "…" : robot.answer ? `✗ ${robot.answer}` : "";
  const colon = robot.command === "go to" || !robot.why ? "" : ":";
  const words = [robot.command && `${robot.command}${colon} ${robot.why}`, answer].filter(Boolean).join(" ");
  set(part.last, [words, robot.text].filter(Boolean).join("  ·  "));
  part.acts.hidden = !model.hello?.live;
  for (const button of part.buttons) button.disabled = !maySteer();
}
/** @param {number | null} seconds */
const age = (seconds) => (seconds === null ? "–" : seconds < 1 ? "now" : seconds < 100 ? `${seconds.toFixed(seconds < 10 ? 1 : 0)} s ago` : `${clock(seconds)} ago`);

/** @param {Frame} frame */
function alarms({ alarms: said }) {
  const box = $("alarms");
  const now = said.join("\n");
  if (box.dataset.said === now) return;
  box.dataset.said = now;
  box.hidden = !said.length;
  box.replaceChildren(...said.map((text) => element("li", { textContent: text })));
}

/** @param {LiveHello} hello of a mission that has not started */
export function waiting(hello) {
  /** @param {boolean} on_foot */
  const names = (on_foot) => hello.robots.filter((robot) => robot.on_foot === on_foot).map((robot) => robot.name).join(", ");
  const awaited = [
    names(false) && `the radio and the vehicle of each robot are there: ${names(false)}`,
    names(true) && `the radio and a position of whoever walks are there: ${names(true)}`,
  ].filter(Boolean).join("; and when ");
  const text = {
    mission: `The mission starts when ${awaited}.`,
    agent: "This robot starts when its radio and its vehicle are there.",
    page: "Nothing has been heard of the robots yet.",
  }[hello.ends];
  find($("robots"), ".cards").replaceChildren(element("p", { className: "empty", textContent: text }));
  made.robots.clear();
}

/** @param {Frame} frame */
function robots(frame) {
  const box = find($("robots"), ".cards");
  box.querySelector(".empty")?.remove();
  for (const robot of frame.robots) {
    let part = made.robots.get(robot.name);
    if (!part) { part = makeCard(robot.name); made.robots.set(robot.name, part); box.append(part.card); }
    fillCard(part, robot);
  }
}

/** @param {number} ident */
function makeSource(ident) {
  /** @type {[east: number, north: number]} */
  const at = [0, 0];
  const part = {
    at, row: element("div", { className: "source" }), acts: element("div", { className: "acts" }),
    ident: element("span", { textContent: String(ident) }), where: element("button", { className: "place", title: "Say it in degrees, UTM, MGRS" }),
    p: element("span", { className: "p" }), more: element("span", { className: "more" }),
    button: element("button", { className: "act", textContent: "Mark as removed" }),
  };
  part.button.dataset.action = "remove";
  part.button.dataset.source = String(ident);
  part.button.addEventListener("click", () => press(part.button, { action: "remove", source: ident }, true));
  part.acts.append(part.button);
  part.where.addEventListener("click", () => { lookAt(...part.at); showWhere(...part.at, `Source ${ident}`); });
  part.row.append(part.ident, element("div", {}, part.where, element("br"), part.more), part.p, part.acts);
  return part;
}

const FAINT = 0.05;
const MOST_SOURCES = 60;
/** @param {Frame} frame */
function sources(frame) {
  const box = find($("sources"), ".rows");
  /** @type {Record<Source["state"], number>} */
  const rank = { found: 0, candidate: 1, inconsistent: 2, outside: 3, removed: 4 };
  const sorted = [...frame.sources].sort((a, b) => rank[a.state] - rank[b.state] || b.p - a.p);
  const faint = sorted.filter((source) => source.state === "candidate" && source.p < FAINT);
  const shown = sorted.filter((source) => !faint.includes(source)).slice(0, MOST_SOURCES);
  const faintest = faint.length ? `and ${faint.length} candidate${faint.length > 1 ? "s" : ""} below ${100 * FAINT} %, on the map only` : "";
  set($("faint-sources"), faintest);
  const now = new Set(shown.map((source) => source.ident));
  for (const [ident, part] of made.sources) if (!now.has(ident)) { part.row.remove(); made.sources.delete(ident); }
  shown.forEach((source, index) => {
    let part = made.sources.get(source.ident);
    if (!part) { part = makeSource(source.ident); made.sources.set(source.ident, part); }
    if (box.children[index] !== part.row) box.insertBefore(part.row, box.children[index] ?? null);
    set(part.ident, String(source.ident), `ident ${source.state}`);
    part.at = [source.east_m, source.north_m];
    set(part.where, `${source.east_m.toFixed(1)} m E, ${source.north_m.toFixed(1)} m N`);
    set(part.p, `${Math.round(100 * source.p)} %`, `p ${source.state}`);
    const spread = source.state === "outside" || source.state === "removed" ? "" : sureness(source);
    set(part.more, [STATES[source.state], spread, `heard ${source.receptions.toFixed(0)}×`, source.note].filter(Boolean).join(" · "));
    part.acts.hidden = !model.hello?.live || source.state === "removed" || source.state === "candidate";
    part.button.disabled = !mayChange();
  });
  const empty = box.querySelector(".empty");
  if (!shown.length && !empty) box.append(element("p", { className: "empty", textContent: "Nothing heard enough yet." }));
  if (shown.length && empty) empty.remove();
}

function signals() {
  const box = find($("signals"), ".rows");
  const rows = model.detections.slice(-40).reverse().map((heard) => {
    const bars = element("div", { className: "bars" });
    for (const [name, dbm] of Object.entries(heard.heard_dbm)) {
      const meter = element("meter", { min: -100, max: -30, value: dbm });
      const who = element("span", { className: "who", textContent: name });
      who.style.borderColor = colourOf(name);
      bars.append(element("span", { className: "level" }, who, meter, `${Math.round(dbm)} dBm`));
    }
    return element("div", { className: "signal" }, element("time", { textContent: clock(heard.t_s) }), bars);
  });
  box.replaceChildren(...(rows.length ? rows : [element("p", { className: "empty", textContent: "Nothing heard yet." })]));
}

function events() {
  const rows = model.notes.slice(-100).reverse().map((note) => {
    const find = note.text.startsWith("found source") ? " find" : "";
    return element("li", { className: `event ${note.level}${find}` }, element("time", { textContent: clock(note.t_s) }), element("span", { textContent: note.text }));
  });
  const empty = element("li", { className: "empty", textContent: "Nothing yet." });
  find($("events"), ".rows").replaceChildren(...(rows.length ? rows : [empty]));
}

/** @type {{ detections?: Heard, notes?: Note }} the newest that are shown */
let shown = {};
export function fill() {
  const frame = model.frame;
  if (!frame || !model.hello) return;
  alarms(frame);
  robots(frame);
  sources(frame);
  const marks = { detections: model.detections.at(-1), notes: model.notes.at(-1) };
  if (marks.detections !== shown.detections || !shown.detections) signals();
  if (marks.notes !== shown.notes || !shown.notes) events();
  shown = marks;
  set($("clock"), clock(frame.t_s));
  set($("found"), String(frame.sources.filter((s) => s.state === "found" || s.state === "removed").length));
  set($("candidates"), String(frame.sources.filter((s) => s.state === "candidate" || s.state === "inconsistent").length));
  set($("detections"), String(frame.detections));
  set($("left"), `${Math.round(100 * frame.left)} %`);
  set($("recording"), frame.recording ?? "", (frame.recording ?? "").startsWith("recording") ? "" : "bad");
  set($("viewers"), (frame.viewers ?? 0) > 1 ? `${frame.viewers} look, ${frame.commanders} may command` : "");
  showRights();
}

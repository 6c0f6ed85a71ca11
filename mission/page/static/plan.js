// @ts-check
// The mission editor: a form and a map over one draft, which the server holds, judges and writes.
import { $, buttons, element, find } from "./dom.js";
import { drawing, setUpMap, showGround, showShape } from "./plan-map.js";
import { fillRobots, newRobot, paired, setChoices, setPorts } from "./plan-robots.js";

/** @import { BackgroundShown, CheckShown, Draft, Failed, HeardVehicle, Port, Preflight, RemarkShown } from "./protocol" */
/** @import { Kind } from "./plan-map.js" */
/** @typedef {Required<Draft>} State a draft, and what there is to choose from */
/** @typedef {{ state: State, change: Draft, store: Draft, ground: BackgroundShown }} OfDraft */
/** @typedef {OfDraft & { ports: Port[], heard: HeardVehicle[], preflight: Preflight }} Answers */
/** @typedef {HTMLInputElement | HTMLSelectElement} Input */
/** @typedef {Record<string, unknown>} Table of the form */

const token = location.hash.slice(1) || sessionStorage.getItem("token") || "";
sessionStorage.setItem("token", token);
const headers = { authorization: `Bearer ${token}` };
if (location.hash) history.replaceState(null, "", location.pathname); // not in screenshots
/** @type {State} */
let now; // the state as the server has it; nothing can be pressed before it is there
/** @type {State["form"]} */
let form;
let changes = 0;
let typing = false; // into a robot's row, which must not be made anew under the fingers

/** @param {string} text */
function notice(text) { $("notice").textContent = text; $("notice").className = "bad"; $("notice").hidden = !text; }

/**
 * @template {keyof Answers} What
 * @param {What} what
 * @param {{ body?: unknown, query?: string }} given with a body it is posted
 * @returns {Promise<Answers[What] | null>}
 */
async function ask(what, { body, query = "" } = {}) {
  const options = body === undefined ? { headers } : { headers, method: "POST", body: JSON.stringify(body) };
  try {
    const answer = await fetch(`plan/${what}${query}`, options);
    /** @type {Answers[What]} */
    const plain = await answer.json();
    if (answer.ok) { notice(""); return plain; }
    notice(/** @type {Failed} */ (/** @type {unknown} */ (plain)).error);
  } catch { notice("No answer: has 'fieldkit plan' ended?"); }
  return null;
}

// The pictures under the map, anew where what they depend on has changed. They need the token: an <img> has none.
let ground = "";
async function fillGround() {
  const { background, origin_lat_deg, origin_lon_deg, size_east_m, size_north_m } = form.field;
  const key = JSON.stringify([background, origin_lat_deg, origin_lon_deg, size_east_m, size_north_m]);
  if (key === ground) return;
  ground = key;
  const found = (background && await ask("ground")) || { pictures: [], credit: "" };
  if (key !== ground) return;
  const drawn = found.pictures.map(async ({ url, corners_m }) => ({ corners_m, image: await createImageBitmap(await (await fetch(url, { headers })).blob()) }));
  const pictures = (await Promise.allSettled(drawn)).flatMap((each) => (each.status === "fulfilled" ? [each.value] : []));
  if (key === ground) showGround(pictures, found.credit);
}

/** @type {(key: string) => [Table, string]} */
const holder = (key) => {
  const [table, name] = key.split(".");
  return [/** @type {Record<string, Table>} */ (/** @type {unknown} */ (form))[table], name];
};
/** @type {(selector: string) => Input[]} */
const inputsIn = (selector) => [...document.querySelectorAll(selector)].filter((each) => each instanceof HTMLInputElement || each instanceof HTMLSelectElement);

function fill() {
  for (const input of inputsIn(".form [data-key]:not(.robot [data-key])")) {
    const [table, name] = holder(input.dataset.key ?? "");
    const value = String(table[name] ?? "");
    if (input instanceof HTMLSelectElement) {
      const names = input.dataset.choices === "pictures" ? ["", ...now.choices.pictures] : now.choices.antennas;
      input.replaceChildren(...[...new Set([...names, value])].map((each) => new Option(each || "none", each, false, each === value)));
    } else if (document.activeElement !== input) input.value = value;
  }
  $("no-antenna").hidden = now.choices.antennas.length > 0;
  if (!typing) fillRobots($("robots"), form.robots, robotsChanged);
  showShape({ east_m: form.field.size_east_m, north_m: form.field.size_north_m, fence: form.field.fence, keep_out: form.field.keep_out ?? [], standing: now.standing });
  fillGround();
  $("path").textContent = now.path.split(/[\\/]/).at(-1) ?? "";
  $("path").title = now.path;
  $("stored").textContent = now.new ? "not stored yet" : now.stored ? "stored" : "changed";
  $("stored").className = `chip ${now.stored ? "live" : "lost"}`;
  $("store", HTMLButtonElement).disabled = now.stored;
  $("text").textContent = now.text;
  remarks();
}

// Whether a remark's key, as the file has it, is that of an input: robots are numbered there and named here.
/** @param {string} key @param {string} shown */
function isAbout(key, shown) {
  const numbered = shown.replace(/^robot (.*): (.*)$/, (_, name, rest) => `robot.${form.robots.findIndex((each) => each.name === name)}.${rest}`);
  return shown === key || (key.startsWith("robot ") && shown === `${key}.port`) || `top.${key}` === shown || key === numbered;
}

/** @param {RemarkShown} remark @param {Input} [input] that it is about */
function remarkLine(remark, input) {
  const line = element("li", { className: remark.level });
  if (!input) { line.append(remark.key ? `${remark.key}: ${remark.text}` : remark.text); return line; }
  if (remark.level === "red") input.setAttribute("aria-invalid", "true");
  const go = element("button", { textContent: remark.key });
  go.addEventListener("click", () => { input.focus(); input.scrollIntoView({ block: "center" }); });
  line.append(go, remark.text);
  return line;
}

function remarks() {
  const red = now.remarks.filter((each) => each.level === "red").length;
  const words = red ? `${red} thing${red > 1 ? "s" : ""} to mend before it can start` : now.remarks.length ? "can start; read the remarks" : "good: it can start";
  $("verdict").textContent = words;
  $("verdict").className = red ? "red" : now.remarks.length ? "amber" : "green";
  const inputs = inputsIn("[data-key]");
  for (const input of inputs) input.removeAttribute("aria-invalid");
  const lines = now.remarks.map((each) => remarkLine(each, inputs.find((input) => each.key && isAbout(each.key, input.dataset.key ?? ""))));
  if (!lines.length) lines.push(element("li", { className: "green", textContent: now.stored ? "Nothing. Preflight is next." : "Nothing. Store the file." }));
  $("remarks").replaceChildren(...lines);
  $("next").replaceChildren(...(red || !now.stored ? [] : ["Then, in a terminal: ", element("code", { textContent: `fieldkit run ${now.path} --page` })]));
}

// The newest change wins: an answer to an older one is not shown.
async function change() {
  changes += 1;
  const mine = changes;
  const state = await ask("change", { body: form });
  if (state && mine === changes) { now = { ...now, ...state }; if (!typing) form = now.form; fill(); }
}

function robotsChanged() {
  form.teams = paired(form.robots.map((robot) => robot.name), form.teams.map((team) => team.map((name) => form.robots.find((robot) => robot.was === name)?.name ?? name)));
  change();
}

function setUpForm() {
  document.addEventListener("input", (event) => { typing = event.target instanceof HTMLElement && Boolean(event.target.closest(".robot")); });
  for (const end of ["change", "focusout"]) document.addEventListener(end, () => { typing = false; });
  document.addEventListener("change", (event) => {
    const input = event.target;
    if (!(input instanceof HTMLInputElement || input instanceof HTMLSelectElement)) return;
    if (!input.dataset.key || input.closest(".robot")) return;
    const [table, name] = holder(input.dataset.key);
    if (input.type === "number") {
      if (input.validity.badInput) { notice(`${input.dataset.key}: expected a number`); return; }
      table[name] = input.value === "" ? null : Number(input.value);
    } else table[name] = input.value === "" ? null : input.value;
    change();
  });
  for (const button of buttons("[data-draw]")) button.addEventListener("click", () => pressDraw(button));
  $("clear").addEventListener("click", () => { form.field.fence = null; form.field.keep_out = null; change(); });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") stopDrawing(); });
}

function stopDrawing() {
  Object.assign(drawing, { kind: "", corners: [] });
  for (const [kind, words] of [["fence", "Draw fence"], ["keep_out", "Close an area"]]) {
    const button = find(document, `[data-draw=${kind}]`);
    button.textContent = words;
    button.classList.remove("on");
  }
  notice("");
}

/** @param {HTMLButtonElement} button */
function pressDraw(button) {
  const kind = /** @type {Kind} */ (button.dataset.draw);
  if (drawing.kind !== kind) {
    stopDrawing();
    drawing.kind = kind;
    button.classList.add("on");
    button.textContent = "Done";
    return;
  }
  const corners = drawing.corners;
  stopDrawing();
  if (corners.length < 3) { notice("It needs three corners at least: nothing was drawn."); return; }
  if (kind === "fence") form.field.fence = corners;
  else form.field.keep_out = [...(form.field.keep_out ?? []), corners];
  change();
}

/**
 * @template {keyof Answers} What
 * @param {string} id of the button that asks
 * @param {What} what
 * @param {{ body?: unknown, query?: string }} given
 */
async function busy(id, what, given = {}) {
  const button = $(id, HTMLButtonElement);
  const words = button.textContent;
  button.disabled = true;
  button.textContent = "…";
  const plain = await ask(what, given);
  button.disabled = false;
  button.textContent = words;
  return plain;
}

/** @param {string} name @param {string} words @param {string} act @param {() => void} onAct @param {boolean} [isDone] already */
function thing(name, words, act, onAct, isDone = false) {
  const button = element("button", { className: "act", textContent: isDone ? "done" : act, disabled: isDone });
  button.addEventListener("click", () => { button.textContent = "done"; button.disabled = true; onAct(); });
  return element("div", { className: "thing" }, element("b", { textContent: name }), element("span", { textContent: words }), button);
}

async function showPorts() {
  const found = await busy("ports", "ports");
  if (!found) return;
  setPorts(found);
  $("around").replaceChildren(...(found.length ? found.map((each) => thing(each.port, each.what, "Use", () => {
    const without = form.robots.find((robot) => !robot.receiver.port && !robot.receiver.source);
    if (without) without.receiver = { ...without.receiver, port: each.port };
    else form.robots.push(newRobot(form.robots, {}, { port: each.port }));
    robotsChanged();
  })) : ["No serial port is there: is the radio plugged in?"]));
  fill();
}

async function showHeard() {
  const address = $("address", HTMLInputElement).value.trim();
  const found = await busy("heard", "heard", { query: `?address=${encodeURIComponent(address)}` });
  if (!found) return;
  const rows = found.map((each) => thing(`system ${each.system_id}`, `${each.firmware}, ${each.mode}${each.place_deg ? "" : ", no position yet"}`, "Add", () => {
    form.robots.push(newRobot(form.robots, { address, system_id: each.system_id }));
    robotsChanged();
  }, form.robots.some(({ vehicle }) => vehicle.address === address && vehicle.system_id === each.system_id)));
  const first = found.find((each) => each.place_deg);
  if (first?.place_deg) rows.push(thing("field", `begin the field where system ${first.system_id} stands`, "Set", () => {
    [form.field.origin_lat_deg, form.field.origin_lon_deg] = /** @type {[number, number]} */ (first.place_deg);
    change();
  }));
  $("around").replaceChildren(...(rows.length ? rows : [`No vehicle is heard on ${address}.`]));
  change(); // the map shows where they stand
}

async function runPreflight() {
  $("checks").textContent = "listening …";
  const found = await busy("preflight", "preflight", { body: {} });
  if (!found) { $("checks").textContent = ""; return; }
  /** @type {Record<CheckShown["level"], number>} */
  const order = { red: 0, amber: 1, green: 2 };
  const rows = found.checks.sort((a, b) => order[a.level] - order[b.level]).map((each) => element(
    "div", { className: "check" }, element("b", { className: each.level, textContent: each.level }),
    element("span", { textContent: `${each.robot}: ${each.name}: ${each.found}${each.level !== "green" && each.remedy ? `. ${each.remedy}` : ""}` }),
  ));
  $("checks").replaceChildren(element("strong", { textContent: `before the start: ${found.verdict}` }), ...rows);
}

async function begin() {
  const state = await ask("state");
  if (!state) { $("verdict").textContent = "cannot be read"; return; }
  now = state;
  form = now.form;
  setChoices(now.choices);
  setUpMap(() => change());
  setUpForm();
  $("add").addEventListener("click", () => { form.robots.push(newRobot(form.robots)); robotsChanged(); });
  $("ports").addEventListener("click", showPorts);
  $("heard").addEventListener("click", showHeard);
  $("preflight").addEventListener("click", runPreflight);
  $("store").addEventListener("click", async () => { const state = await busy("store", "store", { body: {} }); if (state) now = { ...now, ...state }; fill(); });
  window.addEventListener("beforeunload", (event) => { if (!now.stored) event.preventDefault(); });
  fill();
  document.body.inert = false; // a press before anything listens would be lost
}
begin();
Object.assign(window, { fieldkitPlan: { get state() { return now; } } }); // for a look from the console

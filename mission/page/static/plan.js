// The mission editor: a form and a map over one draft, which the server holds, judges and writes.
import { element } from "./dom.js";
import { drawing, setUpMap, showGround, showShape } from "./plan-map.js";
import { fillRobots, newRobot, paired, setChoices, setPorts } from "./plan-robots.js";

const $ = (id) => document.getElementById(id);
const token = decodeURIComponent(location.hash.slice(1)) || sessionStorage.getItem("token") || "";
sessionStorage.setItem("token", token);
if (location.hash) history.replaceState(null, "", location.pathname); // not in screenshots
let now = null; // the state as the server has it
let form = null;
let changes = 0;

function notice(text) { $("notice").textContent = text; $("notice").className = "bad"; $("notice").hidden = !text; }

async function ask(path, body) {
  const options = { headers: { authorization: `Bearer ${token}` } };
  if (body !== undefined) Object.assign(options, { method: "POST", body: JSON.stringify(body) });
  let plain = null;
  try {
    const answer = await fetch(`plan/${path}`, options);
    plain = await answer.json();
  } catch { plain = { error: "No answer: has 'fieldkit plan' ended?" }; }
  notice(plain.error ?? "");
  return plain.error ? null : plain;
}

// The pictures under the map, anew where what they depend on has changed. They need the token: an <img> has none.
let ground = "";
async function fillGround() {
  const key = JSON.stringify(["background", "origin_lat_deg", "origin_lon_deg", "size_east_m", "size_north_m"].map((name) => form.field[name]));
  if (key === ground) return;
  ground = key;
  const headers = { authorization: `Bearer ${token}` };
  const found = form.field.background ? await fetch("plan/ground", { headers }).then((answer) => answer.json()).catch(() => null) : { pictures: [] };
  if (key !== ground || !found) return;
  if (found.error) notice(found.error);
  const drawn = (found.pictures ?? []).map(async ({ url, corners_m }) => ({ corners_m, image: await createImageBitmap(await (await fetch(url, { headers })).blob()) }));
  const pictures = (await Promise.allSettled(drawn)).filter((each) => each.status === "fulfilled").map((each) => each.value);
  if (key === ground) showGround(pictures, found.credit ?? "");
}

const holder = (key) => { const [table, name] = key.split("."); return [form[table], name]; };

function fill() {
  for (const input of document.querySelectorAll(".form [data-key]:not(.robot [data-key])")) {
    const [table, name] = holder(input.dataset.key);
    const value = table[name] ?? "";
    if (input.tagName === "SELECT") {
      const names = now.choices[input.dataset.choices];
      const all = [...new Set([...(input.dataset.choices === "pictures" ? [""] : []), ...names, value].filter((each) => each !== null))];
      input.replaceChildren(...all.map((each) => new Option(each || "none", each, false, each === value)));
    } else if (document.activeElement !== input) input.value = value;
  }
  $("no-antenna").hidden = now.choices.antennas.length > 0;
  fillRobots($("robots"), form.robots, robotsChanged);
  showShape({ east_m: form.field.size_east_m, north_m: form.field.size_north_m, fence: form.field.fence, keep_out: form.field.keep_out ?? [] });
  fillGround();
  $("path").textContent = now.path.split(/[\\/]/).at(-1);
  $("path").title = now.path;
  $("stored").textContent = now.new ? "not stored yet" : now.stored ? "stored" : "changed";
  $("stored").className = `chip ${now.stored ? "live" : "lost"}`;
  $("store").disabled = now.stored;
  $("text").textContent = now.text;
  remarks();
}

function remarks() {
  const red = now.remarks.filter((each) => each.level === "red").length;
  const words = red ? `${red} thing${red > 1 ? "s" : ""} to mend before it can start` : now.remarks.length ? "can start; read the remarks" : "good: it can start";
  $("verdict").textContent = words;
  $("verdict").className = red ? "red" : now.remarks.length ? "amber" : "green";
  const inputs = [...document.querySelectorAll("[data-key]")];
  for (const input of inputs) input.removeAttribute("aria-invalid");
  const about = (key) => key && inputs.find((input) => input.dataset.key === key || (key.startsWith("robot ") && input.dataset.key === `${key}.port`) || `top.${key}` === input.dataset.key || key === input.dataset.key.replace(/^robot (.*): (.*)$/, (_, name, rest) => `robot.${form.robots.findIndex((each) => each.name === name)}.${rest}`));
  const lines = now.remarks.map((each) => {
    const input = about(each.key);
    const line = element("li", { className: each.level });
    if (input) {
      if (each.level === "red") input.setAttribute("aria-invalid", "true");
      const go = element("button", { textContent: each.key });
      go.addEventListener("click", () => { input.focus(); input.scrollIntoView({ block: "center" }); });
      line.append(go, each.text);
    } else line.append(each.key ? `${each.key}: ${each.text}` : each.text);
    return line;
  });
  if (!lines.length) lines.push(element("li", { className: "green", textContent: now.stored ? "Nothing. Preflight is next." : "Nothing. Store the file." }));
  $("remarks").replaceChildren(...lines);
  $("next").replaceChildren(...(red || !now.stored ? [] : ["Then, in a terminal: ", element("code", { textContent: `fieldkit run ${now.path} --page` })]));
}

// The newest change wins: an answer to an older one is not shown.
async function change() {
  changes += 1;
  const mine = changes;
  const state = await ask("change", form);
  if (state && mine === changes) { now = { ...now, ...state }; form = now.form; fill(); }
}

function robotsChanged() {
  form.teams = paired(form.robots.map((robot) => robot.name), form.teams.map((team) => team.map((name) => form.robots.find((robot) => robot.was === name)?.name ?? name)));
  change();
}

function setUpForm() {
  document.addEventListener("change", (event) => {
    const input = event.target;
    if (!input.dataset?.key || input.closest(".robot")) return;
    const [table, name] = holder(input.dataset.key);
    if (input.type === "number") {
      if (input.validity.badInput) { notice(`${input.dataset.key}: expected a number`); return; }
      table[name] = input.value === "" ? null : Number(input.value);
    } else table[name] = input.value === "" ? null : input.value;
    change();
  });
  for (const button of document.querySelectorAll("[data-draw]")) button.addEventListener("click", () => pressDraw(button));
  $("clear").addEventListener("click", () => { form.field.fence = null; form.field.keep_out = null; change(); });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") stopDrawing(); });
}

function stopDrawing() {
  Object.assign(drawing, { kind: "", corners: [] });
  for (const [kind, words] of [["fence", "Draw fence"], ["keep_out", "Close an area"]]) {
    const button = document.querySelector(`[data-draw=${kind}]`);
    button.textContent = words;
    button.classList.remove("on");
  }
  notice("");
}

function pressDraw(button) {
  const kind = button.dataset.draw;
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

async function busy(button, path, body) {
  const words = button.textContent;
  button.disabled = true;
  button.textContent = "…";
  const plain = await ask(path, body);
  button.disabled = false;
  button.textContent = words;
  return plain;
}

function thing(name, words, act, onAct) {
  const button = element("button", { className: "act", textContent: act });
  button.addEventListener("click", onAct);
  return element("div", { className: "thing" }, element("b", { textContent: name }), element("span", { textContent: words }), button);
}

async function showPorts() {
  const found = await busy($("ports"), "ports");
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
  const address = $("address").value.trim();
  const found = await busy($("heard"), `heard?address=${encodeURIComponent(address)}`);
  if (!found) return;
  const rows = found.map((each) => thing(`system ${each.system_id}`, `${each.firmware}, ${each.mode}${each.place_deg ? "" : ", no position yet"}`, "Add", () => {
    form.robots.push(newRobot(form.robots, { address, system_id: each.system_id }));
    robotsChanged();
  }));
  const placed = found.find((each) => each.place_deg);
  if (placed) rows.push(thing("field", "begin the field where it stands", "Set", () => {
    [form.field.origin_lat_deg, form.field.origin_lon_deg] = placed.place_deg;
    change();
  }));
  $("around").replaceChildren(...(rows.length ? rows : [`No vehicle is heard on ${address}.`]));
}

async function runPreflight() {
  $("checks").textContent = "listening …";
  const found = await busy($("preflight"), "preflight", {});
  if (!found) { $("checks").textContent = ""; return; }
  const order = { red: 0, amber: 1, green: 2 };
  const rows = found.checks.sort((a, b) => order[a.level] - order[b.level]).map((each) => element(
    "div", { className: "check" }, element("b", { className: each.level, textContent: each.level }),
    element("span", { textContent: `${each.robot}: ${each.name}: ${each.found}${each.level !== "green" && each.remedy ? `. ${each.remedy}` : ""}` }),
  ));
  $("checks").replaceChildren(element("strong", { textContent: `before the start: ${found.verdict}` }), ...rows);
}

async function begin() {
  setUpMap(() => change());
  setUpForm();
  $("add").addEventListener("click", () => { form.robots.push(newRobot(form.robots)); robotsChanged(); });
  $("ports").addEventListener("click", showPorts);
  $("heard").addEventListener("click", showHeard);
  $("preflight").addEventListener("click", runPreflight);
  $("store").addEventListener("click", async () => { const state = await busy($("store"), "store", {}); if (state) now = { ...now, ...state }; if (now) fill(); });
  window.addEventListener("beforeunload", (event) => { if (now && !now.stored) event.preventDefault(); });
  const state = await ask("state");
  if (!state) { $("verdict").textContent = "cannot be read"; return; }
  now = state;
  form = now.form;
  setChoices(now.choices);
  fill();
}
begin();
window.fieldkitPlan = { get state() { return now; } }; // for a look from the console

// @ts-check
// What the operator can do. HOLD ALL asks nothing; what is hard to undo is asked twice, on the same button.
import { $, buttons } from "./dom.js";
import { mayChange, maySteer, model } from "./model.js";
import { ask, command } from "./socket.js";
import { area } from "./map.js";

/** @import { Command, Steer } from "./protocol" */

const SURE_MS = 3000;
const [holdButton, slider] = [$("hold-all", HTMLButtonElement), $("slider", HTMLInputElement)];

/** @param {string} text @param {boolean} bad */
export function notice(text, bad = false) {
  const box = $("notice");
  box.textContent = text;
  box.className = bad ? "bad" : "";
  box.hidden = !text;
}

/** @param {Command} order */
export async function send(order) {
  const answer = await command(order);
  if (!answer.ok) notice(answer.text, true);
  return answer.ok;
}

/** @type {WeakMap<HTMLButtonElement, () => void>} what brings a button that asks back to its own words */
const asking = new WeakMap();

/** @param {HTMLButtonElement} button @param {Command} order @param {boolean} confirm */
export function press(button, order, confirm) {
  const calm = asking.get(button);
  if (confirm && !calm) {
    const words = button.textContent;
    button.classList.add("asking");
    button.textContent = "Sure? Press again";
    const timer = setTimeout(() => asking.get(button)?.(), SURE_MS);
    asking.set(button, () => { clearTimeout(timer); asking.delete(button); button.classList.remove("asking"); button.textContent = words; });
    return;
  }
  calm?.();
  send(order);
}

export function holdAll() {
  if (!model.mayCommand) { notice("Only looking: open the address with the token that was printed at the start.", true); return; }
  holdButton.classList.add("sent");
  setTimeout(() => holdButton.classList.remove("sent"), 400);
  send({ action: "hold", robot: null });
}

export function setUp() {
  // On the way down, not up: a finger that slips off must still stop the robots.
  holdButton.addEventListener("pointerdown", (event) => { event.preventDefault(); holdAll(); });
  holdButton.addEventListener("keydown", (event) => { if (event.key === "Enter") holdAll(); });
  document.addEventListener("keydown", (event) => {
    const typing = event.target instanceof Element && event.target.matches('input:not([type="radio"]), select, textarea');
    if (typing || event.repeat || event.ctrlKey || event.altKey || event.metaKey || !model.hello?.live) return;
    if (event.key === " " || event.key === "h" || event.key === "H") { event.preventDefault(); holdAll(); }
    if (event.key === "Escape" && area.drawing) finishArea(false);
  });
  for (const button of buttons("#commands [data-all]")) {
    const action = /** @type {Steer["action"] | "end"} */ (button.dataset.all);
    button.addEventListener("click", () => press(button, { action, robot: null }, true));
  }
  $("exclude").addEventListener("click", () => (area.drawing ? finishArea(true) : beginArea()));
  setUpPlayer();
}

function beginArea() {
  area.begin();
  $("exclude").classList.add("drawing");
  $("exclude").textContent = "Close it for robots";
  notice("Tap the corners of the area on the map, then press the button again. Esc: leave it.");
}
/** @param {boolean} wanted */
function finishArea(wanted) {
  const corners = area.end();
  $("exclude").classList.remove("drawing");
  $("exclude").textContent = "Close an area";
  notice("");
  if (!wanted) return;
  if (corners.length < 3) { notice("An area needs three corners at least: nothing was closed.", true); return; }
  send({ action: "exclude", area_m: corners });
}

function setUpPlayer() {
  let playing = false;
  const rate = $("rate", HTMLSelectElement);
  /** @param {boolean} on */
  const play = (on) => {
    playing = on;
    $("play").textContent = on ? "❚❚" : "▶";
    ask(on ? { kind: "play", rate: Number(rate.value) } : { kind: "pause" });
  };
  $("play").addEventListener("click", () => play(!playing));
  rate.addEventListener("change", () => { if (playing) play(true); });
  slider.addEventListener("input", () => ask({ kind: "seek", t_s: Number(slider.value) }));
}

export function showRights() {
  const live = Boolean(model.hello?.live);
  $("commands").hidden = !live;
  $("player").hidden = live || !model.hello;
  if (model.hello?.live) $("end").textContent = model.hello.ends === "mission" ? "End mission" : `End this ${model.hello.ends}`;
  holdButton.hidden = !live;
  for (const button of buttons("#commands button")) button.disabled = !mayChange();
  holdButton.disabled = !maySteer();
}

// What the operator can do. HOLD ALL asks nothing; what is hard to undo is asked twice, on the same button.
import { model } from "./model.js";
import { ask, command } from "./socket.js";
import { area } from "./map.js";

const $ = (id) => document.getElementById(id);
const SURE_MS = 3000;

export function notice(text, bad = false) {
  const box = $("notice");
  box.textContent = text;
  box.className = bad ? "bad" : "";
  box.hidden = !text;
}

export async function send(action, more) {
  const answer = await command(action, more);
  if (!answer.ok) notice(answer.text, true);
  return answer.ok;
}

export function press(button, action, more, confirm) {
  if (confirm && !button.classList.contains("asking")) {
    const words = button.textContent;
    button.classList.add("asking");
    button.textContent = "Sure? Press again";
    const calm = () => { button.classList.remove("asking"); button.textContent = words; };
    button.calm = setTimeout(calm, SURE_MS);
    button.words = words;
    return;
  }
  if (confirm) { clearTimeout(button.calm); button.classList.remove("asking"); button.textContent = button.words; }
  send(action, more);
}

export function holdAll() {
  if (!model.mayCommand) { notice("Only looking: open the address with the token that was printed at the start.", true); return; }
  $("hold-all").classList.add("sent");
  setTimeout(() => $("hold-all").classList.remove("sent"), 400);
  send("hold", { robot: null });
}

export function setUp() {
  // On the way down, not up: a finger that slips off must still stop the robots.
  $("hold-all").addEventListener("pointerdown", (event) => { event.preventDefault(); holdAll(); });
  $("hold-all").addEventListener("keydown", (event) => { if (event.key === "Enter") holdAll(); });
  document.addEventListener("keydown", (event) => {
    const typing = event.target.matches("input, select, textarea") && event.target.type !== "radio";
    if (typing || event.repeat || event.ctrlKey || event.altKey || event.metaKey || !model.hello?.live) return;
    if (event.key === " " || event.key === "h" || event.key === "H") { event.preventDefault(); holdAll(); }
    if (event.key === "Escape" && area.drawing) finishArea(false);
  });
  for (const button of document.querySelectorAll("#commands [data-all]")) {
    button.addEventListener("click", () => press(button, button.dataset.all, { robot: null }, true));
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
function finishArea(wanted) {
  const corners = area.end();
  $("exclude").classList.remove("drawing");
  $("exclude").textContent = "Close an area";
  notice("");
  if (!wanted) return;
  if (corners.length < 3) { notice("An area needs three corners at least: nothing was closed.", true); return; }
  send("exclude", { area_m: corners });
}

function setUpPlayer() {
  let playing = false;
  const play = (on) => {
    playing = on;
    $("play").textContent = on ? "❚❚" : "▶";
    ask(on ? { kind: "play", rate: Number($("rate").value) } : { kind: "pause" });
  };
  $("play").addEventListener("click", () => play(!playing));
  $("rate").addEventListener("change", () => { if (playing) play(true); });
  $("slider").addEventListener("input", () => ask({ kind: "seek", t_s: Number($("slider").value) }));
}

export function showRights() {
  const live = Boolean(model.hello?.live);
  $("commands").hidden = !live;
  $("player").hidden = live || !model.hello;
  $("hold-all").hidden = !live;
  for (const button of document.querySelectorAll("#commands button")) button.disabled = !model.mayCommand;
  $("hold-all").disabled = !model.mayCommand;
}

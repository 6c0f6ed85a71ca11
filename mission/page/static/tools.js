// @ts-check
// Buttons on the map, and what a tap on a robot does.
import { $ } from "./dom.js";
import { taps } from "./map.js";
import { showWhole, zoomBy } from "./mapview.js";
import { measure } from "./measure.js";
import { model } from "./model.js";
import { notice } from "./commands.js";
import { showRobot } from "./panels.js";

const STEP = 1.6;

function turnMeasure() {
  measure.toggle();
  $("measure").setAttribute("aria-pressed", String(measure.on));
  $("map").classList.toggle("measuring", measure.on);
  notice(measure.on ? "Tap two places on the map: the distance and the bearing from the first to the second." : "");
  model.version.grids += 1;
}

export function setUpTools() {
  $("zoom-in").addEventListener("click", () => zoomBy(STEP));
  $("zoom-out").addEventListener("click", () => zoomBy(1 / STEP));
  $("zoom-whole").addEventListener("click", showWhole);
  $("measure").addEventListener("click", turnMeasure);
  document.addEventListener("keydown", (event) => { if (event.key === "Escape" && measure.on) turnMeasure(); });
  taps.onRobot = (robot) => showRobot(robot.name);
}

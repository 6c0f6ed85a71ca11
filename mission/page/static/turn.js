// @ts-check
// One turn round with the radio held in front: the body shields what is behind, and the server fits a bearing.
// The heading is the phone's compass where the browser gives it (over https, or on this machine), else the course walked.
import { notice, send } from "./commands.js";
import { $ } from "./dom.js";
import { model } from "./model.js";
/** @import { Command, FittedBearing } from "./protocol" */

const WORDS = { rest: "Turn for a bearing", turning: "Turned round", unsent: "Send the bearing again" };
/** @type {{ heard: [heading_deg: number, dbm: number][] | null, unsent: Command | null }} */
const turn = { heard: null, unsent: null };
/** @type {{ deg: number, at: number } | null} */
let compass = null;

window.addEventListener("deviceorientationabsolute", (event) => {
  if (event.alpha !== null) compass = { deg: (360 - event.alpha) % 360, at: performance.now() };
});

/** @param {number} course_deg */
export function headingNow(course_deg) {
  return compass && performance.now() - compass.at < 2000 ? compass.deg : course_deg;
}

/** @param {number} dbm @param {number} course_deg */
export function heardWhileTurning(dbm, course_deg) {
  if (turn.heard) turn.heard.push([headingNow(course_deg), dbm]);
  if (turn.heard) say(`Turn once round, slowly: heard ${turn.heard.length} times.`);
}

/** @param {string} text */
function say(text) { $("walk-bearing").textContent = text; $("walk-bearing").hidden = !text; }

/** @param {FittedBearing} found */
export function bearingWords(found) {
  if (found.bearing_deg === null || found.error_90_deg === null || found.why) return `No bearing: ${found.why}.`;
  return `Bearing ${Math.round(found.bearing_deg)}°, off by ${Math.round(found.error_90_deg)}° at most in 9 of 10 turns.`;
}

// What is refused, as where the position is too old, is kept for one more press: nobody turns round again for it.
/** @param {Command} order @param {boolean} isAgain */
async function writeDown(order, isAgain = false) {
  if (await send(order)) { if (isAgain) notice(""); return; }
  if (isAgain) return;
  turn.unsent = order;
  $("walk-turn").textContent = WORDS.unsent;
}

$("walk-turn").addEventListener("click", async () => {
  if (turn.unsent) {
    const order = turn.unsent;
    turn.unsent = null;
    $("walk-turn").textContent = WORDS.rest;
    await writeDown(order, true);
    return;
  }
  if (!turn.heard) {
    turn.heard = [];
    $("walk-turn").textContent = WORDS.turning;
    say("Turn once round, slowly; without a compass walk a small circle. Then press again.");
    return;
  }
  const heard = turn.heard.map(([heading, dbm]) => `${heading.toFixed(1)}:${dbm}`).join(",");
  turn.heard = null;
  $("walk-turn").textContent = WORDS.rest;
  if (!heard) { say("No bearing: nothing was heard in the turn."); return; }
  const answer = await fetch(`bearing?heard=${heard}`).catch(() => null);
  if (!answer?.ok) { say("No answer from the mission's computer."); return; }
  /** @type {FittedBearing} */
  const found = await answer.json();
  say(bearingWords(found));
  const { bearing_deg, error_90_deg, swing_db } = found; // written down as this person's word
  if (found.why || bearing_deg === null || error_90_deg === null || !model.mayCommand || !model.hello?.live) return;
  await writeDown({ action: "bearing", robot: $("walk-who", HTMLSelectElement).value, bearing_deg, error_90_deg, swing_db });
});

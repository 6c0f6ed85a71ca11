// @ts-check
// A tap on the map says where that is, in metres, degrees, UTM and MGRS; a tap on one of these copies it.
import { model } from "./model.js";
import { pin, taps } from "./map.js";
import { STATES, sureness } from "./words.js";
import { $, element } from "./dom.js";
/** @import { Where } from "./protocol" */

/** @type {[keyof Where, string][]} */
const NAMES = [["metres", "field"], ["lat_lon", "lat, lon"], ["utm", "UTM"], ["mgrs", "MGRS"]];
let asked = 0;

// Without https browsers keep the clipboard to themselves: then the old way.
/** @param {string} text */
export async function copy(text) {
  if (navigator.clipboard && window.isSecureContext) {
    try { await navigator.clipboard.writeText(text); return true; } catch { /* the old way may still do */ }
  }
  const box = element("textarea", { value: text, readOnly: true, className: "away" });
  document.body.append(box);
  box.select();
  let done = false;
  try { done = document.execCommand("copy"); } catch { done = false; }
  box.remove();
  return done;
}

/** @param {number} east_m @param {number} north_m @param {string} title */
export async function showWhere(east_m, north_m, title = "") {
  const mine = asked += 1;
  /** @type {Partial<Where> | null} */
  let words = null;
  try {
    const answer = await fetch(`where?east_m=${east_m.toFixed(3)}&north_m=${north_m.toFixed(3)}`);
    if (answer.ok) words = await answer.json();
  } catch { words = null; }
  if (!words && !model.hello?.live) words = { metres: `${east_m.toFixed(1)} m E, ${north_m.toFixed(1)} m N` };
  if (mine !== asked) return; // another tap has come
  const box = $("where");
  pin.at = [east_m, north_m];
  const rows = NAMES.flatMap(([key, name]) => {
    const text = words?.[key];
    if (!text) return [];
    const label = element("small", { textContent: name });
    const button = element("button", { title: "Tap to copy" }, label, element("span", { textContent: text }));
    button.dataset.form = key;
    button.addEventListener("click", async () => {
      const done = await copy(text);
      button.classList.toggle("copied", done);
      label.textContent = done ? "copied" : "copy it by hand";
    });
    return [button];
  });
  const close = element("button", { className: "close", textContent: "×", title: "Close" });
  close.setAttribute("aria-label", "Close");
  close.addEventListener("click", hideWhere);
  const said = words ? title : "No answer from the mission's computer.";
  box.replaceChildren(element("div", { className: "head" }, element("strong", { textContent: said || "Here" }), close), ...rows);
  box.hidden = false;
}

export function hideWhere() {
  asked += 1;
  pin.at = null;
  $("where").hidden = true;
}

export function setUpWhere() {
  taps.onPlace = (east, north) => { showWhere(east, north); };
  taps.onSource = (source) => {
    const sure = source.state === "candidate" ? `here with ${Math.round(100 * source.p)} %` : sureness(source);
    showWhere(source.east_m, source.north_m, `Source ${source.ident}: ${[STATES[source.state], sure].filter(Boolean).join(", ")}`);
  };
}

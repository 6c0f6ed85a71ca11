// @ts-check
// The recordings of a folder: a line each; one that is chosen opens on its own page.
import { $, element } from "./dom.js";
/** @import { Failed, OpenedRun, Run, Runs, UnreadRun } from "./protocol" */
/** @typedef {{ list: Runs, open: OpenedRun }} Answers */

const again = $("again", HTMLButtonElement);

/** @param {string} text */
function notice(text) { $("notice").textContent = text; $("notice").className = "bad"; $("notice").hidden = !text; }

/**
 * @template {keyof Answers} What
 * @param {What} what
 * @param {RequestInit} [options]
 * @returns {Promise<Answers[What] | null>}
 */
async function ask(what, options) {
  try {
    const answer = await fetch(`runs/${what}`, options);
    /** @type {Answers[What]} */
    const plain = await answer.json();
    if (answer.ok) { notice(""); return plain; }
    notice(/** @type {Failed} */ (/** @type {unknown} */ (plain)).error);
  } catch { notice("No answer: has 'fieldkit dashboard' ended?"); }
  return null;
}

/** @param {HTMLButtonElement} button @param {string} name */
async function open(button, name) {
  button.disabled = true;
  button.textContent = "reading …";
  const found = await ask("open", { method: "POST", body: JSON.stringify({ name }) });
  button.disabled = false;
  button.textContent = name;
  if (found) location.assign(found.address);
}

/** @param {number} s */
const lasted = (s) => (s < 3600 ? `${Math.floor(s / 60)} min ${Math.round(s % 60)} s` : `${Math.floor(s / 3600)} h ${Math.round((s % 3600) / 60)} min`);
/** @param {number} ns */
const begun = (ns) => new Date(ns / 1e6).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });

/** @param {string} word @param {string} text @param {string} className */
function cell(word, text, className = "") {
  const made = element("td", { className, textContent: text });
  if (word) made.dataset.word = word;
  return made;
}

/** @param {Run | UnreadRun} run */
function row(run) {
  const button = element("button", { className: "act", textContent: run.name });
  button.addEventListener("click", () => open(button, run.name));
  const name = element("td", {}, button);
  if ("error" in run) {
    button.disabled = true;
    const why = cell("", run.error, "bad");
    why.colSpan = 4;
    return element("tr", {}, cell("", ""), name, why);
  }
  const end = run.missing ? cell("", `NOT complete: ${run.missing}`, "bad") : cell("ended", run.ended);
  return element("tr", {},
    cell("", run.start_ns ? begun(run.start_ns) : "–"), name, cell("lasted", lasted(run.duration_s), "number"),
    cell("found", String(run.found ?? "–"), "number"), cell("readings", String(run.readings), "number"), end);
}

async function list() {
  again.disabled = true;
  const found = await ask("list");
  again.disabled = false;
  if (!found) return;
  $("folder").textContent = found.folder.split(/[\\/]/).at(-1) ?? "";
  $("folder").title = found.folder;
  $("rows").replaceChildren(...found.runs.map(row));
  $("none").textContent = found.runs.length ? `${found.unlisted} more are in ${found.folder}: name a folder in it.` : `There is no recording in ${found.folder}. A mission makes one: fieldkit run mission.toml`;
  $("none").hidden = found.runs.length > 0 && !found.unlisted;
}

again.addEventListener("click", list);
list();

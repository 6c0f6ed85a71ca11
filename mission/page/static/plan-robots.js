// @ts-check
// Robots as rows of a form: name, radio, vehicle. What a row does not show of them stays as it is.
import { $, element } from "./dom.js";
/** @import { Choices, FormRobot, Port } from "./protocol" */
/** @typedef {Record<string, unknown>} Options of a driver */

/** @type {Pick<Choices, "receivers" | "vehicles">} */
let choices = { receivers: [], vehicles: [] };
/** @type {Port[]} */
let ports = []; // plugged in, as asked for

/** @param {Choices} given */
export function setChoices(given) { choices = given; }
/** @param {Port[]} found */
export function setPorts(found) { ports = found; }

/** @param {unknown} value */
const shown = (value) => String(value ?? "");

/** @param {string} words @param {HTMLElement} input */
function field(words, input) { return element("label", {}, `${words} `, input); }

/** @param {string[]} names @param {string} value */
function chosen(names, value) {
  const box = element("select");
  box.replaceChildren(...[...new Set([...names, value].filter(Boolean))].map((name) => new Option(name, name, false, name === value)));
  return box;
}

/** @param {FormRobot} robot @param {FormRobot[]} others @param {() => void} changed */
function row(robot, others, changed) {
  /** @param {"receiver" | "vehicle"} part @param {string} key @param {string | number} value */
  const set = (part, key, value) => {
    const next = { ...robot[part] };
    if (value === "") delete next[key]; else next[key] = value;
    robot[part] = next;
    changed();
  };
  const name = element("input", { type: "text", value: robot.name });
  name.addEventListener("change", () => { robot.was = robot.was ?? robot.name; robot.name = name.value.trim(); changed(); });
  const radio = chosen(choices.receivers, shown(robot.receiver.driver));
  radio.addEventListener("change", () => set("receiver", "driver", radio.value));
  const list = element("datalist", { id: `ports-${robot.name}` }, ...ports.map((each) => new Option(each.what, each.port)));
  const port = element("input", { type: "text", value: shown(robot.receiver.port ?? robot.receiver.source) });
  port.setAttribute("list", list.id);
  port.addEventListener("change", () => set("receiver", "source" in robot.receiver || robot.receiver.driver === "lines" ? "source" : "port", port.value.trim()));
  const vehicle = chosen(choices.vehicles, shown(robot.vehicle.driver));
  vehicle.addEventListener("change", () => set("vehicle", "driver", vehicle.value));
  const address = element("input", { type: "text", value: shown(robot.vehicle.address) });
  address.addEventListener("change", () => set("vehicle", "address", address.value.trim()));
  const number = element("input", { type: "number", min: "1", max: "255", value: shown(robot.vehicle.system_id) });
  number.addEventListener("change", () => set("vehicle", "system_id", number.value === "" ? "" : Number(number.value)));
  const away = element("button", { className: "act", textContent: "Take away" });
  away.setAttribute("aria-label", `Take ${robot.name} away`);
  away.addEventListener("click", () => { others.splice(others.indexOf(robot), 1); changed(); });
  /** @type {[HTMLElement, string][]} */
  const keys = [[name, "name"], [radio, "receiver.driver"], [port, "receiver.port"], [vehicle, "vehicle.driver"], [address, "vehicle.address"], [number, "vehicle.system_id"]];
  for (const [input, key] of keys) input.dataset.key = `robot ${robot.name}: ${key}`;
  const part = element(
    "div", { className: "robot" },
    element("div", { className: "pair" }, field("Name", name), field("Radio", radio), field("Port", port), list),
    element("div", { className: "pair" }, field("Vehicle", vehicle), field("Link", address), field("System id", number)),
    element("div", { className: "acts" }, away),
  );
  part.dataset.robot = robot.name;
  return part;
}

/** @param {HTMLElement} box @param {FormRobot[]} robots @param {() => void} changed */
export function fillRobots(box, robots, changed) {
  const focus = document.activeElement instanceof HTMLElement ? document.activeElement.dataset.key : ""; // a row made anew keeps the cursor
  box.replaceChildren(...robots.map((robot) => row(robot, robots, changed)));
  if (!robots.length) box.append(element("p", { className: "hint", textContent: "No robot yet." }));
  const inputs = /** @type {NodeListOf<HTMLElement>} */ (box.querySelectorAll("[data-key]"));
  if (focus) [...inputs].find((each) => each.dataset.key === focus)?.focus();
}

/** @param {FormRobot[]} robots @param {Options} vehicle @param {Options} receiver @returns {FormRobot} */
export function newRobot(robots, vehicle = {}, receiver = {}) {
  const names = robots.map((robot) => robot.name);
  let number = robots.length + 1;
  while (names.includes(`r${number}`)) number += 1;
  const ids = robots.map((robot) => robot.vehicle.system_id);
  let id = 1;
  while (ids.includes(id)) id += 1;
  const used = robots.map((robot) => robot.receiver.port);
  const free = ports.map((each) => each.port).find((port) => !used.includes(port)) ?? "";
  return {
    name: `r${number}`,
    receiver: { driver: "xbee", port: free, ...receiver },
    vehicle: { driver: "mavlink", address: $("address", HTMLInputElement).value, system_id: id, ...vehicle },
    altitude_m: null,
  };
}

// Two by two in their order; teams that there are stay together.
/** @param {string[]} names @param {string[][]} teams */
export function paired(names, teams) {
  const kept = teams.map((team) => team.filter((name) => names.includes(name))).filter((team) => team.length);
  const rest = names.filter((name) => !kept.some((team) => team.includes(name)));
  for (const team of kept) if (team.length === 1) team.push(...rest.splice(0, 1));
  while (rest.length) kept.push(rest.splice(0, 2));
  return kept;
}

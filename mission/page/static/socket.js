// @ts-check
// The connection to the mission: comes back by itself; commands are answered or given up, never kept for later.
import { model, receive } from "./model.js";
/** @import { Answer, Asked, Command, Question, Sent } from "./protocol" */
/** @typedef {Pick<Answer, "ok" | "text">} Outcome of a command, answered or not */

const AGAIN_MS = 1000;
const OPENS_MS = 5000; // a phone that comes back into reach would else wait minutes for the attempt of before
const SILENT_MS = 10000; // frames come twice a second: the line may have died without a word
const WOKEN_MS = 2500; // the same for whoever has just unlocked a phone
const token = sessionToken();
/** @type {WebSocket | null} */
let socket = null;
let number = 0;
/** @type {Map<number | null, (outcome: Outcome) => void>} */
const waiting = new Map();

function sessionToken() {
  const given = location.hash.slice(1);
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname); // not in screenshots, not in the address bar
  }
  return given || sessionStorage.getItem("token") || "";
}

// False where it does not go: nothing is kept for later.
/** @param {Asked} message */
function send(message) {
  if (socket?.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(message));
  return true;
}

/** @param {(message: Sent) => void} onMessage @param {() => void} onState */
export function connect(onMessage, onState) {
  const line = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket = line;
  const begunAt = performance.now();
  /** @param {number} silent_ms */
  const isDead = (silent_ms) => {
    const opens = line.readyState === WebSocket.CONNECTING;
    const flies = model.hello?.live && model.frame && !model.frame.end;
    return performance.now() - Math.max(begunAt, opens ? 0 : model.heardAt) > (opens ? OPENS_MS : flies ? silent_ms : Infinity);
  };
  /** @param {number} after_ms */
  const again = (after_ms) => {
    clearInterval(watching);
    for (const event of ["online", "visibilitychange"]) removeEventListener(event, woken, true);
    line.onopen = line.onmessage = line.onclose = null; // a dead line says so minutes later
    line.close();
    model.connected = false;
    for (const settle of waiting.values()) settle({ ok: false, text: "the connection was lost" });
    waiting.clear();
    onState();
    setTimeout(() => connect(onMessage, onState), after_ms);
  };
  const woken = () => { if (!document.hidden && isDead(WOKEN_MS)) again(0); };
  const watching = setInterval(() => { if (isDead(SILENT_MS)) again(0); }, AGAIN_MS);
  for (const event of ["online", "visibilitychange"]) addEventListener(event, woken, true);
  line.onopen = () => {
    model.connected = true;
    if (token) send({ kind: "token", token });
    onState();
  };
  line.onmessage = (event) => {
    /** @type {Sent} */
    const message = JSON.parse(event.data);
    if (message.kind === "answer") {
      const settle = waiting.get(message.number);
      waiting.delete(message.number);
      if (settle) settle(message);
      return;
    }
    receive(message);
    onMessage(message);
  };
  line.onclose = () => again(AGAIN_MS);
}

/** @param {Question} question */
export function ask(question) { send(question); }

/** @param {Command} order @returns {Promise<Outcome>} */
export function command(order) {
  number += 1;
  const mine = number;
  if (!send({ kind: "command", number: mine, ...order })) {
    return Promise.resolve({ ok: false, text: "not connected: the command was NOT sent" });
  }
  return new Promise((settle) => {
    waiting.set(mine, settle);
    setTimeout(() => {
      if (waiting.delete(mine)) settle({ ok: false, text: `no answer to "${order.action}": use the remote control` });
    }, 3000);
  });
}

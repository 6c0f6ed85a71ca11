// @ts-check
// The connection to the mission: comes back by itself; commands are answered or given up, never kept for later.
import { model, receive } from "./model.js";
/** @import { Answer, Asked, Command, Question, Sent } from "./protocol" */
/** @typedef {Pick<Answer, "ok" | "text">} Outcome of a command, answered or not */

const token = sessionToken();
/** @type {WebSocket | null} */
let socket = null;
let number = 0;
/** @type {Map<number | null, (outcome: Outcome) => void>} */
const waiting = new Map();

function sessionToken() {
  const given = decodeURIComponent(location.hash.slice(1));
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
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.onopen = () => {
    model.connected = true;
    if (token) send({ kind: "token", token });
    onState();
  };
  socket.onmessage = (event) => {
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
  socket.onclose = () => {
    model.connected = false;
    for (const settle of waiting.values()) settle({ ok: false, text: "the connection was lost" });
    waiting.clear();
    onState();
    setTimeout(() => connect(onMessage, onState), 1000);
  };
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

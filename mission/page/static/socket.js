// The connection to the mission: comes back by itself; commands are answered or given up, never kept for later.
import { model, receive } from "./model.js";

const token = sessionToken();
let socket = null;
let number = 0;
const waiting = new Map();

function sessionToken() {
  const given = decodeURIComponent(location.hash.slice(1));
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname); // not in screenshots, not in the address bar
  }
  return given || sessionStorage.getItem("token") || "";
}

export function connect(onMessage, onState) {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.onopen = () => {
    model.connected = true;
    if (token) socket.send(JSON.stringify({ kind: "token", token }));
    onState();
  };
  socket.onmessage = (event) => {
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

export function ask(message) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

export function command(action, more = {}) {
  if (!socket || socket.readyState !== WebSocket.OPEN) {
    return Promise.resolve({ ok: false, text: "not connected: the command was NOT sent" });
  }
  number += 1;
  const mine = number;
  socket.send(JSON.stringify({ kind: "command", number: mine, action, ...more }));
  return new Promise((settle) => {
    waiting.set(mine, settle);
    setTimeout(() => {
      if (waiting.delete(mine)) settle({ ok: false, text: `no answer to "${action}": use the remote control` });
    }, 3000);
  });
}

// @ts-check
// A tone when a robot needs the operator, when a stop is not shown, and when something is found. Off until switched on.
import { $ } from "./dom.js";
import { model } from "./model.js";

/** @type {AudioContext | null} */
let sound = null;
/** @type {{ calls: Set<string>, finds: Set<number> } | null} */
let known = null; // what has been sounded for already

/** @param {number} from_hz @param {number} to_hz @param {number} at_s @param {number} long_s */
function tone(from_hz, to_hz, at_s, long_s) {
  if (!sound) return;
  const wave = sound.createOscillator();
  const volume = sound.createGain();
  const start = sound.currentTime + at_s;
  wave.frequency.setValueAtTime(from_hz, start);
  wave.frequency.linearRampToValueAtTime(to_hz, start + long_s);
  volume.gain.setValueAtTime(0.3, start);
  volume.gain.exponentialRampToValueAtTime(0.001, start + long_s);
  wave.connect(volume).connect(sound.destination);
  wave.start(start);
  wave.stop(start + long_s);
}
const ALARM = () => [0, 0.25, 0.5].forEach((at_s) => tone(880, 660, at_s, 0.2));
const FIND = () => [[523, 0], [659, 0.12], [784, 0.24]].forEach(([hz, at_s]) => tone(hz, hz, at_s, 0.3));

export function listen() {
  const frame = model.frame;
  if (!frame) return;
  const now = {
    calls: new Set([...frame.robots.filter((robot) => robot.call).map((robot) => robot.name), ...frame.alarms]),
    finds: new Set(frame.sources.filter((source) => source.state === "found").map((source) => source.ident)),
  };
  const before = known;
  known = now;
  if (!before || !sound) return;
  if ([...now.calls].some((each) => !before.calls.has(each))) ALARM();
  else if ([...now.finds].some((each) => !before.finds.has(each))) FIND();
}

export function setUpSound() {
  $("alarm-sound").addEventListener("click", () => {
    if (sound) { sound.close(); sound = null; } else { sound = new AudioContext(); FIND(); }
    $("alarm-sound").textContent = sound ? "Sound on" : "Sound off";
    $("alarm-sound").setAttribute("aria-pressed", String(Boolean(sound)));
  });
}

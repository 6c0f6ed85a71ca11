// @ts-check
// What the page knows. Every list is bounded: a mission of a day must not fill a phone.
/** @import { Frame, Grid, Heard, LiveHello, Note, PastHello, Point, Robot, Sent } from "./protocol" */
/** @import { Place } from "./mapview.js" */
/** @typedef {Omit<Grid, "data"> & { cells: Uint8Array }} Cells a grid unpacked */
/** @typedef {Heard & { seenAt?: number }} Reception with when it came, where it came just now */
/** @typedef {[t_s: number, east_m: number, north_m: number]} TrackPoint */
/** @typedef {{ frame: Frame, grids: Record<string, Cells> }} Moment */
/** @typedef {{ [Kind in Sent["kind"]]?: (message: Extract<Sent, { kind: Kind }>) => void }} Takers */
/**
 * @typedef {object} Model
 * @property {LiveHello | PastHello | null} hello
 * @property {Frame | null} frame
 * @property {Record<string, Cells>} grids
 * @property {Record<string, TrackPoint[]>} tracks
 * @property {Point[]} series
 * @property {Reception[]} detections
 * @property {Note[]} notes
 * @property {Moment | null} past a moment looked back at
 * @property {boolean} mayCommand
 * @property {boolean} connected
 * @property {number} heardAt
 * @property {{ side: number, grids: number }} version
 */
export const MOST = { track: 1500, series: 600, detections: 120, notes: 250 };

/** @type {Model} */
export const model = {
  hello: null, frame: null, grids: {}, tracks: {}, series: [], detections: [], notes: [], past: null,
  mayCommand: false, connected: false, heardAt: 0, version: { side: 0, grids: 0 },
};

/** Of robots: those that fly are still on their way home when the mission has ended. */
export const maySteer = () => model.mayCommand && !model.frame?.over;
export const mayChange = () => model.mayCommand && !model.frame?.end;

export const shownFrame = () => model.past?.frame ?? model.frame;
/** @type {(name: string) => Cells | undefined} */
export const shownGrid = (name) => (model.past ?? model).grids[name];

/** @type {(robot: Robot) => Place | null} */
export const placeOf = ({ east_m, north_m }) => (east_m === null || north_m === null ? null : [east_m, north_m]);

/** @param {Robot} robot */
export const isOld = (robot) => (robot.pose_age_s ?? 0) > (model.hello?.pose_timeout_s ?? Infinity);

// Colours that differ for colour-blind eyes and on both grounds (after Okabe and Ito), then turns of the wheel.
const WHEEL = ["#56b4e9", "#e69f00", "#cc79a7", "#0fb68a", "#f0e442", "#d55e00", "#8c7ae6", "#4a90d9"];
/** @param {string} name */
export function colourOf(name) {
  const index = model.hello ? model.hello.robots.findIndex((robot) => robot.name === name) : 0;
  return index < WHEEL.length ? WHEEL[Math.max(0, index)] : `hsl(${(index * 47) % 360} 65% 60%)`;
}

// Drop every second of the older ones, as the server does it.
/** @template T @param {T[]} rows @param {number} most */
function thin(rows, most) {
  if (rows.length <= most) return;
  const older = Math.floor(rows.length * 0.75);
  const kept = rows.filter((_, index) => index >= older || index % 2 === 0);
  rows.splice(0, rows.length, ...kept);
}
/** @template T @param {T[]} rows @param {number} most */
function bounded(rows, most) { if (rows.length > most) rows.splice(0, rows.length - most); }

/** @param {Grid} grid @returns {Cells} */
function unpacked({ data, ...grid }) {
  const raw = atob(data);
  const cells = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i += 1) cells[i] = raw.charCodeAt(i);
  return { ...grid, cells };
}

/** @type {Takers} */
const take = {
  hello(message) {
    const same = JSON.stringify(message) === JSON.stringify(model.hello);
    model.hello = message;
    if (same) return; // on the line again: what is known holds until the history comes
    model.frame = null;
    model.tracks = Object.fromEntries(message.robots.map((robot) => [robot.name, []]));
    model.series = []; model.detections = []; model.notes = []; model.grids = {};
  },
  rights(message) { model.mayCommand = message.may_command; },
  history(message) {
    Object.assign(model.tracks, message.tracks);
    model.series = message.series;
    model.detections = message.detections.slice(-MOST.detections);
    model.notes = message.notes.slice(-MOST.notes);
    model.version.side += 1;
  },
  grid(message) {
    model.grids[message.name] = unpacked(message);
    model.version.grids += 1;
  },
  past(message) {
    model.past = { frame: message.frame, grids: Object.fromEntries(message.grids.map((grid) => [grid.name, unpacked(grid)])) };
    model.version.side += 1;
  },
  frame(message) {
    model.frame = message;
    for (const robot of message.robots) {
      const place = placeOf(robot);
      if (!place) continue;
      const track = model.tracks[robot.name] ?? (model.tracks[robot.name] = []);
      const last = track[track.length - 1];
      if (last && Math.hypot(last[1] - place[0], last[2] - place[1]) < 0.05) continue;
      track.push([message.t_s, ...place]);
      thin(track, MOST.track);
    }
    model.version.side += 1;
  },
  news(message) {
    if (message.detection) {
      model.detections.push({ ...message.detection, seenAt: performance.now() });
      bounded(model.detections, MOST.detections);
    }
    if (message.note) { model.notes.push(message.note); bounded(model.notes, MOST.notes); }
    if (message.point) { model.series.push(message.point); thin(model.series, MOST.series); }
    model.version.side += 1;
  },
};

/** @param {Sent} message */
export function receive(message) {
  // These are the server's own words: it answers while the mission is silent too.
  if (message.kind !== "hello" && message.kind !== "rights" && message.kind !== "past") model.heardAt = performance.now();
  const how = /** @type {((message: Sent) => void) | undefined} */ (take[message.kind]);
  how?.(message);
}

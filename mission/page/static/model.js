// What the page knows. Every list is bounded: a mission of a day must not fill a phone.
export const MOST = { track: 1500, series: 600, detections: 120, notes: 250 };

export const model = {
  hello: null, frame: null, grids: {}, tracks: {}, series: [], detections: [], notes: [],
  past: null, // a moment looked back at: its frame and grids
  mayCommand: false, connected: false, heardAt: 0, version: { side: 0, grids: 0 },
};

export const shownFrame = () => model.past?.frame ?? model.frame;
export const shownGrid = (name) => (model.past ? model.past.grids[name] : model.grids[name]);

// Colours that differ for colour-blind eyes and on both grounds (after Okabe and Ito), then turns of the wheel.
const WHEEL = ["#56b4e9", "#e69f00", "#cc79a7", "#0fb68a", "#f0e442", "#d55e00", "#8c7ae6", "#4a90d9"];
export function colourOf(name) {
  const index = model.hello ? model.hello.robots.findIndex((robot) => robot.name === name) : 0;
  return index < WHEEL.length ? WHEEL[Math.max(0, index)] : `hsl(${(index * 47) % 360} 65% 60%)`;
}

function thin(rows, most) { // Drop every second of the older ones, as the server does it.
  if (rows.length <= most) return;
  const older = Math.floor(rows.length * 0.75);
  const kept = rows.filter((_, index) => index >= older || index % 2 === 0);
  rows.splice(0, rows.length, ...kept);
}
function bounded(rows, most) { if (rows.length > most) rows.splice(0, rows.length - most); }

function unpacked(grid) {
  const raw = atob(grid.data);
  const cells = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i += 1) cells[i] = raw.charCodeAt(i);
  return { ...grid, data: null, cells };
}

const take = {
  hello(message) {
    model.hello = message;
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
      if (robot.east_m === null) continue;
      const track = model.tracks[robot.name] ?? (model.tracks[robot.name] = []);
      const last = track[track.length - 1];
      if (last && Math.hypot(last[1] - robot.east_m, last[2] - robot.north_m) < 0.05) continue;
      track.push([message.t_s, robot.east_m, robot.north_m]);
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

export function receive(message) {
  model.heardAt = performance.now();
  const how = take[message.kind];
  if (how) how(message);
}

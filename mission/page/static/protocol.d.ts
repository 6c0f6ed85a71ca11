// Made by 'make protocol' from mission/page/protocol.py, mission/page/commands.py, mission/plan/protocol.py: change those.

/** What became of a command. */
export interface Answer {
  kind: "answer";
  /** The command's own; null where it had none. */
  number: number | null;
  ok: boolean;
  /** Why it is refused. */
  text: string;
}

/** Those of [antenna]. */
export interface AntennaForm {
  file: string | null;
}

/** All of them, and whom they are owed to. */
export interface BackgroundShown {
  credit: string;
  pictures: PictureShown[];
}

/** One check before the start. */
export interface CheckShown {
  robot: string;
  name: string;
  level: "green" | "amber" | "red";
  found: string;
  remedy: string;
}

/** What there is to choose from: drivers, and files beside the mission file. */
export interface Choices {
  receivers: string[];
  vehicles: string[];
  antennas: string[];
  pictures: string[];
}

/** The answer of /plan/state, /plan/change and /plan/store. */
export interface Draft {
  path: string;
  form: Form;
  text: string;
  remarks: RemarkShown[];
  stored: boolean;
  new: boolean;
  /** As last heard; empty where the field's corner is not known. */
  standing: Standing[];
  /** With /plan/state only. */
  choices?: Choices;
}

/** The end of the whole mission. */
export interface End {
  action: "end";
  robot?: null;
}

/** Those of [end]. */
export interface EndForm {
  max_duration_s: number | null;
  sources_found: number | null;
}

/** An area that is closed to all robots. */
export interface Exclude {
  action: "exclude";
  area_m: [number, number][];
}

/** Any answer, where it is refused. */
export interface Failed {
  error: string;
}

/** Those of [field]. */
export interface FieldForm {
  origin_lat_deg: number | null;
  origin_lon_deg: number | null;
  size_east_m: number | null;
  size_north_m: number | null;
  cell_m: number | null;
  fence: [number, number][] | null;
  keep_out: [number, number][][] | null;
  background: string | null;
}

/** The field, from its south-west corner. */
export interface FieldShape {
  east_m: number;
  north_m: number;
  fence_m: [number, number][];
  /** Robots stay so far inside the fence. */
  margin_m: number;
}

/** The answer of /bearing: what one turn round says. */
export interface FittedBearing {
  bearing_deg: number | null;
  error_90_deg: number | null;
  swing_db: number;
  /** Why there is no bearing; empty where there is one. */
  why: string;
}

/** All that the form shows; null where the file does not say it. */
export interface Form {
  top: TopForm;
  field: FieldForm;
  antenna: AntennaForm;
  sources: SourcesForm;
  end: EndForm;
  safety: SafetyForm;
  robots: FormRobot[];
  teams: string[][];
}

/** A [[robot]]. */
export interface FormRobot {
  name: string;
  /** Its name in the file, where it has been renamed. */
  was?: string;
  /** The driver and its options. */
  receiver: { [key: string]: unknown };
  vehicle: { [key: string]: unknown };
  altitude_m: number | null;
}

/** The present, or one moment of a recording. */
export interface Frame {
  kind: "frame";
  t_s: number;
  /** Probability that a source is not found yet. */
  left: number;
  detections: number;
  /** How the mission ended; empty while it runs. */
  end: string;
  robots: Robot[];
  sources: Source[];
  /** Closed to all robots. */
  areas_m: [number, number][][];
  marks: MarkedPlace[];
  /** What the operator must know at once. */
  alarms: string[];
  /** Live only, as the next three. */
  viewers?: number;
  commanders?: number;
  /** Whether nobody is steered any more. Robots that fly still go home and land when the mission has ended. */
  over?: boolean;
  /** How large it is, and how much room is left. */
  recording?: string;
}

/** A number for each cell of the field: a byte each, row 0 south, from the west. */
export interface Grid {
  kind: "grid";
  name: "belief" | "exposure";
  n_east: number;
  n_north: number;
  cell_m: number;
  /** What byte 255 stands for; a byte is the square root of the share of it. */
  largest: number;
  /** The bytes in base64. */
  data: string;
}

/** A grid of a recording, and when it came. */
export interface GridAt {
  t_s: number;
  name: "belief" | "exposure";
  grid: Grid;
}

/** A transmission as the team heard it. */
export interface Heard {
  t_s: number;
  heard_dbm: { [key: string]: number };
  listening: string[];
}

/** One of the answer of /plan/heard. */
export interface HeardVehicle {
  system_id: number;
  firmware: string;
  mode: string;
  armed: boolean;
  battery_pct: number | null;
  heartbeats: number;
  has_position: boolean;
  /** Latitude and longitude. */
  place_deg: [number, number] | null;
  address: string;
  two_with_this_id: boolean;
  texts: string[];
}

/** What has been, for a browser that has just come or goes to another time. */
export interface History {
  tracks: { [key: string]: [number, number, number][] };
  series: Point[];
  detections: Heard[];
  notes: Note[];
  kind: "history";
}

/** What does not change, of a mission under way. It comes first. */
export interface LiveHello {
  kind: "hello";
  mission: string;
  field: FieldShape;
  robots: Member[];
  pose_timeout_s: number;
  background: BackgroundShown | null;
  files: [string, string][];
  live: true;
  ends: "mission" | "agent" | "page";
}

/** How was it at that time? Of a mission under way. */
export interface Look {
  kind: "look";
  t_s: number;
}

/** A person says that a transmitter is where they stand. */
export interface Mark {
  action: "mark";
  robot: string;
}

/** A person's word that a transmitter is there. */
export interface MarkedPlace {
  by: string;
  east_m: number;
  north_m: number;
}

/** One robot of the team. */
export interface Member {
  name: string;
  team: number;
  /** It is a person. */
  on_foot: boolean;
}

/** One thing that has happened; one of the three is there. */
export interface News {
  kind: "news";
  detection?: Heard;
  note?: Note;
  point?: Point;
}

/** A line of the log. */
export interface Note {
  t_s: number;
  level: string;
  text: string;
}

/** Goes with every command: its answer has the same number. */
export interface Numbered {
  kind: "command";
  number: number;
}

/** The answer of /runs/open: where its page is. */
export interface OpenedRun {
  address: string;
}

/** A moment looked back at while the mission goes on. */
export interface Past {
  kind: "past";
  frame: Frame;
  grids: Grid[];
}

/** What does not change, of a recording. It comes first. */
export interface PastHello {
  kind: "hello";
  mission: string;
  field: FieldShape;
  robots: Member[];
  pose_timeout_s: number;
  background: BackgroundShown | null;
  files: [string, string][];
  live: false;
  duration_s: number;
}

/** Play no further. */
export interface Pause {
  kind: "pause";
}

/** A picture as the page is sent it. */
export interface PictureShown {
  url: string;
  /** (east, north) of its upper left, upper right and lower left corner. */
  corners_m: [[number, number], [number, number], [number, number]];
}

/** Play a recording from where it is, so many times as fast as it was. */
export interface Play {
  kind: "play";
  rate: number;
}

/** Probabilities at one time. */
export interface Point {
  t_s: number;
  left: number;
  /** Of each source, by its number. */
  p: { [key: string]: number };
}

/** One of the answer of /plan/ports. */
export interface Port {
  port: string;
  what: string;
  advice: string[];
  settings: { [key: string]: string };
  /** Whether the port is there, and what is on it was recognised. */
  answered: boolean;
}

/** The answer of /plan/preflight. */
export interface Preflight {
  verdict: "green" | "amber" | "red";
  checks: CheckShown[];
}

/** A recording inside a report's page. */
export interface Recorded {
  tracks: { [key: string]: [number, number, number][] };
  series: Point[];
  detections: Heard[];
  notes: Note[];
  hello: PastHello;
  frames: Frame[];
  grids: GridAt[];
}

/** One thing to say of a draft. */
export interface RemarkShown {
  /** Red: it cannot be flown so; amber: it can, but. */
  level: "red" | "amber";
  /** As in the file: "field.cell_m"; empty where it is about the whole. */
  key: string;
  text: string;
}

/** A transmitter that has been taken away. */
export interface Remove {
  action: "remove";
  source: number;
}

/** What a browser may do, once it has shown a token. */
export interface Rights {
  kind: "rights";
  may_command: boolean;
  wrong_token: boolean;
}

/** One robot now. */
export interface Robot {
  name: string;
  east_m: number | null;
  north_m: number | null;
  /** Clockwise from north. */
  heading_deg: number | null;
  pose_age_s: number | null;
  link_age_s: number | null;
  link_up: boolean;
  mode: "guided" | "hold" | "return" | "land" | "other" | "unknown";
  armed: boolean;
  battery_pct: number | null;
  /** It goes home at this. */
  reserve_pct: number;
  /** To the fence; negative outside. */
  fence_m: number | null;
  /** The vehicle's own last words. */
  text: string;
  radio_up: boolean;
  /** What its receiver says of being down: whoever carries it can mend that. */
  radio_why: string;
  /** A standing order of the operator's, or safety's "withdraw". */
  ordered: string;
  /** Why it needs the operator. */
  call: string;
  /** What the planner wants with its path. */
  doing: string;
  /** The last one, and in `why` where to or why. */
  command: "" | "go to" | "hold" | "return";
  why: string;
  /** Of the vehicle to it. */
  answer: string;
  path_m: [number, number][];
  target_m: [number, number] | null;
}

/** A recording in a folder. */
export interface Run {
  name: string;
  start_ns: number | null;
  duration_s: number;
  bytes: number;
  readings: number;
  /** Sources; null where it does not say. */
  found: number | null;
  /** How; empty where it does not say. */
  ended: string;
  /** What of it is; empty where it is complete. */
  missing: string;
}

/** The answer of /runs/list, the newest first. */
export interface Runs {
  folder: string;
  runs: (Run | UnreadRun)[];
  /** So many more are there. */
  unlisted: number;
}

/** Those of [safety]. */
export interface SafetyForm {
  max_speed_m_s: number | null;
  min_separation_m: number | null;
  fence_margin_m: number | null;
  battery_reserve_pct: number | null;
}

/** Go to that time of a recording. */
export interface Seek {
  kind: "seek";
  t_s: number;
}

/** What is believed of one source. */
export interface Source {
  ident: number;
  state: "candidate" | "found" | "inconsistent" | "outside" | "removed";
  east_m: number;
  north_m: number;
  /** Of its 90 % ellipse, the longer first. */
  half_axes_m: [number | null, number | null];
  /** Of the longer one, counter-clockwise from east. */
  turn_deg: number;
  /** Probability that it is within the distance of a find from here. */
  p: number;
  receptions: number;
  power_db: number | null;
  rate_hz: number | null;
  note: string;
}

/** Those of [sources]. */
export interface SourcesForm {
  rate_hz: number | null;
  expected: number | null;
}

/** A vehicle that was heard, where it stands in the draft's field. */
export interface Standing {
  name: string;
  place: [number, number];
}

/** Orders for one robot, or for all where `robot` is None. */
export interface Steer {
  action: "hold" | "resume" | "return" | "release";
  robot?: string | null;
}

/** A person has turned round with the radio in front. */
export interface TakenBearing {
  action: "bearing";
  robot: string;
  bearing_deg: number;
  error_90_deg: number;
  swing_db: number;
}

/** Asks for the right to command. */
export interface Token {
  kind: "token";
  token: string;
}

/** The keys at the file's top that the form has. */
export interface TopForm {
  name: string | null;
}

/** One that cannot be read. */
export interface UnreadRun {
  name: string;
  error: string;
}

/** The answer of /where: one place in other words, as text to copy. */
export interface Where {
  metres: string;
  lat_lon: string;
  utm: string;
  mgrs: string;
}

export type Sent = LiveHello | PastHello | Rights | Answer | Frame | Grid | History | News | Past;

export type Question = Look | Seek | Play | Pause;

export type Command = Steer | End | Remove | Mark | TakenBearing | Exclude;

/** A command as it is sent. */
export type Order = Numbered & Command;

/** Whatever goes over the websocket to the server. */
export type Asked = Token | Question | Order;

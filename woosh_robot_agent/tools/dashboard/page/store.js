// The state of the page: what the dashboard has sent, and what the viewer has chosen.

import { batch, computed, effect, signal } from "./vendor/preact.js";

/** @typedef {{x: number, y: number}} Point  a place on the map, in metres */
/** @typedef {{x: number, y: number, theta: number}} Pose  in metres and radians */
/**
 * @typedef {Pose & {linear: number, angular: number, doubt: Objection | null}} Motion  in m/s and rad/s;
 *   doubt: why the pose may be wrong
 */
/** @typedef {{name: string, reason: string, remedy: string}} Objection  why a robot takes no task */
/** @typedef {{code: string, level: string, text: string, meaning: string}} Code  a status code of a robot */
/** @typedef {Pose & {number: string, text: string, type: string}} Mark  with the pose of a robot at it */
/** @typedef {{kind: string, outline: number[][], speed: number}} Zone  in metres and m/s; 0 for no limit */
/**
 * @typedef {object} Robot
 * @property {boolean} known true if the robot has reported its state
 * @property {number} id
 * @property {string} name
 * @property {string} model
 * @property {string} scene
 * @property {string} map
 * @property {string} version of the map
 * @property {string} state what it does, e.g. `idle`
 * @property {string | null} control mode: `auto`, `manual` or `maintain`
 * @property {string | null} work mode: `task`, `deploy` or `schedule`
 * @property {boolean | null} taskable true if the robot says that it takes tasks; null if it says nothing
 * @property {Objection[]} objections why it takes no task, the most important first
 * @property {Battery | null} battery
 * @property {RunningTask | null} task
 * @property {{name: string, state: string, text: import("./texts.js").Value}[]} actions
 * @property {Code[]} problems status codes that hold now
 * @property {{mute: boolean, volume: number} | null} sound
 * @property {boolean} light true if it has one
 */
/**
 * @typedef {{power: number, charging: boolean, temperature: number, cycles: number,
 *   low: number}} Battery  in percent and °C; low: power at which it counts as low, 0 if unknown
 */
/**
 * @typedef {{id: string, type: string, to: string, state: string, running: boolean, text: string,
 *   action: string, actionState: string}} RunningTask  running: true until its end, also while paused
 */
/**
 * @typedef {object} Task
 * @property {string} id
 * @property {string} type
 * @property {string} to number of the mark where the task goes, may be empty
 * @property {[number, number] | null} place where the robot goes, in metres, if that is known
 * @property {string} state
 * @property {boolean} running true until its end, also while it is paused
 * @property {string} text from the robot
 * @property {Code | null} code reason of a failure, if known
 * @property {string} scene empty if it is not known on which map the task is
 * @property {string} map
 * @property {string} version of this map
 * @property {number} begun Unix time in milliseconds; 0 if its start was not seen
 * @property {number} changed Unix time in ms of the last change of state, 0 before the first report
 * @property {string} by name of the viewer or of another source, empty if unknown
 * @property {{name?: string, args?: Record<string, any>}} command that gave the task, empty if no page gave it
 */
/**
 * @typedef {object} Area the map, as far as it is known
 * @property {number} number of the picture, another one for each picture
 * @property {import("./texts.js").Value} error why the map, or a part of it, cannot be shown; may be empty
 * @property {string} [scene]
 * @property {string} [name]
 * @property {string} [version] another one after each change of the map
 * @property {number} [resolution] metres per pixel; absent without a picture
 * @property {Pose} [origin] of the picture's lower left corner
 * @property {boolean} [keepout] true if there is a picture of the keep-out areas
 * @property {Mark[]} [marks]
 * @property {Zone[]} [zones]
 * @property {number[][][]} [lanes] the points of each lane, in metres
 * @property {{type: string, number: number, name: string}[]} [taskTypes]
 */
/**
 * @typedef {object} Control
 * @property {string | null} owner name of the viewer that has control
 * @property {{linear: number, angular: number}} limits of the stick, in m/s and rad/s
 * @property {number} maximum of the stick without a speed limit, in m/s
 * @property {number | null} speedLimit in m/s
 * @property {import("./texts.js").Value} speedRefusal why the robot has not taken the limit; may be empty
 * @property {{name: import("./texts.js").Value, detail: import("./texts.js").Value}} driver what drives the robot
 * @property {import("./texts.js").Value} standstill why it stands despite a command; empty otherwise
 */
/**
 * @typedef {{good: boolean, state: string, since: number, silence: number, error: import("./texts.js").Value,
 *   advice: string, delay: number | null}} Link  since, delay: ms; silence: s; advice: options of doctor
 */
/**
 * @typedef {object} Card a robot in the list of all robots
 * @property {string} address
 * @property {string} link as in `Link`, the state
 * @property {number} silence seconds for which it has sent nothing
 * @property {boolean} known
 * @property {number} id
 * @property {string} name
 * @property {string} state
 * @property {Objection | null} objection why it takes no tasks
 * @property {boolean} moves
 * @property {number} problems how many status codes hold now
 * @property {string} level of the worst of them
 * @property {Battery | null} battery
 * @property {Task | null} task the one that runs
 * @property {Order | null} order
 * @property {import("./texts.js").Value} alarm why it may move after a stop; empty without an alarm
 * @property {number | null} speedLimit
 */
/**
 * @typedef {{id: string, node: string, nodesLeft: number, paused: boolean, errors: {type: string,
 *   level: string, text: import("./texts.js").Value}[]}} Order  of a fleet manager, in VDA 5050
 */
/** @typedef {Pose & {index: number, name: string, scene: string, map: string, outline: number[][]}} PlacedRobot */
/** @typedef {{id: string, name: string, text: string, x?: number, y?: number, radius?: number}} Fault */
/**
 * @typedef {{known: {name: string, description: import("./texts.js").Value, arguments: string}[],
 *   faults: Fault[]}} Simulator  known: all that can be begun; faults: those that hold now
 */
/** @typedef {{pose: Pose, points: Float32Array}} Scan  x, y of each point in the frame of the robot */
/**
 * @typedef {object} Target the mark or pose to which the viewer may send the robot
 * @property {"go" | "goMark" | "charge"} command
 * @property {string} [mark]
 * @property {Pose} [pose]
 * @property {{path: number[][], length: number} | {error: import("./texts.js").Value} | null} plan null until the answer
 * @property {TaskKind} [kind] what the earlier task did there, if the viewer repeats one
 * @property {Point | null} [from] where the robot was when the path was requested
 */
/** @typedef {{type: string, number: number, direction: string}} TaskKind */
/**
 * @typedef {{ok: boolean, text: import("./texts.js").Text, time: number, robot: string,
 *   task?: string}} Answer  robot: its address; task: id of an accepted task
 */
/**
 * @typedef {object} Grip
 * @property {number} id of the pointer
 * @property {Point} start where it went down, in pixels
 * @property {string} place of the stick at that time, as in `stickPlace`
 * @property {number} right how far right of the start it is, as a fraction of the stick's radius
 * @property {number} up how far above the start
 */

/** Commands that give a task. */
export const TASK_COMMANDS = ["go", "goMark", "charge"];
const SLOW = 1 / 3; // share of the limits to which a slow stick drives
/** Objections of a robot that does not know where it is. */
export const LOST = ["lost", "not_initialised"];
const AHEAD = 1; // metres of the path, from where the robot was on it, on which it is searched first
const BESIDE = 0.5; // metres beside the path beyond which the robot is searched on the whole path
const AT_GOAL = 2; // metres that the path may end before a goal at which the robot docks
const DEAD_ZONE = 0.12; // fraction of the stick's radius within which it does not drive
/** @type {Record<string, [number, number]>} directions of the stick, right and up, by the code of the key */
export const KEY_DIRECTIONS = {
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
};

/**
 * Return a signal for values of the type that its first value is declared with, e.g. `Task | null`.
 * @template T
 * @param {T} value
 * @returns {import("@preact/signals").Signal<T>}
 */
const state = (value) => signal(value);

// Of the dashboard

/** Name of this viewer; empty until the dashboard has told it. */
export const you = state("");
let clockOffset = performance.timeOrigin; // Unix time of the dashboard minus `performance.now()`, in ms

/** Return the Unix time of the dashboard, in milliseconds; the clock of the browser may be wrong. */
export const now = () => performance.now() + clockOffset;

/** True if this viewer may command the robots. */
export const mayControl = state(false);
/** True once the dashboard has taken this permission away, until it gives it back. */
export const lostControl = state(false);
/** Addresses of the robots. */
export const robots = state(/** @type {string[]} */ ([]));
/** Cards of the robots, in the order of `robots`; empty until they have come. */
export const fleet = state(/** @type {Card[]} */ ([]));
/** All robots that know their place; empty if the page shows only one robot. */
export const places = state(/** @type {PlacedRobot[]} */ ([]));
/** Faults of the simulated robot; null if the robots are not simulated. */
export const simulator = state(/** @type {Simulator | null} */ (null));
/** Key of the text that says why no data come from the dashboard; empty while data come. */
export const problem = state("link.connecting");

// Of the robot that is watched

/** Parts about the robot, by name; null or empty until they have come. */
const OF_ROBOT = {
  link: state(/** @type {Link | null} */ (null)),
  robot: state(/** @type {Robot | null} */ (null)),
  pose: state(/** @type {Motion | null} */ (null)),
  outline: state(/** @type {number[][]} */ ([])),
  path: state(/** @type {number[][]} */ ([])),
  codes: state(/** @type {(Code & {time: number})[]} */ ([])),
  map: state(/** @type {Area | null} */ (null)),
  scenes: state(/** @type {{name: string, maps: string[]}[]} */ ([])),
  control: state(/** @type {Control | null} */ (null)),
  tasks: state(/** @type {Task[]} */ ([])),
  details: state(/** @type {Record<string, any> | null} */ (null)),
  sample: state(/** @type {(number | boolean | null)[] | null} */ (null)),
};
export const { link, robot, pose, outline, path, codes, map, scenes, control, tasks, details } =
  OF_ROBOT;
export const { sample } = OF_ROBOT;
/** Last laser scan; null until one has come. */
export const scan = state(/** @type {Scan | null} */ (null));

// Of the viewer

/** Index of the robot that the viewer has chosen. */
export const chosen = state(0);
/** Address of this robot; empty until the dashboard has told it. Unlike the index, it always means this robot. */
export const address = computed(() => robots.value[chosen.value] ?? "");
/** Index of the robot whose parts (named sections of data, e.g. `pose`) arrive. */
export const watching = state(0);
/** Name of the tab that the panel shows. */
export const tab = state("go");
/** Size of the sheet that holds the panel on a small screen. */
export const sheet = state(/** @type {"closed" | "half" | "full"} */ ("closed"));
/** Tool that a press on the map uses. */
export const tool = state(/** @type {"move" | "go" | "measure" | "pose" | "obstacle"} */ ("move"));
/** Mark or pose that the viewer has selected; null without one. */
export const target = state(/** @type {Target | null} */ (null));
/** Pose that the viewer is about to send to the robot. */
export const draft = state(/** @type {Pose | null} */ (null));
/** Place of a pose whose direction the viewer still has to set with the enter key. */
export const entered = state(/** @type {Point | null} */ (null));
/** Both ends of the measured line. */
export const measured = state(/** @type {[Point, Point] | null} */ (null));
/** Place under the pointer. */
export const pointed = state(/** @type {Point | null} */ (null));
/** True to keep the robot in the middle of the map. */
export const follow = state(false);
/** True to show the map with the robot's front at the top; false for north. */
export const robotUp = state(false);
/** True for each layer of the map that is drawn. */
export const layers = state({
  laser: true,
  path: true,
  footprint: true,
  trail: true,
  marks: true,
  keepout: true,
  zones: true,
  others: true,
});
/** Text below the map: the last answer, or what the page itself says; null without one. */
export const answer = state(/** @type {Answer | null} */ (null));
/** Warnings about a pose that the viewer has dismissed, each with its robot and map. */
export const dismissed = state(/** @type {string[]} */ ([]));
/** Why the dashboard has not answered or has refused a stop of this page, by the address of the robot. */
export const unanswered = state(
  /** @type {ReadonlyMap<string, import("./texts.js").Value>} */ (new Map()),
);
/** Why a robot may move after a stop of this or another page, by its address. */
export const alarms = computed(() => {
  const found = new Map(unanswered.value);
  for (const card of fleet.value) if (card.alarm) found.set(card.address, card.alarm);
  return found;
});
/** Speed limits that ended with a restart of the dashboard, in m/s, by the address of the robot. */
const endedLimits = state(/** @type {ReadonlyMap<string, number>} */ (new Map()));
/** Ended speed limit of the chosen robot, in m/s; undefined without one. */
export const endedLimit = computed(() => endedLimits.value.get(address.value));
/** Commands that wait for their answer, each as its `pendingKey`. */
export const pending = state(/** @type {ReadonlySet<string>} */ (new Set()));
/** True if the arrow keys drive. */
export const keyboard = state(false);
/** True if stick and arrow keys drive slowly. */
export const slow = state(false);
/** Maximum velocities of stick and arrow keys, in m/s and rad/s; 0 until they are known. */
export const stickLimits = computed(() => {
  const { linear, angular } = control.value?.limits ?? { linear: 0, angular: 0 };
  const share = slow.value ? SLOW : 1;
  return { linear: linear * share, angular: angular * share };
});
/** The pointer that holds the stick; null without one. */
export const grip = state(/** @type {Grip | null} */ (null));
/** Codes of the arrow keys that are down and drive. */
export const heldKeys = state(/** @type {ReadonlySet<string>} */ (new Set()));
/** Velocity that the stick or the keys ask for; null while nothing is held. */
export const held = computed(() => {
  if (grip.value) return stickVelocity(grip.value.right, grip.value.up);
  if (!heldKeys.value.size) return null;
  const pressed = [...heldKeys.value].map((code) => KEY_DIRECTIONS[code]);
  const [right, up] = [0, 1].map((axis) => pressed.reduce((sum, each) => sum + each[axis], 0));
  return stickVelocity(right, up);
});

/** Scene, map and version that are shown; without a picture, those that the robot uses. */
export const shownMap = computed(() => {
  const { scene = "", name = "", version = "", resolution } = map.value ?? {};
  if (resolution) return { scene, map: name, version };
  const used = robot.value;
  return { scene: used?.scene ?? "", map: used?.map ?? "", version: used?.version ?? "" };
});

/** True if what is shown of the robot may be out of date. */
export const outdated = computed(() => problem.value !== "" || !link.value?.good);
/** True if the robot does not know where it is. */
export const isLost = computed(
  () => robot.value?.objections?.some(({ name }) => LOST.includes(name)) ?? false,
);
/** The running task in the list of tasks, with its destination; undefined without one. */
export const running = computed(() => tasks.value.find((each) => each.running));

/**
 * Return the rest of a path from the point nearest to a place: its points, its length, and how far
 * along the path it begins, in metres. The path may cross itself, so search ahead of the former place
 * first.
 * @param {number[][]} whole
 * @param {Point} place
 * @param {number} from how far along the path the former place was, in metres
 */
export function restOfPath(whole, { x, y }, from) {
  /** Return the nearest point between two lengths along the path. @param {number} begin @param {number} until */
  const search = (begin, until) => {
    let best = { away: Infinity, along: 0, index: 0, point: whole[0] };
    let along = 0;
    for (let index = 1; index < whole.length; index++) {
      const [[x1, y1], [x2, y2]] = [whole[index - 1], whole[index]];
      const length = Math.hypot(x2 - x1, y2 - y1);
      if (length && along + length >= begin && along <= until) {
        const nearest = ((x - x1) * (x2 - x1) + (y - y1) * (y2 - y1)) / length;
        const step = Math.min(length, until - along, Math.max(0, begin - along, nearest));
        const point = [x1 + ((x2 - x1) * step) / length, y1 + ((y2 - y1) * step) / length];
        const away = Math.hypot(point[0] - x, point[1] - y);
        if (away < best.away) best = { away, along: along + step, index, point };
      }
      along += length;
    }
    return { ...best, length: along - best.along };
  };
  const near = search(from, from + AHEAD);
  const { along, length, index, point } = near.away < BESIDE ? near : search(0, Infinity);
  return { points: [point, ...whole.slice(index)], length, along };
}

/** The part of the path that the robot has still to drive; null while its place is not known. */
export const pathAhead = state(/** @type {ReturnType<typeof restOfPath> | null} */ (null));
let driven = { path: path.peek(), along: 0 }; // how far the robot has come on a path, in metres
effect(() => {
  if (driven.path !== path.value) driven = { path: path.value, along: 0 };
  const isKnown = !outdated.value && !isLost.value && path.value.length > 1;
  const rest = isKnown && pose.value ? restOfPath(path.value, pose.value, driven.along) : null;
  if (rest) driven.along = rest.along;
  pathAhead.value = rest;
});
/** Length of the way to the goal of the running task, in metres; empty if no path leads there. */
export const wayLeft = computed(() => {
  const { to, command, place } = running.value ?? {};
  const mark = map.value?.marks?.find(({ number }) => number === (to || command?.args?.mark));
  const goal = mark ? [mark.x, mark.y] : place;
  const end = pathAhead.value?.points.at(-1);
  if (!goal || !end || Math.hypot(end[0] - goal[0], end[1] - goal[1]) > AT_GOAL) return "";
  return pathAhead.value?.length.toFixed(1) ?? "";
});

/** True if this viewer has the control. */
export const hasControl = computed(() => control.value?.owner === you.value);

/**
 * Return the key of a command in `pending`; all tasks share one, so that two marks send one task.
 * @param {string} name
 */
export const pendingKey = (name) =>
  `${address.value} ${TASK_COMMANDS.includes(name) ? "go" : name}`;

/** @param {string} name */
export const isPending = (name) => pending.value.has(pendingKey(name));

let process = ""; // id of the dashboard's process; empty before the first connection
let page = ""; // id of the files of this page; empty before the first connection
/** True if the dashboard has other files than those of which this page is made. */
export const updated = state(false);

/** Note that the speed limits of the dashboard's former process, which `fleet` still has, have ended. */
function endLimits() {
  const ended = new Map(endedLimits.value);
  for (const { address, speedLimit } of fleet.value) if (speedLimit) ended.set(address, speedLimit);
  endedLimits.value = ended;
}

/** Forget ended limits that the viewer has dismissed or replaced. @param {string[]} addresses */
export function forgetEndedLimits(addresses) {
  const ended = new Map(endedLimits.value);
  for (const each of addresses) ended.delete(each);
  endedLimits.value = ended;
}

/** Parts about all robots. */
const SHARED = { fleet, places, simulator };

/**
 * Store a part of the dashboard's data.
 * @param {string} name of the part; `hello` comes first after each connection
 * @param {any} data
 */
export function receive(name, data) {
  if (name === "hello") {
    clockOffset = data.now - performance.now();
    batch(() => {
      if (process && process !== data.process) {
        endLimits();
        unanswered.value = alarms.value; // keep the alarms: the new process may know nothing of them
        map.value = null; // the new process may use the map's number for another map
        simulator.value = null; // its robots may be real
        if (tool.value === "obstacle") tool.value = "move";
      }
      process = data.process;
      page ||= data.page;
      updated.value = page !== data.page;
      link.value = null; // until its parts come, what is shown of the robot is out of date
      you.value = data.you;
      lostControl.value = !data.control && (lostControl.value || mayControl.value);
      mayControl.value = data.control;
      // a page that was reloaded has the robot in its own address
      const index = data.robots.indexOf(address.value || location.hash.slice(1));
      if (index !== chosen.value) fleet.value = places.value = []; // their indices belong to the former list of robots
      robots.value = data.robots;
      if (index < 0) choose(0);
      else chosen.value = index;
    });
  } else if (name === "watching") {
    watching.value = data;
  } else if (Object.hasOwn(SHARED, name)) {
    SHARED[/** @type {keyof typeof SHARED} */ (name)].value = data;
    if (name !== "fleet") return;
    const limited = fleet.value.filter(({ speedLimit }) => speedLimit);
    forgetEndedLimits(limited.map(({ address }) => address));
  } else if (Object.hasOwn(OF_ROBOT, name) && watching.value === chosen.value) {
    // parts of the former robot may still arrive after the viewer has chosen another one
    OF_ROBOT[/** @type {keyof typeof OF_ROBOT} */ (name)].value = data;
  }
}

/**
 * Store a laser scan; `part_data.py` describes its format.
 * @param {ArrayBuffer} buffer
 */
export function receiveScan(buffer) {
  if (watching.value !== chosen.value) return;
  const view = new DataView(buffer);
  const [x, y, theta, forward, left, first, step] = [0, 1, 2, 3, 4, 5, 6].map((index) =>
    view.getFloat32(4 + 4 * index, true),
  );
  const points = new Float32Array(buffer.byteLength - 32); // x and y of each range, which has 2 bytes
  let count = 0;
  for (let index = 0, at = 32; at + 1 < buffer.byteLength; index++, at += 2) {
    const range = view.getUint16(at, true) / 1000;
    if (!range) continue;
    const angle = first + index * step;
    points[count++] = forward + range * Math.cos(angle);
    points[count++] = left + range * Math.sin(angle);
  }
  scan.value = { pose: { x, y, theta }, points: points.subarray(0, count) };
}

/**
 * Return the velocity for a position of the stick.
 * @param {number} right as a fraction of the stick's radius
 * @param {number} up
 */
function stickVelocity(right, up) {
  const { linear, angular } = stickLimits.value;
  const live = (/** @type {number} */ value) => (Math.abs(value) < DEAD_ZONE ? 0 : value);
  return {
    linear: live(up) * linear,
    // backwards, the robot still moves to the side to which the stick points
    angular: -live(right) * angular * (up < -DEAD_ZONE ? -1 : 1),
  };
}

/** Stop driving by hand. A pointer or a key that is still down drives no more. */
export function letGo() {
  batch(() => {
    grip.value = null;
    heldKeys.value = new Set();
  });
}

/** Choose a robot, and forget everything about the former one. @param {number} index */
export function choose(index) {
  batch(() => {
    letGo();
    keyboard.value = false; // the arrow keys were switched on for the former robot
    chosen.value = index;
    for (const each of Object.values(OF_ROBOT)) each.value = Array.isArray(each.value) ? [] : null;
    scan.value = null;
    target.value = draft.value = entered.value = measured.value = null;
    answer.value = null;
    if (tool.value === "pose") tool.value = "move";
  });
}

// The state of the page: what the dashboard has sent, and what the viewer has chosen.

import { batch, computed, signal } from "./vendor/preact.js";

/** @typedef {{x: number, y: number}} Point  a place on the map, in metres */
/** @typedef {{x: number, y: number, theta: number}} Pose  in metres and radians */
/** @typedef {Pose & {linear: number, angular: number, doubt: Objection | null}} Motion */
/** @typedef {{name: string, reason: string, remedy: string}} Objection */
/** @typedef {{code: string, level: string, text: string, meaning: string}} Code */
/** @typedef {Pose & {number: string, text: string, type: string}} Mark */
/** @typedef {{kind: string, outline: number[][], speed: number}} Zone */
/**
 * @typedef {object} Robot
 * @property {boolean} known true if the robot has reported its state
 * @property {number} id
 * @property {string} name
 * @property {string} model
 * @property {string} scene
 * @property {string} map
 * @property {string} state
 * @property {string | null} control
 * @property {string | null} work
 * @property {boolean} emergencyStop
 * @property {boolean | null} taskable
 * @property {Objection[]} objections
 * @property {Battery | null} battery
 * @property {RunningTask | null} task
 * @property {{name: string, state: string, text: import("./texts.js").Value}[]} actions
 * @property {Code[]} problems
 * @property {{mute: boolean, volume: number} | null} sound
 * @property {boolean} light
 */
/**
 * @typedef {{power: number, charging: boolean, temperature: number, cycles: number,
 *   low: number}} Battery
 */
/**
 * @typedef {{id: string, type: string, to: string, state: string, running: boolean, text: string,
 *   action: string, actionState: string}} RunningTask
 */
/**
 * @typedef {object} Task
 * @property {string} id
 * @property {string} type
 * @property {string} to number of the mark where the task goes, may be empty
 * @property {[number, number] | null} place where the robot goes, in metres, if that is known
 * @property {string} state
 * @property {boolean} running
 * @property {string} text from the robot
 * @property {Code | null} code reason of a failure, if known
 * @property {string} scene empty if it is not known on which map the task is
 * @property {string} map
 * @property {number} begun Unix time in milliseconds; 0 if its start was not seen
 * @property {number} changed Unix time in ms of the last change of state, 0 before the first report
 * @property {string} by name of the viewer or of another source, empty if unknown
 * @property {{name?: string, args?: Record<string, any>}} command that gave the task, empty if no page gave it
 */
/**
 * @typedef {object} Area the map, as far as it is known
 * @property {number} number
 * @property {import("./texts.js").Value} error
 * @property {string} [scene]
 * @property {string} [name]
 * @property {number} [resolution]
 * @property {Pose} [origin]
 * @property {boolean} [keepout]
 * @property {Mark[]} [marks]
 * @property {Zone[]} [zones]
 * @property {number[][][]} [lanes]
 * @property {{type: string, number: number, name: string}[]} [taskTypes]
 */
/**
 * @typedef {object} Control
 * @property {string | null} owner
 * @property {{linear: number, angular: number}} limits of the stick
 * @property {number} maximum of the stick without a speed limit
 * @property {number | null} speedLimit
 * @property {import("./texts.js").Value} speedRefusal
 * @property {{name: string, detail: import("./texts.js").Value}} driver
 * @property {import("./texts.js").Value} standstill
 */
/**
 * @typedef {{good: boolean, state: string, since: number, silence: number, error: import("./texts.js").Value,
 *   advice: string, delay: number | null}} Link
 */
/**
 * @typedef {object} Card
 * @property {string} address
 * @property {string} link as in `Link`, the state
 * @property {number} silence
 * @property {boolean} known
 * @property {number} id
 * @property {string} name
 * @property {string} state
 * @property {Objection | null} objection why it takes no tasks
 * @property {boolean} moves
 * @property {number} problems
 * @property {string} level
 * @property {Battery | null} battery
 * @property {Task | null} task the one that runs
 * @property {Order | null} order
 * @property {import("./texts.js").Value} alarm why a stop was not confirmed; empty without an alarm
 * @property {number | null} speedLimit
 */
/**
 * @typedef {{id: string, node: string, nodesLeft: number, paused: boolean, errors: {type: string,
 *   level: string, text: import("./texts.js").Value}[]}} Order
 */
/** @typedef {Pose & {index: number, name: string, scene: string, map: string, outline: number[][]}} Place */
/** @typedef {{id: string, name: string, text: string, x?: number, y?: number, radius?: number}} Fault */
/**
 * @typedef {{known: {name: string, description: import("./texts.js").Value, arguments: string}[],
 *   faults: Fault[]}} Simulator
 */
/** @typedef {{pose: Pose, points: Float32Array}} Scan  x, y of each point in the frame of the robot */
/**
 * @typedef {object} Target the mark or pose to which the viewer may send the robot
 * @property {"go" | "goMark" | "charge"} command
 * @property {string} [mark]
 * @property {Pose} [pose]
 * @property {{path: number[][], length: number} | {error: import("./texts.js").Value} | null} plan null until the answer
 * @property {TaskKind} [kind] what shall be done there, as far as it is known
 * @property {Point | null} [from] where the robot was when the path was requested
 */
/** @typedef {{type: string, number: number, direction: string}} TaskKind */
/**
 * @typedef {{ok: boolean, text: import("./texts.js").Text, time: number, robot: number,
 *   task?: string}} Answer  with the id of the task that the robot has accepted
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
export const MOVES = ["go", "goMark", "charge"];
const DEAD_ZONE = 0.12; // fraction of the stick's radius within which it does not drive
/** @type {Record<string, [number, number]>} directions, right and up, by the code of the key */
export const KEYS = {
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
};

/**
 * @template T
 * @param {T} value
 * @returns {import("@preact/signals").Signal<T>}
 */
const state = (value) => signal(value);

// Of the dashboard

export const you = state("");
export const mayControl = state(false);
/** Addresses of the robots. */
export const robots = state(/** @type {string[]} */ ([]));
export const fleet = state(/** @type {Card[]} */ ([]));
export const places = state(/** @type {Place[]} */ ([]));
export const simulator = state(/** @type {Simulator | null} */ (null));
/** Why no data come from the dashboard; empty while data come. */
export const problem = state("link.connecting");

// Of the robot that is watched

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
  sample: state(/** @type {number[] | null} */ (null)),
};
export const { link, robot, pose, outline, path, codes, map, scenes, control, tasks, details } =
  OF_ROBOT;
export const { sample } = OF_ROBOT;
export const scan = state(/** @type {Scan | null} */ (null));

// Of the viewer

/** Index of the robot that the viewer has chosen. */
export const chosen = state(0);
/** Index of the robot whose parts (named sections of data, e.g. `pose`) arrive. */
export const watching = state(0);
export const tab = state("go");
/** Size of the sheet that holds the panel on a small screen. */
export const sheet = state(/** @type {"closed" | "half" | "full"} */ ("closed"));
/** Tool that a press on the map uses. */
export const tool = state(/** @type {"move" | "go" | "measure" | "pose" | "obstacle"} */ ("move"));
export const target = state(/** @type {Target | null} */ (null));
/** Pose that the viewer is about to send to the robot. */
export const draft = state(/** @type {Pose | null} */ (null));
/** Place of a pose whose direction the viewer still has to set with the enter key. */
export const entered = state(/** @type {Point | null} */ (null));
/** Both ends of the measured line. */
export const measured = state(/** @type {[Point, Point] | null} */ (null));
/** Place under the pointer. */
export const pointed = state(/** @type {Point | null} */ (null));
export const follow = state(false);
/** True to show the map with the robot's front at the top; false for north. */
export const robotUp = state(false);
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
export const answer = state(/** @type {Answer | null} */ (null));
/** Doubts about a pose that the viewer has dismissed, each with its robot and map. */
export const dismissed = state(/** @type {string[]} */ ([]));
/** Why a stop of this page has no answer of the dashboard, by the index of the robot. */
export const unanswered = state(
  /** @type {ReadonlyMap<number, import("./texts.js").Value>} */ (new Map()),
);
/** Why a stop was not confirmed, by the index of the robot. The dashboard knows of the others' stops, too. */
export const alarms = computed(() => {
  const found = new Map(unanswered.value);
  fleet.value.forEach(({ alarm }, index) => alarm && found.set(index, alarm));
  return found;
});
/** Speed limits that ended with a restart of the dashboard, in m/s, by the address of the robot. */
export const endedLimits = state(/** @type {ReadonlyMap<string, number>} */ (new Map()));
/** The one of the robot that the viewer has chosen. */
export const endedLimit = computed(() => endedLimits.value.get(robots.value[chosen.value] ?? ""));
/** Commands without an answer so far, as robot and name. */
export const pending = state(/** @type {ReadonlySet<string>} */ (new Set()));
/** True if the arrow keys drive. */
export const keyboard = state(false);
/** The pointer that holds the stick; null without one. */
export const grip = state(/** @type {Grip | null} */ (null));
/** Codes of the arrow keys that are down and drive. */
export const keys = state(/** @type {ReadonlySet<string>} */ (new Set()));
/** Velocity that the stick or the keys ask for; null while nothing is held. */
export const held = computed(() => {
  if (grip.value) return stickVelocity(grip.value.right, grip.value.up);
  if (!keys.value.size) return null;
  const pressed = [...keys.value].map((code) => KEYS[code]);
  const [right, up] = [0, 1].map((axis) => pressed.reduce((sum, each) => sum + each[axis], 0));
  return stickVelocity(right, up);
});

/** Scene and map that are shown; without a picture, those that the robot uses. */
export const shownMap = computed(() =>
  map.value?.resolution
    ? { scene: map.value.scene ?? "", map: map.value.name ?? "" }
    : { scene: robot.value?.scene ?? "", map: robot.value?.map ?? "" },
);

/** True if what is shown of the robot may be out of date. */
export const outdated = computed(() => problem.value !== "" || !link.value?.good);
/** True if this viewer has the control. */
export const mine = computed(() => control.value !== null && control.value.owner === you.value);

/**
 * Return the key of a command in `pending`; all tasks share one, so that two marks send one task.
 * @param {string} name
 */
export const pendingKey = (name) => `${chosen.value} ${MOVES.includes(name) ? "go" : name}`;

/** @param {string} name */
export const isPending = (name) => pending.value.has(pendingKey(name));

let process = ""; // that of the dashboard

/** Note the speed limits of a former process of the dashboard, which only this page still knows. */
function endLimits() {
  const ended = new Map(endedLimits.value);
  for (const { address, speedLimit } of fleet.value) if (speedLimit) ended.set(address, speedLimit);
  endedLimits.value = ended;
}

/** @param {string[]} addresses of robots whose viewer knows that a limit has ended, or has set another one */
export function forgetEndedLimits(addresses) {
  const ended = new Map(endedLimits.value);
  for (const each of addresses) ended.delete(each);
  endedLimits.value = ended;
}

/** Parts about all robots. */
const SHARED = { fleet, places, simulator };

/**
 * Store a part of the dashboard's data.
 * @param {string} name
 * @param {any} data
 */
export function receive(name, data) {
  if (name === "hello") {
    batch(() => {
      if (process && process !== data.process) {
        endLimits();
        unanswered.value = alarms.value; // the new process may know nothing of them
        map.value = null; // the new process may use the map's number for another map
      }
      process = data.process;
      you.value = data.you;
      mayControl.value = data.control;
      robots.value = data.robots;
    });
  } else if (name === "watching") {
    watching.value = data;
  } else if (Object.hasOwn(SHARED, name)) {
    SHARED[/** @type {keyof typeof SHARED} */ (name)].value = data;
    const limited = fleet.value.filter(({ speedLimit }) => speedLimit);
    if (name === "fleet") forgetEndedLimits(limited.map(({ address }) => address));
  } else if (Object.hasOwn(OF_ROBOT, name) && watching.value === chosen.value) {
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
  const points = new Float32Array(buffer.byteLength - 32);
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
  const { linear, angular } = control.value?.limits ?? { linear: 0, angular: 0 };
  const dead = (/** @type {number} */ value) => (Math.abs(value) < DEAD_ZONE ? 0 : value);
  return {
    linear: dead(up) * linear,
    // backwards, the robot still moves to the side to which the stick points
    angular: -dead(right) * angular * (up < -DEAD_ZONE ? -1 : 1),
  };
}

/** Stop driving by hand. A pointer or a key that is still down drives no more. */
export function letGo() {
  batch(() => {
    grip.value = null;
    keys.value = new Set();
  });
}

/** Forget everything about the former robot, because the viewer has chosen another one. */
export function forget() {
  batch(() => {
    for (const each of Object.values(OF_ROBOT)) each.value = Array.isArray(each.value) ? [] : null;
    scan.value = null;
    target.value = draft.value = entered.value = measured.value = null;
    answer.value = null;
    if (tool.value === "pose") tool.value = "move";
  });
}

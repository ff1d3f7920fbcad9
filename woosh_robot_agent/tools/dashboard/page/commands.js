// Actions of the viewer: commands, STOP, the choice of a tab, of a robot, of a target, of a pose.

import { refusal } from "./allowed.js";
import { batch, effect, signal } from "./vendor/preact.js";
import { Connection } from "./connection.js";
import * as store from "./store.js";

const DOUBLE_CLICK = 500; // milliseconds within which a repeated command is not sent
const REPLAN = 0.5; // metres that the robot may move before a path to the target is planned anew
const STANDSTILL = 1000; // milliseconds for which a robot must stand still to end its alarm
/** States of an action that goes on, or may do so. */
const EXECUTING = ["executing", "err msg", "pause failed", "unknown"];
const SAME_PLACE = 0.01; // metres between two poses of a robot that stands still

export const connection = new Connection(received, receivedScan, (problem) => {
  store.problem.value = problem;
  standingSince = performance.now(); // a pose from before shows no standstill
});

/** The last sending of each command: its arguments, and when it was sent or answered. */
const lastSent = /** @type {Map<string, {args: string, at: number}>} */ (new Map());
let standingSince = 0; // time since which the robot is seen to stand still
let standsAt = { x: 0, y: 0 }; // where it stands, in metres

/**
 * @param {string} name
 * @param {any} data
 */
function received(name, data) {
  if (name === "stick") {
    store.letGo(); // the dashboard has ended the press
    tell(false, data);
    return;
  }
  store.receive(name, data);
  if (name === "hello") connection.begin(store.robots.value, store.chosen.value);
  checkAlarm();
}

/** @param {ArrayBuffer} data */
function receivedScan(data) {
  store.receiveScan(data);
  checkAlarm();
}

/**
 * Show a text below the map, e.g. the answer to a command.
 * @param {boolean} ok
 * @param {import("./texts.js").Text} text
 * @param {string} robot address
 * @param {string} [task] id of the task that the robot has accepted
 */
export function tell(ok, text, robot = store.address.value, task) {
  store.answer.value = { ok, text, time: store.now(), robot, task };
}

/**
 * Send a command, unless the same command was sent just now, or it would do nothing.
 * @param {string} name
 * @param {Record<string, any>} args
 * @returns {Promise<boolean>} true if the robot has accepted the command
 */
export async function run(name, args = {}) {
  const robot = store.address.value;
  const now = performance.now();
  const pending = store.pendingKey(name);
  // all tasks count as the same command: a double click on two marks sends one
  const sent = { args: store.TASK_COMMANDS.includes(name) ? "" : JSON.stringify(args), at: now };
  const last = lastSent.get(pending);
  if (last?.args === sent.args && now < last.at + DOUBLE_CLICK) return false;
  const values = { command: { key: `command.${name}`, values: {} } };
  const reason = refusal(name);
  if (reason) {
    tell(false, { key: "reply.notSent", values: { ...values, reason } }, robot);
    return false;
  }
  lastSent.set(pending, sent);
  setPending(pending, true);
  tell(true, { key: "reply.sent", values }, robot);
  const { ok, text, data } = await connection.command(name, args);
  sent.at = performance.now();
  setPending(pending, false);
  tell(ok, text, robot, data);
  return ok;
}

/**
 * @param {string} key
 * @param {boolean} on
 */
function setPending(key, on) {
  const keys = new Set(store.pending.value);
  if (on) keys.add(key);
  else keys.delete(key);
  store.pending.value = keys;
}

let presses = 0; // of STOP
const confirmed = /** @type {Map<string, number>} */ (new Map()); // last press that was, by the robot

export async function stop() {
  store.letGo();
  const robot = store.address.value;
  tell(true, { key: "reply.stopping", values: {} }, robot);
  const press = ++presses;
  const { ok, text } = await connection.stop(robot);
  if (press < (confirmed.get(robot) ?? 0)) return; // a later press is confirmed
  if (ok) confirmed.set(robot, press);
  tell(ok, text, robot);
  // the dashboard itself raises the alarm of a stop that the robot has not confirmed
  setUnanswered(robot, ok || text.key === "reply.notStopped" ? "" : text);
}

/**
 * Raise the alarm of a robot whose stop has no answer or is refused; without a text, end it.
 * @param {string} robot address
 * @param {import("./texts.js").Value} text
 */
function setUnanswered(robot, text) {
  const alarms = new Map(store.unanswered.value);
  alarms.delete(robot);
  if (text) alarms.set(robot, text);
  store.unanswered.value = alarms;
  standingSince = performance.now();
}

/** End the alarm of this page once the robot's pose shows a standstill for a while. */
function checkAlarm() {
  const now = performance.now();
  const pose = store.pose.value;
  const seen = !store.outdated.value && store.watching.value === store.chosen.value;
  // robots report no speed while they move sideways
  const stays = pose && Math.hypot(pose.x - standsAt.x, pose.y - standsAt.y) < SAME_PLACE;
  const { actions, task, state } = store.robot.value ?? {};
  const acts = actions?.some((each) => EXECUTING.includes(each.state)); // e.g. a lift
  const drivesOn = (task?.running && task.state !== "paused") || state === "following"; // by itself
  if (!(seen && stays && !acts && !drivesOn && !pose.linear && !pose.angular)) {
    standingSince = now;
    standsAt = pose ?? standsAt;
  }
  const robot = store.address.value;
  const ends = now - standingSince > STANDSTILL && store.unanswered.value.has(robot);
  if (ends) setUnanswered(robot, "");
}

// When the alarm of a robot ends, replace the answer that says its stop failed.
let formerAlarms = store.alarms.peek();
effect(() => {
  const [former, alarms, answer] = [formerAlarms, store.alarms.value, store.answer.peek()];
  formerAlarms = alarms;
  if (!answer || !former.has(answer.robot) || alarms.has(answer.robot)) return;
  // the reason of an alarm that this page has raised is the text of the answer
  const saysSo = answer.text.key === "reply.notStopped" || answer.text === former.get(answer.robot);
  if (saysSo) tell(true, { key: "alarm.ended", values: {} }, answer.robot);
});

// Tell that a speed limit has ended. This replaces the answer that says it was accepted.
effect(() => {
  const limit = store.endedLimit.value;
  if (limit) tell(false, { key: "notice.limitEnded", values: { limit } });
});

/** Show a tab. @param {string} name */
export function openTab(name) {
  batch(() => {
    if (name !== "simulator" && store.tool.value === "obstacle") store.tool.value = "go";
    store.tab.value = name;
    if (store.sheet.value === "closed") store.sheet.value = "half";
  });
  document.querySelector(".panel")?.scrollTo(0, 0);
}

/** @param {number} index */
export function chooseRobot(index) {
  if (index === store.chosen.value) return;
  store.choose(index);
  connection.watch(index);
}

export function release() {
  store.letGo();
  connection.send({ do: "release" });
}

/**
 * Select a target, and show the path on which the robot would drive there.
 * @param {import("./store.js").Target} chosen
 */
export async function setTarget(chosen) {
  if (store.tool.peek() === "pose") forgetTarget(); // a new target ends the setting of a pose
  const target = { ...chosen, from: store.pose.peek() };
  store.target.value = target;
  if (!target.pose || !store.mayControl.peek()) return;
  const { ok, text, data } = await connection.command("plan", target.pose);
  if (store.target.value !== target) return; // the viewer has chosen another target meanwhile
  store.target.value = { ...target, plan: ok ? data : { error: text } };
}

effect(() => {
  const ready = !store.outdated.value && store.mayControl.value;
  const target = store.target.peek();
  if (ready && target?.pose && !(target.plan && "path" in target.plan))
    setTarget({ ...target, plan: null }); // the answer may have been lost with the connection
});

effect(() => {
  const pose = store.pose.value;
  const target = store.target.peek();
  if (!pose || pose.linear || pose.angular || !target?.plan || !target.from) return;
  const { x, y } = target.from;
  if (Math.hypot(pose.x - x, pose.y - y) > REPLAN) setTarget({ ...target, plan: null });
});

/** @param {import("./store.js").Mark} mark */
export function setTargetMark(mark) {
  const { x, y, theta, number } = mark;
  setTarget({ command: "goMark", mark: number, pose: { x, y, theta }, plan: null });
}

/**
 * @param {import("./store.js").Point} place
 * @param {number | null} direction in radians; null for the direction from the robot to the place
 */
export function setTargetPlace({ x, y }, direction) {
  const from = store.pose.value;
  const theta = direction ?? (from ? Math.atan2(y - from.y, x - from.x) : 0);
  setTarget({ command: "go", pose: { x, y, theta }, plan: null });
}

function forgetPlaces() {
  batch(() => {
    store.target.value = store.draft.value = null;
    store.entered.value = store.measured.value = null;
  });
}

/** Forget the target, the pose and the tool that the viewer has begun to use on the map. */
export function forgetTarget() {
  batch(() => {
    forgetPlaces();
    if (store.tool.value === "pose") store.tool.value = store.mayControl.value ? "go" : "move";
  });
}

/** Let the viewer set the pose of the robot on the map. */
export function startPose() {
  forgetTarget();
  batch(() => {
    store.tool.value = "pose";
    store.sheet.value = "closed"; // on a small screen the sheet covers the map
  });
  document.getElementById("map")?.focus();
}

/** Send the pose that the viewer has set to the robot. */
export async function confirmPose() {
  const pose = store.draft.value;
  const accepted = pose && (await run("setPose", { ...pose, ...store.shownMap.value }));
  if (accepted && store.draft.value === pose) forgetTarget(); // not what the viewer has begun meanwhile
}

/** Names and versions of the maps that are shown and used; they change with each of them. */
export const mapNames = signal("");
effect(() => {
  const { known, scene, map, version } = store.robot.value ?? {};
  // after its restart, the dashboard does not know the robot at first
  if (known !== false) mapNames.value = JSON.stringify([store.shownMap.value, scene, map, version]);
});
mapNames.subscribe(forgetPlaces); // places of one map mean nothing on another one

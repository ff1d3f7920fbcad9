// What the viewer does: commands, STOP, the choice of a robot, a target, a pose.

import { batch, effect } from "./vendor/preact.js";
import { Connection } from "./connection.js";
import * as store from "./store.js";
import { say } from "./texts.js";

const DOUBLE_CLICK = 500; // milliseconds within which the same command is given once
const STANDSTILL = 1000; // milliseconds for which a robot must stand still to end its alarm

export const connection = new Connection(received, receivedScan, (problem) => {
  store.problem.value = problem;
  checkAlarm();
});

/** When each command was last given, and if its answer is pending. */
const given = /** @type {Map<string, {since: number, pending: boolean}>} */ (new Map());
let standingSince = 0; // time since which the robot is seen to stand still

/**
 * @param {string} name
 * @param {any} data
 */
function received(name, data) {
  if (name === "stick") {
    store.held.value = null;
    tell(false, data);
    return;
  }
  store.receive(name, data);
  checkAlarm();
}

/** @param {ArrayBuffer} data */
function receivedScan(data) {
  store.receiveScan(data);
  checkAlarm();
}

/**
 * Show an answer.
 * @param {boolean} ok
 * @param {import("./texts.js").Text} text
 * @param {number} robot index
 */
export function tell(ok, text, robot = store.chosen.value) {
  store.answer.value = { ok, text, time: Date.now(), robot };
}

/**
 * Give a command. A double click, or a click while the answer is pending, gives no other one.
 * @param {string} name
 * @param {Record<string, any>} args
 * @returns {Promise<boolean>} true if the robot has accepted it
 */
export async function run(name, args = {}) {
  const { robot } = connection;
  const now = performance.now();
  const moves = name === "go" || name === "goMark" || name === "charge";
  const key = JSON.stringify(moves ? [robot] : [robot, name, args]); // one click, one task
  const { since, pending } = given.get(key) ?? { since: -Infinity, pending: false };
  if (now < since + DOUBLE_CLICK) return false;
  if (pending) {
    const command = { key: `command.${name}`, values: {} };
    const reason = { key: "reason.pending", values: {} };
    tell(false, { key: "reply.notSent", values: { command, reason } }, robot);
    return false;
  }
  given.set(key, { since: now, pending: true });
  const { ok, text } = await connection.command(name, args);
  given.set(key, { since: now, pending: false });
  tell(ok, text, robot);
  return ok;
}

export async function stop() {
  store.held.value = null;
  const { robot } = connection;
  tell(true, { key: "reply.stopping", values: {} }, robot);
  const { ok, text } = await connection.stop();
  tell(ok, text, robot);
  setAlarm(robot, ok ? "" : text);
}

/**
 * Raise the alarm of a robot whose stop is not confirmed; without a text, end it.
 * @param {number} robot index
 * @param {import("./texts.js").Value} text
 */
function setAlarm(robot, text) {
  const alarms = new Map(store.alarms.value);
  alarms.delete(robot);
  if (text) alarms.set(robot, text);
  store.alarms.value = alarms;
  standingSince = performance.now();
}

/** End the alarm of an unconfirmed stop once that robot is seen to stand still for a while. */
function checkAlarm() {
  const now = performance.now();
  const pose = store.pose.value;
  const seen = !store.outdated.value && store.watching.value === store.chosen.value;
  if (!(seen && pose && !pose.linear && !pose.angular)) standingSince = now;
  const ends = now - standingSince > STANDSTILL && store.alarms.value.has(store.chosen.value);
  if (ends) setAlarm(store.chosen.value, "");
}

/** @param {number} index */
export function chooseRobot(index) {
  if (index === store.chosen.value) return;
  batch(() => {
    store.held.value = null;
    store.chosen.value = index;
    store.forget();
  });
  connection.watch(index);
}

export function release() {
  connection.send({ do: "release" });
}

/**
 * Show how the robot would drive to a place, before it is sent there.
 * @param {import("./store.js").Target} target
 */
export async function setTarget(target) {
  store.target.value = target;
  if (!target.pose || !store.mayControl.value) return;
  const { ok, text, data } = await connection.command("plan", target.pose);
  if (store.target.value !== target) return; // the viewer has chosen another one meanwhile
  const error = { error: say(text) };
  store.target.value = { ...target, plan: ok ? data : error };
}

/** @param {import("./store.js").Mark} mark */
export function setTargetMark(mark) {
  const { x, y, theta, number } = mark;
  setTarget({ command: "goMark", mark: number, pose: { x, y, theta }, plan: null });
}

/**
 * @param {import("./store.js").Point} place
 * @param {number | null} direction in radians; null for that from the robot to the place
 */
export function setTargetPlace({ x, y }, direction) {
  const from = store.pose.value;
  const theta = direction ?? (from ? Math.atan2(y - from.y, x - from.x) : 0);
  setTarget({ command: "go", pose: { x, y, theta }, plan: null });
}

/** Forget what was about to be done on the map. */
export function forgetTarget() {
  batch(() => {
    store.target.value = store.draft.value = store.measured.value = null;
    if (store.tool.value === "pose") store.tool.value = store.mayControl.value ? "go" : "move";
  });
}

/** Let the viewer show where the robot is. */
export function startPose() {
  forgetTarget();
  batch(() => {
    store.tool.value = "pose";
    store.sheet.value = "closed"; // on a small screen it covers the map
  });
}

/** Tell the robot the pose that the viewer has shown. */
export async function confirmPose() {
  const pose = store.draft.value;
  if (pose && (await run("setPose", pose))) forgetTarget();
}

effect(() => {
  if (store.outdated.value) store.held.value = null;
});

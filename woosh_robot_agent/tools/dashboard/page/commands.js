// Actions of the viewer: commands, STOP, the choice of a robot, of a target, of a pose.

import { batch, computed } from "./vendor/preact.js";
import { Connection } from "./connection.js";
import * as store from "./store.js";

const DOUBLE_CLICK = 500; // milliseconds within which a repeated command is not sent
const STANDSTILL = 1000; // milliseconds for which a robot must stand still to end its alarm

export const connection = new Connection(received, receivedScan, (problem) => {
  store.problem.value = problem;
  checkAlarm();
});

/** Time of the last sending of each command, and whether its answer is pending. */
const given = /** @type {Map<string, {since: number, pending: boolean}>} */ (new Map());
let standingSince = 0; // time since which the robot is seen to stand still

/**
 * @param {string} name
 * @param {any} data
 */
function received(name, data) {
  if (name === "stick") {
    store.letGo();
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
 * Send a command, unless the same command was sent just now, or its answer is pending.
 * @param {string} name
 * @param {Record<string, any>} args
 * @returns {Promise<boolean>} true if the robot has accepted the command
 */
export async function run(name, args = {}) {
  const { robot } = connection;
  const now = performance.now();
  const moves = name === "go" || name === "goMark" || name === "charge";
  // all tasks of a robot share one key, so that a double click on a mark sends one task
  const key = JSON.stringify(moves ? [robot] : [robot, name, args]);
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
  store.letGo();
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

/** End the alarm of an unconfirmed stop once the robot's pose shows a standstill for a while. */
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
  store.letGo();
  batch(() => {
    store.keyboard.value = false; // the arrow keys were switched on for the former robot
    store.chosen.value = index;
    store.forget();
  });
  connection.watch(index);
}

export function release() {
  store.letGo();
  connection.send({ do: "release" });
}

/**
 * Show how the robot would drive to a place, before the viewer sends it there.
 * @param {import("./store.js").Target} target
 */
export async function setTarget(target) {
  store.target.value = target;
  if (!target.pose || !store.mayControl.value) return;
  const { ok, text, data } = await connection.command("plan", target.pose);
  if (store.target.value !== target) return; // the viewer has chosen another target meanwhile
  const error = { error: text };
  store.target.value = { ...target, plan: ok ? data : error };
}

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
  if (pose && (await run("setPose", { ...pose, ...store.shownMap.value }))) forgetTarget();
}

const maps = computed(() => {
  const { scene, map } = store.robot.value ?? {};
  return JSON.stringify([store.shownMap.value, scene, map]);
});
maps.subscribe(forgetPlaces); // places of one map mean nothing on another one

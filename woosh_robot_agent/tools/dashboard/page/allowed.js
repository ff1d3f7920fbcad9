// The commands that the viewer may give now. A control whose command would do nothing is disabled, and
// its title says why.

import * as store from "./store.js";
import { say } from "./texts.js";

/** Objections that keep a robot from continuing a task; others do not. */
const HINDRANCES = [
  ...["emergency_stop", "manual", "maintenance", "no_control_mode", "deployment", "schedule"],
  ...["no_work_mode", "not_initialised", "lost"],
];
/** Commands that are also sent to a robot that sends nothing, or that the page no longer updates. */
const INTERRUPTS = ["pause", "cancel"];
/** Commands that may be given again before the robot has answered. */
const REPEATABLE = ["sound", "speedLimit"];
const OF_SIMULATOR = ["fault", "endFault", "clearFaults"];

/** @typedef {import("./texts.js").Text & {objection?: string}} Refusal  objection: its name, if it says one */

/**
 * @param {string} key
 * @param {Record<string, any>} values
 * @returns {Refusal}
 */
const text = (key, values = {}) => ({ key, values });

/**
 * Return why a command would do nothing now; null if the viewer may give it.
 * @param {string} name of the command, or `drive`
 * @returns {Refusal | null}
 */
export function refusal(name) {
  const link = store.link.value;
  const robot = store.robot.value;
  const owner = store.control.value?.owner;
  if (store.problem.value) return text(store.problem.value);
  if (OF_SIMULATOR.includes(name)) return null;
  if (link?.state === "failed" && INTERRUPTS.includes(name)) return null; // the facts below may be outdated
  if (!link || link.state !== "connected") return text(`link.${link?.state ?? "connecting"}`);
  if (link.silence && !INTERRUPTS.includes(name))
    return text("link.noData", { seconds: link.silence });
  if (!robot?.known) return text("notice.unknown");
  if (owner && !store.hasControl.value) return text("reason.controlled", { name: owner });
  if (store.isPending(name) && !REPEATABLE.includes(name)) return text("reason.pending");
  return robotRefusal(robot, name);
}

/**
 * Return why the robot would refuse a command now; null if that is not certain.
 * @param {store.Robot} robot
 * @param {string} name
 */
function robotRefusal({ task, objections }, name) {
  // each constant is a reason to refuse, or null if it does not apply
  const heldUp = task?.running && task.state === "held up" ? text("task.held up") : null;
  const busy = task?.running ? (heldUp ?? text("objection.busy.reason")) : null;
  const paused = busy !== null && task?.state === "paused";
  const driving = paused ? null : busy; // a paused task does not drive
  /** Return the first objection with one of these names. @param {string[]} names @returns {Refusal | null} */
  const objection = (...names) => {
    const found = objections.find((each) => names.includes(each.name));
    return found ? { ...text(`objection.${found.name}.reason`), objection: found.name } : null;
  };
  const area = store.map.value;
  const noMap = area?.resolution ? null : text("reason.noMap");
  const hasCharger = area?.marks?.some(({ type }) => type === "charger") ?? true;
  const noTask =
    busy ?? objection("emergency_stop", "mapping") ?? objection(...HINDRANCES, "following", "busy");
  switch (name) {
    case "go":
    case "goMark":
      return noTask ?? noMap;
    case "charge":
      return noTask ?? (hasCharger ? null : text("marks.noCharger"));
    case "drive":
      return objection("emergency_stop", "maintenance") ?? driving;
    case "pause":
      if (paused) return text("reason.paused");
      return busy ? null : text("objection.no_task.reason");
    case "cancel":
      return busy ? null : text("objection.no_task.reason");
    case "continue":
      return paused ? objection(...HINDRANCES) : (heldUp ?? text("reason.notPaused"));
    case "setPose":
      return objection("mapping") ?? driving ?? noMap;
    case "keepPose":
    case "switchMap":
      return objection("mapping") ?? busy;
    case "saveMap":
    case "discardMap":
      return mappingEnd();
    default:
      return null;
  }
}

/** Return the text that the map is being saved or discarded; null if it is not. */
export function mappingEnd() {
  if (store.isPending("saveMap")) return text("mapping.saving");
  return store.isPending("discardMap") ? text("mapping.discarding") : null;
}

/**
 * Return the attributes of a control that gives a command. It is disabled, with the reason as its title,
 * if the command would do nothing. While the answer is pending, it looks disabled but keeps the focus.
 * @param {string} name
 * @param {boolean} [isComplete] false if arguments of the command are missing
 */
export function commandProps(name, isComplete = true) {
  const reason = refusal(name);
  const waits = reason?.key === "reason.pending";
  return {
    disabled: !isComplete || (reason !== null && !waits),
    "aria-disabled": waits || undefined,
    title: reason ? say(reason) : undefined,
  };
}

// What the viewer may do now. All controls follow this one rule: what would do nothing is off, and says why.

import * as store from "./store.js";
import { say } from "./texts.js";

/** Objections with which a robot continues no task; it may do so in spite of others. */
const READY = [
  ...["emergency_stop", "manual", "maintenance", "no_control_mode", "deployment", "schedule"],
  ...["no_work_mode", "not_initialised", "lost"],
];
/** Commands that are sent though the robot sends nothing. */
const INTERRUPTS = ["pause", "cancel"];
/** Commands of which each one counts, though the robot has not answered the former one. */
const REPEATED = ["sound", "speedLimit"];
const OF_SIMULATOR = ["fault", "endFault", "clearFaults"];

/**
 * @param {string} key
 * @param {Record<string, any>} values
 * @returns {import("./texts.js").Text}
 */
const text = (key, values = {}) => ({ key, values });

/**
 * Return why a command would do nothing now; null if the viewer may give it.
 * @param {string} name of a command, or `drive`
 */
export function refusal(name) {
  const link = store.link.value;
  const robot = store.robot.value;
  const owner = store.control.value?.owner;
  if (store.problem.value) return text(store.problem.value);
  if (OF_SIMULATOR.includes(name)) return null;
  if (!link || link.state !== "connected") return text(`link.${link?.state ?? "connecting"}`);
  if (link.silence && !INTERRUPTS.includes(name))
    return text("link.noData", { seconds: link.silence });
  if (!robot?.known) return text("notice.unknown");
  if (owner && !store.mine.value) return text("reason.controlled", { name: owner });
  if (store.isPending(name) && !REPEATED.includes(name)) return text("reason.pending");
  return refusalOf(robot, name);
}

/**
 * Return why the robot would refuse a command now, as far as that is certain.
 * @param {store.Robot} robot
 * @param {string} name
 */
function refusalOf({ task, objections }, name) {
  const doing = task?.running ? task.state : "";
  const drives = doing && doing !== "paused" ? text("objection.busy.reason") : null;
  /** @param {string[]} names */
  const objection = (...names) => {
    const found = objections.find((each) => names.includes(each.name));
    return found ? text(`objection.${found.name}.reason`) : null;
  };
  switch (store.MOVES.includes(name) ? "go" : name) {
    case "go":
      if (doing) return text("objection.busy.reason");
      return objection(...READY, "mapping", "following", "busy");
    case "drive":
      return objection("emergency_stop", "maintenance") ?? drives;
    case "pause":
      if (doing === "paused") return text("reason.paused");
      return doing ? null : text("objection.no_task.reason");
    case "cancel":
      return doing ? null : text("objection.no_task.reason");
    case "continue":
      return doing === "paused" ? objection(...READY) : text("reason.notPaused");
    case "setPose":
      return objection("mapping") ?? drives;
    case "keepPose":
    case "switchMap":
      return objection("mapping") ?? (doing ? text("objection.busy.reason") : null);
    default:
      return null;
  }
}

/**
 * Return the properties of a control that gives a command: off with the reason, if it would do nothing.
 * While it waits for its answer, it keeps the focus.
 * @param {string} name
 * @param {boolean} [complete] false if something is missing for the command
 */
export function gives(name, complete = true) {
  const reason = refusal(name);
  const waits = reason?.key === "reason.pending";
  return {
    disabled: !complete || (reason !== null && !waits),
    "aria-disabled": waits || undefined,
    title: reason ? say(reason) : undefined,
  };
}

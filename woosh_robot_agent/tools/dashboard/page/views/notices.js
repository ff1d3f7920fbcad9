// What is wrong with the robot, the link or this page, and what to do about it.

import { computed } from "../vendor/preact.js";
import { refusal } from "../allowed.js";
import * as commands from "../commands.js";
import * as store from "../store.js";
import { meaningOf, moment, say, t } from "../texts.js";
import { linkText, objectionText, toneOf } from "./parts.js";

/** @typedef {[string, () => void]} Action  text of a button, and what it does */
/**
 * @typedef {{name: string, tone: string, title: string, text: string, action?: Action}} Notice
 *   name: that of the objection, or another one; tone: a CSS class; text: what to do about it
 */

// Status codes that say the same as an objection, by its name, without their last digit: the level.
/** @type {Record<string, string[]>} */
const SAME_CODES = {
  emergency_stop: ["11020100001", "11020100002", "11020100003"],
  lost: ["13010300001"],
  not_initialised: ["13010300001"],
};
/** Objections without a notice, because they are no problem or, like a fault, have another notice. */
const ORDINARY = ["busy", "mapping", "not_taskable", "fault", "deployment"];

/** Number of the entries in the list of what is wrong, in the tab State. */
export const wrongCount = computed(
  () => store.alarms.value.size + notices().length + otherProblems().length,
);
/** CSS class of the worst entry; empty if there are none. */
export const wrongTone = computed(() => {
  const isBad = store.alarms.value.size || notices().some(({ tone }) => tone === "bad");
  return isBad ? "bad" : wrongCount.value ? "warn" : "";
});

/**
 * Return all notices, the most urgent first.
 * @returns {Notice[]}
 */
export function notices() {
  const found = [permissionNotice(), linkNotice(), limitNotice()];
  const robot = store.robot.value;
  if (robot?.known) {
    found.push(...robot.objections.map(objectionNotice), ...faultNotices());
    found.push(mapNotice(), standstillNotice(), poseNotice());
  }
  found.push(updateNotice());
  return found.filter((each) => each !== null);
}

/**
 * Return the text of the notice with this name; empty without one.
 * @param {string} name
 */
export function remedyOf(name) {
  return notices().find((each) => each.name === name)?.text ?? "";
}

/** @returns {Notice | null} */
function permissionNotice() {
  if (!store.lostControl.value) return null;
  const [title, text] = [t("notice.lostControl"), t("notice.lostControlRemedy")];
  return { name: "permission", tone: "bad", title, text };
}

/** @returns {Notice | null} */
function linkNotice() {
  if (!store.outdated.value) return null;
  const { short, long } = linkText();
  const { state, since = 0 } = store.link.value ?? {};
  const isLost = state === "lost" && !store.problem.value;
  const ended = isLost && t("notice.lostSince", { time: moment(since) });
  const shown = t(store.robot.value?.known ? "notice.outdated" : "notice.unknown");
  const text = [ended, long, shown].filter(Boolean).join(" ");
  return { name: "link", tone: "bad", title: short, text };
}

/** @returns {Notice | null} */
function updateNotice() {
  if (!store.updated.value) return null;
  const [title, text] = [t("notice.updated"), t("notice.updatedRemedy")];
  const action = /** @type {Action} */ ([t("notice.reload"), () => location.reload()]);
  return { name: "update", tone: "warn", title, text, action };
}

/** @returns {Notice | null} */
function limitNotice() {
  const limit = store.endedLimit.value;
  if (!limit) return null;
  const dismiss = () => store.forgetEndedLimits([store.address.value]);
  const [title, text] = [t("notice.limitEnded", { limit }), t("notice.limitEndedRemedy")];
  return { name: "limit", tone: "warn", title, text, action: [t("notice.dismiss"), dismiss] };
}

/**
 * Return a button for a command; undefined if the viewer may not give the command now.
 * @param {string} command
 * @param {string} label key of its text
 * @param {() => void} act
 * @returns {Action | undefined}
 */
function actionFor(command, label, act) {
  return store.mayControl.value && !refusal(command) ? [t(label), act] : undefined;
}

/**
 * Return the button of a command that may resolve an objection; undefined without one.
 * @param {string} objection name
 */
function objectionAction(objection) {
  switch (objection) {
    case "not_initialised":
    case "lost":
      return actionFor("setPose", "pose.set", commands.startPose);
    case "no_work_mode":
    case "schedule":
      return actionFor("workMode", "work.setTask", () =>
        commands.run("workMode", { mode: "task" }),
      );
    case "manual":
    case "no_control_mode":
    case "maintenance":
      return actionFor("controlMode", "control.setAuto", () =>
        commands.run("controlMode", { mode: "auto" }),
      );
    default:
      return undefined;
  }
}

/**
 * @param {store.Objection} objection
 * @returns {Notice | null}
 */
function objectionNotice(objection) {
  const { name } = objection;
  if (ORDINARY.includes(name)) return null;
  const { reason, remedy } = objectionText(objection);
  const tone = toneOf(objection);
  const isLocating = store.isPending("keepPose") || store.isPending("setPose");
  if (isLocating && store.LOST.includes(name))
    return { name, tone, title: reason, text: t("notice.locating") };
  return { name, tone, title: reason, text: remedy, action: objectionAction(name) };
}

/** Return a notice for each status code that reports a fault. @returns {Notice[]} */
function faultNotices() {
  const faults = unexplained().filter(({ level }) => level === "fault");
  return faults.map((code) => ({
    name: "fault",
    tone: "bad",
    title: t("notice.fault", { text: meaningOf(code) || code.text || code.code }),
    text: t("notice.faultRemedy", { code: code.code }),
  }));
}

/** @returns {Notice | null} */
function mapNotice() {
  const error = store.map.value?.error;
  if (!error) return null;
  const action = actionFor("switchMap", "tab.map", () => commands.openTab("map"));
  const mayChoose = action && !store.map.value?.resolution;
  const text = mayChoose ? t("map.noneRemedy", { reason: error }) : say(error);
  return { name: "map", tone: "warn", title: t("map.none"), text, action };
}

/** @returns {Notice | null} */
function standstillNotice() {
  const standstill = store.control.value?.standstill;
  if (!standstill) return null;
  return { name: "standstill", tone: "warn", title: t("notice.standstill"), text: say(standstill) };
}

/** @returns {Notice | null} */
function poseNotice() {
  const doubt = store.pose.value?.doubt;
  if (!doubt || store.dismissed.value.includes(doubtKey(doubt))) return null;
  const { reason, remedy } = objectionText(doubt);
  const { name } = doubt;
  // some maps always have the id 0
  const action = name === "map_id_0" ? dismissal(doubt) : undefined;
  return { name, tone: "warn", title: reason, text: remedy, action };
}

/**
 * Return the button after which the page does not warn of a pose again while the robot uses this map.
 * @param {store.Objection} doubt
 * @returns {Action}
 */
function dismissal(doubt) {
  const dismiss = () => (store.dismissed.value = [...store.dismissed.value, doubtKey(doubt)]);
  return [t("notice.dismiss"), dismiss];
}

/** @param {store.Objection} doubt */
function doubtKey({ name }) {
  const { scene, map } = store.shownMap.value;
  return [store.address.value, name, scene, map].join(" ");
}

/** Return the status codes of the robot that say something else than its objections. */
function unexplained() {
  const { problems = [], objections = [] } = store.robot.value ?? {};
  const same = objections.flatMap(({ name }) => SAME_CODES[name] ?? []);
  return problems.filter(({ code }) => !same.includes(code.slice(0, -1)));
}

/** Return the status codes of the robot that are in no notice. */
export function otherProblems() {
  return unexplained().filter(({ level }) => level !== "fault");
}

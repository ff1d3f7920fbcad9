// Small things that several views use: icons, and texts about robots, links, places and tasks.

import { html, useEffect, useState } from "../vendor/preact.js";
import * as store from "../store.js";
import { say, t, tOr } from "../texts.js";

const SETTLE = 1000; // milliseconds for which buttons that replace others are disabled

/** @type {Record<string, string>} SVG paths of the icons, in 24 x 24 pixels, by name */
const ICONS = {
  alarm: "M12 3 2 20h20zM12 10v4M12 17v.5",
  auto: "M12 3a9 9 0 1 0 0 18 9 9 0 1 0 0-18M8.500 16 12 7l3.500 9M9.700 13h4.600",
  battery: "M4 7h13a2 2 0 0 1 2 2v6a2 2 0 0 1-2 2H4a2 2 0 0 1-2-2V9a2 2 0 0 1 2-2M22 11v2",
  charge: "M13 2 5 14h6l-1 8 8-12h-6z",
  close: "M6 6l12 12M18 6 6 18",
  end: "M5 12l5 5L20 7",
  fit: "M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5",
  fleet: "M4 4h5v5H4zM15 4h5v5h-5zM4 15h5v5H4zM15 15h5v5h-5z",
  follow: "M12 5a7 7 0 1 0 0 14 7 7 0 1 0 0-14M12 2v5M12 17v5M2 12h5M17 12h5",
  go: "M12 21s-7-6.200-7-11a7 7 0 0 1 14 0c0 4.800-7 11-7 11M12 7.500a2.500 2.500 0 1 0 0 5 2.500 2.500 0 1 0 0-5",
  hand: "M5 9l-3 3 3 3M9 5l3-3 3 3M15 19l-3 3-3-3M19 9l3 3-3 3M2 12h20M12 2v20",
  keys: "M4 6h16a2 2 0 0 1 2 2v8a2 2 0 0 1-2 2H4a2 2 0 0 1-2-2V8a2 2 0 0 1 2-2M6 10h.1M10 10h.1M14 10h.1M18 10h.1M7 14h10",
  language:
    "M12 3a9 9 0 1 0 0 18 9 9 0 1 0 0-18M3 12h18M12 3c3.500 4 3.500 14 0 18M12 3c-3.500 4-3.500 14 0 18",
  layers: "M12 3l9 5-9 5-9-5zM3 13l9 5 9-5",
  left: "M4 12a8 8 0 1 1 3 6.200M4 7v5h5",
  map: "M9 4 3 6.500v13.500l6-2.500 6 2.500 6-2.500V4l-6 2.500zM9 4v13.500M15 6.500V20",
  minus: "M5 12h14",
  north: "M12 3l5 17-5-4-5 4z",
  park: "M5 3h14a2 2 0 0 1 2 2v14a2 2 0 0 1-2 2H5a2 2 0 0 1-2-2V5a2 2 0 0 1 2-2M9 17V7h4a3 3 0 0 1 0 6H9",
  pause: "M8 5v14M16 5v14",
  play: "M7 4l12 8-12 8z",
  plus: "M12 5v14M5 12h14",
  pose: "M12 2v6M12 16v6M2 12h6M16 12h6M12 9a3 3 0 1 0 0 6 3 3 0 1 0 0-6",
  repeat: "M4 11a8 8 0 0 1 14-4l2 2M20 4v5h-5M20 13a8 8 0 0 1-14 4l-2-2M4 20v-5h5",
  right: "M20 12a8 8 0 1 0-3 6.200M20 7v5h-5",
  ruler: "M3 17 17 3l4 4L7 21zM7 13l2 2M10 10l2 2M13 7l2 2",
  setup:
    "M4 7h9M17 7h3M4 17h3M11 17h9M15 5a2 2 0 1 0 0 4 2 2 0 1 0 0-4M9 15a2 2 0 1 0 0 4 2 2 0 1 0 0-4",
  simulator:
    "M9 3h6M10 3v6L5 19a1.500 1.500 0 0 0 1.500 2h11a1.500 1.500 0 0 0 1.500-2L14 9V3M7.500 15h9",
  state: "M3 12h4l2.500-7 5 14L17 12h4",
  tasks: "M9 6h11M9 12h11M9 18h11M4 6h.1M4 12h.1M4 18h.1",
};

/** @param {{name: string, children?: unknown}} props  children: what is drawn into the icon */
export function Icon({ name, children }) {
  return html`<svg class="icon" viewBox="0 0 24 24" aria-hidden="true">
    <path d=${ICONS[name]} />
    ${children}
  </svg>`;
}

/**
 * Return the name of a robot for people.
 * @param {{id: number, name: string, model?: string}} robot
 */
export function robotName({ id, name, model }) {
  const number = id ? String(id) : "";
  const known = [number, name === number ? "" : name, model ?? ""].filter(Boolean);
  return known.join(" · ") || t("robot.unnamed");
}

/**
 * Return the name that tells a robot from the others; for robots with the same name or number, it
 * begins with the address.
 * @param {string} robot address
 */
export function robotLabel(robot) {
  const cards = store.fleet.value.filter(({ known }) => known);
  const card = cards.find((each) => each.address === robot);
  const address = robot.replace(/^\w+:\/\//, "");
  if (!card) return address;
  const name = robotName(card);
  const same = cards.filter((each) => (card.id ? each.id === card.id : robotName(each) === name));
  return same.length > 1 ? `${address} · ${name}` : name;
}

/**
 * Return the first part of `robotLabel`, for small places; empty if there is only this robot.
 * @param {string} robot address
 */
export function shortLabel(robot) {
  const isOnly = store.robots.value.every((each) => each === robot);
  return isOnly ? "" : robotLabel(robot).split(" · ")[0];
}

/**
 * Return `shortLabel` in parentheses, to be added to a text.
 * @param {string} robot address
 */
export function ofRobot(robot) {
  const label = shortLabel(robot);
  return label && ` (${label})`;
}

/** Return the state of the connection in few words, and its cause. */
export function linkText() {
  const link = store.link.value;
  if (store.problem.value) return { short: t(store.problem.value), long: "" };
  if (!link) return { short: t("link.connecting"), long: "" };
  if (link.silence) {
    return { short: t("link.noData", { seconds: link.silence }), long: t("link.noDataReason") };
  }
  const long = [say(link.error), link.advice && t("link.doctor", { options: link.advice })];
  return { short: t(`link.${link.state}`), long: long.filter(Boolean).join(". ") };
}

/**
 * Return a text that a screen reader does not read again when only its numbers change, e.g. seconds.
 * @param {string} text
 */
export function withQuietNumbers(text) {
  return text
    .split(/(\d+)/)
    .map((each, index) => (index % 2 ? html`<span aria-live="off">${each}</span>` : each));
}

/**
 * Return the alarm of robots that may move after a stop.
 * @param {string[]} robots addresses
 */
export function alarmText(robots) {
  return t("alarm.stop") + robots.map(ofRobot).join("");
}

/**
 * Return a place in metres.
 * @param {{x: number, y: number}} place
 */
export function placeText({ x, y }) {
  return `${x.toFixed(2)}, ${y.toFixed(2)} m`;
}

/** @param {number} angle in radians */
export function degrees(angle) {
  return `${Math.round((angle * 180) / Math.PI)}°`;
}

/** Return a work mode so that it does not read as a task that runs. @param {string} work */
export function workText(work) {
  return work === "task" ? t("work.taskMode") : tOr(`work.${work}`, work);
}

/** Return scene and map. @param {{scene: string, map: string}} names */
export function mapText({ scene, map }) {
  return [scene, map].filter(Boolean).join(" · ");
}

/** Return the speed of a robot, ahead and turning. @param {store.Motion} motion */
export function speedTexts({ linear, angular }) {
  return [`${linear.toFixed(2)} m/s`, `${degrees(angular)}/s`];
}

/**
 * Return the destination of a task; if that is not known, its kind.
 * @param {import("../store.js").Task} task
 */
export function destination({ type, to, place, command }) {
  if (to) return to;
  if (command.args?.mark) return String(command.args.mark);
  if (place) return placeText({ x: place[0], y: place[1] });
  return type === "unknown" ? t("task.unnamed") : taskType(type);
}

/**
 * Return where the robot goes; if that is not known, what kind of task it executes.
 * @param {import("../store.js").Task} task
 */
export function goalText(task) {
  const known = task.to || task.place || task.command.args?.mark;
  return known ? t("dock.to", { place: destination(task) }) : destination(task);
}

/** Kinds of tasks that the page gives. */
export const TYPES = ["pick", "parking", "charge", "carry"];

/** @param {string} type of a task */
export function taskType(type) {
  return tOr(`type.${type}`, type);
}

/**
 * Return an objection, e.g. a reason against a new task, in the language of the page.
 * @param {import("../store.js").Objection} objection
 */
export function objectionText({ name, reason, remedy }) {
  return {
    reason: tOr(`objection.${name}.reason`, reason),
    remedy: tOr(`objection.${name}.remedy`, remedy),
  };
}

/**
 * Return the CSS class of an objection.
 * @param {import("../store.js").Objection} objection
 */
export function toneOf({ name }) {
  return name === "emergency_stop" || name === "hardware" ? "bad" : "warn";
}

/**
 * Return true for a moment if new buttons replace others, so that a press that was aimed at the others
 * does nothing.
 * @param {boolean} replaces
 */
export function useSettling(replaces) {
  const [settles, setSettles] = useState(replaces);
  useEffect(() => {
    const timer = setTimeout(() => setSettles(false), SETTLE);
    return () => clearTimeout(timer);
  }, []);
  return settles;
}

/** @type {Record<string, string>} CSS classes of the levels of status codes; the others have none */
export const LEVEL_CLASSES = { fault: "bad", warn: "warn" };

/** Media query for screens on which the panel is a sheet over the map; style.css has the same one. */
export const compact = matchMedia("(max-width: 999px), (max-height: 599px)");

/** Media query for screens on which a notice is folded to one line. */
export const tiny = matchMedia("(max-width: 479px), (max-height: 599px)");

/**
 * Return what drives the robot, in the language of the page.
 * @param {import("../texts.js").Value} name
 */
export function driverText(name) {
  return typeof name === "string" ? tOr(`driver.${name}`, name) : say(name);
}

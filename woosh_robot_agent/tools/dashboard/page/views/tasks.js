// The tasks of the robot: the running task, and the outcomes of earlier tasks.

import { html } from "../vendor/preact.js";
import { commandProps } from "../allowed.js";
import { forgetTarget, run, setTarget } from "../commands.js";
import * as store from "../store.js";
import { clock, meaningOf, moment, t, tOr } from "../texts.js";
import { destination, goalText, Icon, TYPES, taskType } from "./parts.js";

/** @type {Record<string, string>} CSS classes of the outcomes of tasks */
export const TONES = { completed: "ok", canceled: "warn", failed: "bad", unseen: "bad" };
// keys of the texts for those who give tasks and are no viewers; empty to show nobody
/** @type {Record<string, string>} */
const SOURCES = {
  "the robot itself": "by.robot",
  "another client": "by.other",
  unknown: "",
  nobody: "",
};
const WAITING = ["action wait", "task wait"]; // states that the command `endWait` ends

export function Tasks() {
  const tasks = store.tasks.value;
  const running = tasks.filter((each) => each.running);
  const ended = tasks.filter((each) => !each.running);
  const known = store.robot.value?.known;
  return html`<section>
      <h2>${t("tasks.running")}</h2>
      ${
        running.length
          ? html`<ul class="rows" id="running">
              ${running.map((task) => html`<${Entry} key=${task.id} task=${task} />`)}
            </ul>`
          : html`<p class="faint">${t(known ? "tasks.none" : "tasks.unknown")}</p>`
      }
    </section>
    <section>
      <h2>${t("tasks.ended")}</h2>
      ${
        ended.length > 0 &&
        store.mayControl.value &&
        isBusy() &&
        html`<p class="faint">${t("tasks.repeatOff")}</p>`
      }
      ${
        ended.length
          ? html`<ul class="rows" id="ended">
              ${ended.map((task) => html`<${Entry} key=${task.id} task=${task} />`)}
            </ul>`
          : html`<p class="faint">${t(known ? "tasks.noneEnded" : "tasks.unknown")}</p>`
      }
    </section>`;
}

const isBusy = () => Boolean(store.robot.value?.task?.running);

/**
 * Return the buttons for the running task. Each keeps its place, so that a repeated press of Pause
 * does not hit Continue.
 */
export function taskButtons() {
  /**
   * @param {string} id
   * @param {string} icon
   * @param {string} name of the command
   */
  const button = (id, icon, name = id) => {
    const label = t(`command.${name}`);
    const { title = tOr(`command.${name}.title`, label), ...state } = commandProps(name);
    return html`<button
      type="button"
      id=${id}
      title=${title}
      ...${state}
      onClick=${() => run(name)}
    >
      <${Icon} name=${icon} /><span>${label}</span>
    </button>`;
  };
  const task = store.robot.value?.task;
  const waits = task?.running && WAITING.includes(task.state);
  return html`${button("pause", "pause")}${button("continue", "play")}${button("cancel", "close")}
  ${waits && button("end-wait", "end", "endWait")}`;
}

/**
 * Return the state of the running task, with the way left while it drives.
 * @param {import("../store.js").RunningTask} task
 */
export function taskState({ state, action, actionState }) {
  const acts = action && !["paused", "held up"].includes(state);
  const left = acts && action === "nav" && store.wayLeft.value;
  const hindrance =
    ["warning", "traffi ctrl"].includes(actionState) && t(`actionState.${actionState}`);
  const doing = acts && !left && tOr(`action.${action}`, action);
  const names = [tOr(`task.${state}`, state), doing, hindrance].filter(Boolean).join(" · ");
  // a screen reader does not tell each change of the way
  const way =
    left && html`<span aria-live="off">${` · ${t("task.left", { length: left })}`}</span>`;
  return [names, way];
}

/** @param {{task: store.Task}} props */
function Entry({ task }) {
  const { begun, changed, code, by } = task;
  const times =
    begun && changed && !task.running
      ? `${moment(begun)} – ${clock(changed)}`
      : moment(begun || changed);
  const source = Object.hasOwn(SOURCES, by) ? SOURCES[by] && t(SOURCES[by]) : byViewer(by);
  const about = [times, task.type !== "unknown" && taskType(task.type), source];
  const reason = code && codeText(code);
  return html`<li>
    <div>
      <p>
        <span class=${TONES[task.state] ?? "accent"}>${tOr(`task.${task.state}`, task.state)}</span>
        ${" · "}<b>${destination(task)}</b>
      </p>
      <small>${about.filter(Boolean).join(" · ")}</small>
      ${task.text && html`<small>${task.text}</small>`}
      ${reason && html`<small class="bad">${reason}</small>`}
    </div>
    <${Repeat} task=${task} />
  </li>`;
}

/** @param {store.Code} code */
const codeText = (code) => `${meaningOf(code) || code.text} (${code.code})`;

/**
 * Return the outcome of a task, with the reason.
 * @param {store.Task} task
 */
export function outcomeText(task) {
  const state = tOr(`task.${task.state}`, task.state);
  const reason = task.code ? codeText(task.code) : task.text;
  return [goalText(task), state, reason].filter(Boolean).join(" · ");
}

/** @param {string} name */
function byViewer(name) {
  return name === store.you.value ? t("by.you") : name && t("by.viewer", { name });
}

/**
 * Return the target of an earlier task, with the kind of the task; null if that is not known.
 * @param {store.Task} task
 * @returns {store.Target | null}
 */
function targetOf(task) {
  const { name, args } = task.command;
  const kind = {
    type: args?.type ?? (TYPES.includes(task.type) ? task.type : "pick"),
    number: args?.number ?? 0,
    direction: args?.direction ?? "unknown",
  };
  if (name === "charge") return { command: name, plan: null, kind };
  const mark = args?.mark ?? task.to;
  if (mark) {
    const known = store.map.value?.marks?.find(({ number }) => number === mark);
    const pose = known && { x: known.x, y: known.y, theta: known.theta };
    return { command: "goMark", mark, pose, plan: null, kind };
  }
  if (name !== "go" || !args) return null;
  return { command: name, pose: { x: args.x, y: args.y, theta: args.theta }, plan: null, kind };
}

/**
 * Return true if a task went to a place of the map that is shown, and the map was not changed since.
 * @param {store.Task} task
 * @param {store.Target} target
 */
function isHere({ scene, map, version }, { command, pose }) {
  const shown = store.shownMap.value;
  if (command === "charge") return true;
  if (!map) return pose !== undefined;
  return scene === shown.scene && map === shown.map && version === shown.version;
}

/**
 * Button that selects the target of an earlier task again. The viewer then starts it as a new task.
 * @param {{task: store.Task}} props
 */
function Repeat({ task }) {
  if (!store.mayControl.value || task.running) return null;
  const target = targetOf(task);
  if (!target) return null;
  const here = isHere(task, target);
  const label = t(here ? "tasks.repeat" : "tasks.otherMap", { place: destination(task) });
  const busy = isBusy();
  return html`<button
    type="button"
    class="quiet"
    title=${busy ? t("tasks.repeatOff") : label}
    aria-label=${label}
    disabled=${busy || !here}
    onClick=${() => {
      forgetTarget(); // also ends what was begun on the map
      setTarget(target);
    }}
  >
    <${Icon} name="repeat" />
  </button>`;
}

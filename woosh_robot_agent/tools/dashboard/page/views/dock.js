// The current task of the robot, and the stick, whose place on the screen never changes.

import { html, useEffect, useRef } from "../vendor/preact.js";
import { commandProps, refusal } from "../allowed.js";
import * as commands from "../commands.js";
import { checkStickPlace, keysOff, stickPlace, toggleSlow } from "../drive.js";
import * as store from "../store.js";
import { say, t, tOr } from "../texts.js";
import {
  degrees,
  driverText,
  goalText,
  Icon,
  placeText,
  speedTexts,
  useSettling,
} from "./parts.js";
import { TaskOptions } from "./go.js";
import { remedyOf, wrongTone } from "./notices.js";
import { taskButtons, taskState } from "./tasks.js";

const TURN = Math.PI / 180; // radians by which a button turns the pose
const TRAVEL = 132; // half of the stick's width, in percent of the knob's width

export function Dock() {
  return html`<section class="dock ${tone()}" aria-label=${t("dock.name")}>
    <div class="doing">
      <${ControlOwner} />
      <${CurrentTask} />
    </div>
    <${Stick} />
  </section>`;
}

function ControlOwner() {
  const keysSwitch = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => {
    const observer = new IntersectionObserver((entries) => {
      if (entries.some(({ isIntersecting }) => !isIntersecting)) keysOff();
    });
    observer.observe(/** @type {HTMLElement} */ (keysSwitch.current));
    return () => {
      observer.disconnect();
      keysOff();
    };
  }, []);
  const owner = store.control.value?.owner ?? null;
  const isMine = store.hasControl.value;
  const text = !owner
    ? t("owner.nobody")
    : isMine
      ? t("owner.you")
      : t("owner.other", { name: owner });
  return html`<div class="owner">
    <p id="owner" role="status">${text}</p>
    ${
      isMine &&
      html`<button type="button" class="quiet" id="release" onClick=${commands.release}>
        ${t("owner.release")}
      </button>`
    }
    <button
      type="button"
      class="quiet"
      id="keyboard"
      ref=${keysSwitch}
      aria-pressed=${store.keyboard.value}
      title=${t("keyboard.title")}
      aria-label=${t("keyboard.title")}
      onClick=${() => (store.keyboard.value = !store.keyboard.value)}
    >
      <${Icon} name="keys" />
    </button>
    <button
      type="button"
      class="quiet"
      id="slow"
      aria-pressed=${store.slow.value}
      title=${t("slow.title")}
      onClick=${toggleSlow}
    >
      ${t("slow.name")}
    </button>
  </div>`;
}

/** The task that runs, or else the target or pose that the viewer has begun to set. */
function CurrentTask() {
  const task = store.robot.value?.task;
  const drives = task?.running && task.state !== "paused";
  if (store.tool.value === "pose" && !drives) return html`<${PoseDraft} />`;
  if (task?.running) return html`<${Running} />`;
  if (store.target.value) return html`<${Preview} />`;
  const isHeld = store.held.value !== null;
  const reason = refusal("go");
  const mayGo = !isHeld && !reason && !hasFault();
  const isBusy = reason?.key === "objection.busy.reason"; // the report of the task comes later
  const isAuto = store.robot.value?.control === "auto";
  const mayDrive = !isHeld && !refusal("drive") && isAuto && !isBusy && !hasFault();
  const speed = store.stickLimits.value.linear;
  const { title, notice } = shownState();
  const hints = [
    remedyOf(notice),
    mayGo && t(store.tool.value === "go" ? "dock.hint" : "dock.hintMove"),
    mayDrive && speed && t("dock.hintDrive", { speed: speed.toFixed(2) }),
    limitText(),
  ];
  return html`<${Now} title=${title} text=${hints.filter(Boolean).join(" ")} />`;
}

/** Return the speed limit, or that the robot has refused it; empty without one. */
function limitText() {
  const { speedLimit: limit, speedRefusal } = store.control.value ?? {};
  if (!limit) return "";
  return speedRefusal ? t("dock.limitRefused") : t("dock.limit", { limit });
}

/**
 * Texts about the robot. While its state is outdated, a notice replaces `text`.
 * @param {{title: unknown, text: unknown, more?: string, button?: unknown}} props
 */
function Now({ title, text, more = "", button }) {
  const old = store.outdated.value;
  return html`<div class="now ${old ? "old" : ""}" id="now">
    <b>${title}</b>
    <p role="status">
      ${old ? t(store.robot.value?.known ? "notice.outdated" : "notice.unknown") : text}
    </p>
    ${button} ${more && html`<p>${more}</p>`}
  </div>`;
}

/**
 * Return the speed, or why the robot takes no task, or else its state.
 * @returns {{title: unknown, notice: string}}  notice: name of the notice about it; may be empty
 */
function shownState() {
  const { robot, pose, outdated } = store;
  const { linear = 0, angular = 0 } = pose.value ?? {};
  const drives = linear || angular || (store.held.value && !refusal("drive"));
  if (pose.value && !outdated.value && drives) {
    const [forward, turn] = speedTexts(pose.value);
    return { title: html`<span class="speed">${forward}</span> · ${turn}`, notice: "" };
  }
  const reason = refusal("go");
  if (reason && reason.key !== "reason.controlled")
    return { title: say(reason), notice: reason.objection ?? "" };
  if (hasFault()) return { title: t("state.fault"), notice: "fault" };
  const state = robot.value?.state ?? "";
  const driver = store.control.value?.driver.name ?? "nobody";
  if (state === "idle" && driver !== "nobody" && driver !== "unknown")
    return { title: t("dock.drivenBy", { driver: driverText(driver) }), notice: "" };
  return { title: tOr(`state.${state}`, state), notice: "" };
}

/** Return the CSS class of the worst that is wrong, or else of a robot that moves or has a task. */
function tone() {
  if (wrongTone.value || store.outdated.value) return wrongTone.value;
  const { linear = 0, angular = 0 } = store.pose.value ?? {};
  return store.robot.value?.task?.running || linear || angular ? "accent" : "";
}

const hasFault = () => store.robot.value?.problems.some(({ level }) => level === "fault");

let shownButtons = 0; // number of `Buttons` on the page

/**
 * Buttons below these texts. If they replace others, they are disabled for a moment.
 * @param {{children?: unknown}} props
 */
function Buttons({ children }) {
  const off = useSettling(shownButtons > 0);
  useEffect(() => {
    shownButtons++;
    return () => {
      shownButtons--;
    };
  }, []);
  return html`<fieldset class="act" disabled=${off}>${children}</fieldset>`;
}

function PoseDraft() {
  const draft = store.draft.value;
  const reason = refusal("setPose");
  const question = draft && `${placeText(draft)} · ${degrees(draft.theta)}. ${t("pose.laser")}`;
  /** @param {number} angle */
  const turn = (angle) => {
    if (draft) store.draft.value = { ...draft, theta: draft.theta + angle };
  };
  return html`<div class="now" id="now">
      <b>${draft ? t("pose.question") : t("pose.set")}</b>
      <p>${reason ? say(reason) : (question ?? t("pose.drag"))}</p>
    </div>
    <${Buttons}>
      ${Object.entries({ left: TURN, right: -TURN }).map(
        ([side, angle]) =>
          html`<button
            type="button"
            key=${side}
            aria-label=${t(`pose.${side}`)}
            disabled=${!draft}
            onClick=${() => turn(angle)}
          >
            <${Icon} name=${side} />
          </button>`,
      )}
      <button
        type="button"
        class="primary"
        id="confirm"
        ...${commandProps("setPose", draft !== null)}
        onClick=${commands.confirmPose}
      >
        ${t("pose.confirm")}
      </button>
      <${Dismiss} />
    <//>`;
}

function Dismiss() {
  return html`<button
    type="button"
    id="dismiss"
    aria-label=${t("target.cancel")}
    onClick=${commands.forgetTarget}
  >
    <${Icon} name="close" />
  </button>`;
}

/**
 * Return the name or place of a target, and the length of the path or why there is none.
 * @param {import("../store.js").Target} target
 */
function targetTexts({ plan, mark, pose }) {
  const to = mark ?? (pose ? placeText(pose) : t("type.charge"));
  if (!store.mayControl.value || !pose) return [to, ""];
  if (!plan) return [to, t("target.planning")];
  if ("error" in plan) return [to, t("target.noPath", { reason: plan.error })];
  return [to, t("target.length", { length: plan.length.toFixed(1) })];
}

/** The target, the path to it, and the button that sends the robot there. */
function Preview() {
  const target = /** @type {import("../store.js").Target} */ (store.target.value);
  const { mark, pose, command } = target;
  const may = store.mayControl.value;
  const [to, pathText] = targetTexts(target);
  const reason = may && refusal(command);
  const markOnMap = store.map.value?.marks?.find(({ number }) => number === mark);
  const about = markOnMap
    ? [
        tOr(`mark.${markOnMap.type}`, markOnMap.type),
        markOnMap.text,
        placeText(markOnMap),
        degrees(markOnMap.theta),
      ]
    : pose
      ? [degrees(pose.theta)]
      : [];
  // the key resets what the viewer has selected when the target or its kind of task changes
  return html`<div class="now" id="now">
      <b>${to}${pathText && html` <span class="way">${pathText}</span>`}</b>
      <p>${reason ? say(reason) : about.filter(Boolean).join(" · ")}</p>
    </div>
    <${Buttons}>
      ${may && html`<${TaskOptions} key=${`${to} ${JSON.stringify(target.kind)}`} target=${target} command=${command} />`}
      <${Dismiss} />
    <//>`;
}

/** The task that runs or is paused, and the target that the viewer has set meanwhile. */
function Running() {
  const task = store.robot.value?.task;
  if (!task) return null;
  const entry = store.running.value; // knows where the task goes
  const target = store.target.value;
  const hindrance = task.state === "paused" ? refusal("continue") : null;
  const whyNotContinued = hindrance ? say(hindrance) : "";
  const reason = target && refusal(target.command);
  const whyNotSent = reason ? say(reason) : "";
  // only the remedy if a notice says the reason; not the robot's text, too, which may say the same
  const remedy = hindrance?.objection && !target ? remedyOf(hindrance.objection) : "";
  const told = remedy || whyNotContinued || task.text;
  const text = [taskState(task), told && ` · ${told}`];
  const keeps = !whyNotContinued && !target && t("dock.keeps");
  const more = [
    limitText(),
    ...(target ? targetTexts(target) : []),
    whyNotSent !== whyNotContinued && whyNotSent, // one reason is shown once
  ];
  return html`<${Now}
      title=${entry ? goalText(entry) : shownState().title}
      text=${[text, keeps && html`<span class="keeps">${` · ${keeps}`}</span>`]}
      more=${more.filter(Boolean).join(" · ")}
      button=${target && html`<${Dismiss} />`}
    />
    <${Buttons}>${taskButtons()}<//>`;
}

function Stick() {
  const stick = useRef(/** @type {HTMLElement | null} */ (null));
  const grip = store.grip.value;
  const reason = refusal("drive");
  useEffect(() => {
    const { current } = stick;
    if (!grip || !current) return undefined;
    return () => {
      if (current.hasPointerCapture(grip.id)) current.releasePointerCapture(grip.id);
    };
  }, [grip?.id]);

  /** Drive by the distance of the pointer from where it went down. @param {PointerEvent} event */
  const move = (event) => {
    checkStickPlace();
    const { value } = store.grip;
    if (!value || event.pointerId !== value.id || !stick.current) return;
    if (event.buttons !== 1) {
      store.letGo(); // another button is down too, or the release was not seen
      return;
    }
    const radius = stick.current.offsetWidth / 2;
    let right = (event.clientX - value.start.x) / radius;
    let up = (value.start.y - event.clientY) / radius;
    const length = Math.hypot(right, up);
    if (length > 1) [right, up] = [right / length, up / length];
    store.grip.value = { ...value, right, up };
  };
  /** @param {PointerEvent} event */
  const press = (event) => {
    if (store.held.value || event.button !== 0) return;
    stick.current?.setPointerCapture(event.pointerId);
    const start = { x: event.clientX, y: event.clientY };
    store.grip.value = { id: event.pointerId, start, place: stickPlace(), right: 0, up: 0 };
  };
  /** @param {PointerEvent} event */
  const end = (event) => {
    if (event.pointerId === store.grip.value?.id) store.letGo();
  };
  const shift = grip ? `translate(${grip.right * TRAVEL}%, ${-grip.up * TRAVEL}%)` : "";
  return html`<div
    class="stick ${reason ? "off" : ""}"
    id="stick"
    ref=${stick}
    role="img"
    aria-label=${t("stick.title")}
    title=${reason ? say(reason) : t("stick.title")}
    onPointerDown=${press}
    onPointerMove=${move}
    onPointerUp=${end}
    onPointerCancel=${end}
    onLostPointerCapture=${end}
    onContextMenu=${(/** @type {Event} */ event) => event.preventDefault()}
  >
    <div class="knob" style=${{ transform: shift }}></div>
  </div>`;
}

/** The dock of a viewer who may only look: the state, without the stick. */
export function ReadOnly() {
  const task = store.robot.value?.task;
  const entry = store.running.value;
  const target = store.target.value;
  const state = shownState();
  const title = task?.running && entry ? goalText(entry) : state.title;
  const looking = [remedyOf(state.notice), t("dock.looking")].filter(Boolean).join(" ");
  const text = task?.running ? taskState(task) : looking;
  return html`<section class="dock looking ${tone()}" aria-label=${t("dock.name")}>
    ${target ? html`<div class="doing"><${Preview} /></div>` : html`<${Now} title=${title} text=${text} />`}
  </section>`;
}

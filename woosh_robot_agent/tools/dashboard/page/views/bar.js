// The bar at the top: robot, link, battery, mode, alarms, and STOP, which never moves.

import { html, useRef } from "../vendor/preact.js";
import { chooseRobot, openTab, stop, tell } from "../commands.js";
import * as store from "../store.js";
import { alarmCount, LANGUAGES, language, setLanguage, t, tOr } from "../texts.js";
import { wrongCount, wrongTone } from "./notices.js";
import {
  Icon,
  linkText,
  robotLabel,
  robotName,
  shortLabel,
  withQuietNumbers,
  workText,
} from "./parts.js";

export function Bar() {
  return html`<header class="bar">
    <${RobotName} />
    <div class="chips">
      <${LinkChip} />
      <${BatteryChip} />
      <${ModeChip} />
      <${AlarmChip} />
    </div>
    <${Language} />
    ${store.mayControl.value && html`<${Stop} />`}
  </header>`;
}

function RobotName() {
  const robot = store.robot.value;
  const cards = store.fleet.value;
  const name = robot?.known ? robotName(robot) : robotLabel(store.address.value);
  if (store.robots.value.length < 2) return html`<h1 class="name">${name}</h1>`;
  return html`<h1 class="name">
    <select
      id="robots"
      aria-label=${t("robot.choose")}
      value=${String(store.chosen.value)}
      onChange=${(/** @type {any} */ event) => chooseRobot(Number(event.currentTarget.value))}
    >
      ${store.robots.value.map((address, index) => {
        const { link, moves } = cards[index] ?? {};
        const also =
          link === "connected" && moves && index !== store.chosen.value && t("fleet.moves");
        const shown = [robotLabel(address), also].filter(Boolean).join(" · ");
        return html`<option key=${index} value=${String(index)}>${shown}</option>`;
      })}
    </select>
  </h1>`;
}

function LinkChip() {
  const good = !store.outdated.value;
  const { short, long } = linkText();
  const delay = store.link.value?.delay;
  return html`<div class="chip ${good ? "" : "bad"}" id="link" role="status" title=${long}>
    <span class="dot ${good ? "ok" : "bad"}"></span>
    <span class=${good ? "wide" : ""}>${withQuietNumbers(short)}</span>
    ${good && delay !== null && html`<small class="wide delay" aria-live="off">${delayText(delay ?? 0)}</small>`}
  </div>`;
}

/** Return a delay, short enough for the bar. @param {number} delay in milliseconds */
function delayText(delay) {
  return delay < 1000 ? `${delay} ms` : `${(delay / 1000).toFixed(1)} s`;
}

function BatteryChip() {
  const battery = store.robot.value?.battery;
  const low = battery && battery.power <= (battery.low || 20) && !battery.charging;
  const icon = battery?.charging
    ? html`<${Icon} name="charge" />`
    : html`<${Icon} name="battery">
        <rect x="4.5" y="9.5" height="5" width=${0.12 * (battery?.power ?? 0)} />
      <//>`;
  return html`<div class="chip battery ${low ? "warn" : ""}" title=${t("robot.battery")}>
    ${icon}
    <span class="power">${battery ? `${battery.power} %` : "–"}</span>
  </div>`;
}

function ModeChip() {
  const robot = store.robot.value;
  const control = robot?.control ?? "unknown";
  const work = robot?.work;
  // a narrow screen has room for one mode: the one that keeps the robot from tasks
  const workHinders = control === "auto" && work && work !== "task";
  return html`<div
    class="chip mode ${control === "auto" && !workHinders ? "" : "warn"}"
    title=${t("robot.mode")}
  >
    <${Icon} name="auto" />
    <span class=${workHinders ? "wide" : ""}>${tOr(`control.${control}`, control)}</span>
    <small class=${workHinders ? "" : "wide"}>${work && workText(work)}</small>
  </div>`;
}

function AlarmChip() {
  const count = wrongCount.value;
  const calm = !count && store.robot.value?.known;
  const text = calm ? t("alarms.none") : alarmCount(count);
  return html`<button
    type="button"
    class="chip ${wrongTone.value}"
    aria-label=${text}
    title=${text}
    onClick=${() => openTab("state")}
  >
    <${Icon} name=${calm ? "end" : "alarm"} />
    ${!calm && html`<span class="narrow">${count}</span>`}
    <span class="wide">${text}</span>
  </button>`;
}

function Language() {
  const known = Object.entries(LANGUAGES);
  const [other, name] = known.find(([code]) => code !== language.value) ?? known[0];
  return html`<button
    type="button"
    class="quiet"
    id="language"
    lang=${other}
    aria-label=${name}
    onClick=${() => setLanguage(other).catch(() => tell(false, { key: "reason.noConnection", values: {} }))}
  >
    <${Icon} name="language" />
    <span class="wide">${name}</span>
  </button>`;
}

/** Return a label that may only be broken before the port of its address. @param {string} label */
function breakable(label) {
  return label.split(/(?<=:)(?=\d+$)/).map((each, index) => [index > 0 && html`<wbr />`, each]);
}

function Stop() {
  const pointer = useRef(/** @type {number | null} */ (null)); // id of the last pointer on STOP
  return html`<button
    type="button"
    id="stop"
    title=${t("stop.title")}
    aria-keyshortcuts="Escape"
    onPointerDown=${(/** @type {PointerEvent} */ event) => {
      // on the press, because there is no click while another finger holds the stick
      pointer.current = event.pointerId;
      stop();
    }}
    onClick=${(/** @type {PointerEvent} */ event) => {
      // a click without a press comes from the keyboard or from an assistive technology
      if (event.pointerId !== pointer.current) stop();
      pointer.current = null;
    }}
  >
    ${t("stop.name")}<small>${breakable(shortLabel(store.address.value))}</small><kbd>Esc</kbd>
  </button>`;
}

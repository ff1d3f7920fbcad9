// The map with its tools, the notices over it, and the line below it.

import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import * as commands from "../commands.js";
import { MapCanvas, ZOOM_STEP } from "../map/map.js";
import * as store from "../store.js";
import { clock, say, t } from "../texts.js";
import { notices, otherProblems } from "./notices.js";
import { useMatches } from "./panel.js";
import { alarmText, Icon, mapText, ofRobot, placeText, tiny, withQuietNumbers } from "./parts.js";
import { outcomeText, TONES } from "./tasks.js";

/** @type {Record<string, [string, string][]>} how each layer looks: paths in 24 x 24 pixels with their style */
const SWATCHES = {
  laser: [
    ["M4 18h2v2H4zM7 16h2v2H7zM11 13h2v2h-2zM14 9h2v2h-2zM18 5h2v2h-2z", "fill: var(--laser)"],
  ],
  path: [["M3 18 10 9l4 4 7-8", "stroke: var(--accent); stroke-width: 3"]],
  footprint: [
    ["M4 7h16v10H4z", "fill: var(--accent)"],
    ["M17 12l-5-3v6z", "fill: var(--on-accent)"],
  ],
  trail: [["M3 18 10 9l4 4 7-8", "stroke: var(--faint); stroke-width: 1.5; stroke-dasharray: 3 5"]],
  marks: [
    ["M12 4a8 8 0 1 0 0 16 8 8 0 1 0 0-16", "stroke: var(--accent); stroke-width: 1.5"],
    ["M17.500 12 9 8v8z", "fill: var(--accent)"],
  ],
  keepout: [["M0 0h24v24H0z", "fill: var(--fault); fill-opacity: 0.275"]],
  zones: [
    [
      "M4 4h16v16H4z",
      "fill: var(--warning); fill-opacity: 0.1; stroke: var(--warning); stroke-opacity: 0.8",
    ],
    ["M0 12h24", "stroke: var(--edge); stroke-dasharray: 2 4"],
  ],
  others: [
    ["M4 7h16v10H4z", "fill: var(--edge)"],
    ["M17 12l-5-3v6z", "fill: var(--map-floor)"],
  ],
};

/** @type {MapCanvas | null} */
let map = null;

export function Stage() {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    map = new MapCanvas(/** @type {HTMLCanvasElement} */ (canvas.current));
    Object.assign(globalThis, { mapCanvas: map }); // for the console of the browser, and for tests
  }, []);
  return html`<main class="stage ${store.outdated.value ? "outdated" : ""}">
    <${Tools} />
    <div class="map">
      <canvas
        id="map"
        ref=${canvas}
        tabindex="0"
        role="application"
        aria-label=${t("map.label")}
        aria-description=${t("map.keys")}
      ></canvas>
      <${Notices} />
    </div>
    <${AnswerLine} />
  </main>`;
}

function Tools() {
  const tools = [
    ["move", "hand"],
    ["measure", "ruler"],
  ];
  if (store.mayControl.value) tools.unshift(["go", "go"]);
  return html`<div class="tools" role="toolbar" aria-label=${t("tools.name")}>
    ${tools.map(
      ([name, icon]) =>
        html`<button
          type="button"
          key=${name}
          data-tool=${name}
          aria-pressed=${store.tool.value === name}
          title=${t(`tool.${name}.title`)}
          onClick=${() => {
            commands.forgetTarget();
            store.tool.value = /** @type {any} */ (name);
          }}
        >
          <${Icon} name=${icon} /><span class="wide">${t(`tool.${name}`)}</span>
        </button>`,
    )}
    <span class="space"></span>
    <${ToolButton} id="zoom-out" icon="minus" onClick=${() => map?.zoom(1 / ZOOM_STEP)} />
    <${ToolButton} id="zoom-in" icon="plus" onClick=${() => map?.zoom(ZOOM_STEP)} />
    <${ToolButton} id="fit" icon="fit" onClick=${() => map?.fit()} />
    <${ToolButton}
      id="follow"
      icon="follow"
      pressed=${store.follow.value}
      onClick=${() => (store.follow.value = !store.follow.value)}
    />
    <${Layers} />
  </div>`;
}

/** @param {{id: string, icon: string, pressed?: boolean, onClick: () => void}} props */
function ToolButton({ id, icon, pressed, onClick }) {
  return html`<button
    type="button"
    id=${id}
    aria-pressed=${pressed}
    aria-label=${t(`tool.${id}`)}
    title=${t(`tool.${id}`)}
    onClick=${onClick}
  >
    <${Icon} name=${icon} />
  </button>`;
}

function Layers() {
  const [open, setOpen] = useState(false);
  const box = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => {
    if (!open) return;
    const close = (/** @type {Event} */ event) => {
      if (!box.current?.contains(/** @type {Node} */ (event.target))) setOpen(false);
    };
    addEventListener("pointerdown", close, { capture: true });
    return () => removeEventListener("pointerdown", close, { capture: true });
  }, [open]);
  const shown = store.layers.value;
  const known = store.map.value;
  const absent = t("layer.absent");
  /** @type {Record<string, string>} why a layer is empty, by its name */
  const empty = {
    keepout: known?.keepout ? "" : absent,
    zones: known?.zones?.length || known?.lanes?.length ? "" : absent,
    others: store.robots.value.length > 1 ? "" : t("layer.alone"),
  };
  /** Close the menu when the focus goes to something else. @param {FocusEvent} event */
  const leave = ({ relatedTarget }) => {
    const next = /** @type {Node | null} */ (relatedTarget);
    if (next && !box.current?.contains(next)) setOpen(false);
  };
  return html`<div class="layers" ref=${box} onFocusOut=${leave}>
    <button
      type="button"
      id="layers"
      aria-expanded=${open}
      onClick=${() => setOpen(!open)}
      title=${t("tool.layers")}
      aria-label=${t("tool.layers")}
    >
      <${Icon} name="layers" />
    </button>
    ${
      open &&
      html`<fieldset class="menu">
        <legend>${t("tool.layers")}</legend>
        <label>
          <input
            type="checkbox"
            name="robotUp"
            checked=${store.robotUp.value}
            onChange=${() => (store.robotUp.value = !store.robotUp.value)}
          />
          <${Icon} name="north" />${t("tool.robot-up")}
        </label>
        ${Object.entries(shown).map(
          ([name, on]) =>
            html`<label key=${name} class=${empty[name] ? "absent" : ""}>
              <input
                type="checkbox"
                name=${name}
                checked=${on}
                disabled=${Boolean(empty[name])}
                onChange=${() => (store.layers.value = { ...shown, [name]: !on })}
              />
              <svg class="swatch" viewBox="0 0 24 24" aria-hidden="true">
                ${SWATCHES[name].map(([d, style]) => html`<path key=${d} d=${d} style=${style} />`)}
              </svg>
              <span
                >${t(`layer.${name}`)}${empty[name] && html`<small>${empty[name]}</small>`}</span
              >
            </label>`,
        )}
      </fieldset>`
    }
  </div>`;
}

function Notices() {
  const box = useRef(/** @type {HTMLElement | null} */ (null));
  const [notice, ...more] = notices();
  const moreCount = more.length + otherProblems().length;
  const alarms = [...store.alarms.value];
  const isTiny = useMatches(tiny);
  useEffect(() => {
    const panel = document.querySelector(".panel");
    const elements = [box.current, panel].filter((each) => each !== null);
    const observer = new ResizeObserver(updateCovered);
    for (const each of elements) observer.observe(each);
    return () => observer.disconnect();
  }, []);
  // Notices do not move the map, except the first ones: it may have been fitted before they came.
  const known = store.robot.value?.known ?? false;
  useEffect(() => {
    updateCovered();
    map?.refit();
  }, [known, isTiny]);
  // it stays folded or open while only its numbers change, e.g. seconds
  const key = notice?.title.replace(/\d+/g, "");
  return html`<div class="notices" ref=${box}>
    ${
      alarms.length > 0 &&
      html`<div class="alarm" id="alarm" role="alert">
        <details>
          <summary>
            <span>${alarmText(alarms.map(([robot]) => robot))}</span>
          </summary>
          ${alarms.map(([robot, text]) => html`<p key=${robot}>${t("alarm.reason", { reason: text })}${ofRobot(robot)}</p>`)}
          <p>${t("alarm.advice")}</p>
        </details>
      </div>`
    }
    ${
      notice &&
      html`<section
        class="notice ${notice.tone} ${notice.name === "emergency_stop" ? "stopped" : ""}"
        id="notice"
        role="status"
      >
        <details key=${key} open=${!isTiny}>
          <summary><${Icon} name="alarm" /><b>${withQuietNumbers(notice.title)}</b></summary>
          <p>${notice.text}</p>
        </details>
        <div class="actions">
          ${
            notice.action &&
            html`<button type="button" onClick=${notice.action[1]}>${notice.action[0]}</button>`
          }
          ${
            moreCount > 0 &&
            html`<button type="button" class="quiet" onClick=${() => commands.openTab("state")}>
              ${t("notice.more", { count: moreCount })}
            </button>`
          }
        </div>
      </section>`
    }
  </div>`;
}

/**
 * Tell the map which of its margins are covered: by the notices, or would be by one notice, and on a
 * small screen by the panel. There, the notices may cover the top of the panel, too: pad it by that
 * height, and scroll it, so that its content stays where it is on the screen.
 */
function updateCovered() {
  const canvas = map?.canvas.getBoundingClientRect();
  if (!canvas) return;
  const notices = document.querySelector(".notices")?.getBoundingClientRect();
  const panel = /** @type {HTMLElement | null} */ (document.querySelector(".panel.over"));
  const sheet = panel?.getBoundingClientRect();
  if (panel && sheet) {
    const under = notices?.height && sheet.height ? Math.max(0, notices.bottom - sheet.top) : 0;
    const { paddingTop } = getComputedStyle(panel);
    panel.style.setProperty("--under", `${under}px`);
    panel.scrollTop += under - parseFloat(paddingTop);
  }
  const nothing = { top: canvas.bottom, right: canvas.left };
  const covered = sheet?.height ? sheet : nothing;
  const below = sheet && sheet.height > 0 && sheet.width >= canvas.width;
  const height = notices?.height ? notices.bottom - canvas.top : 0; // in pixels, like `room`
  const room = parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--notice"));
  map?.setInset({
    // an open sheet leaves little of the map: keep no more free than one notice
    top: below ? Math.min(room, height) : Math.max(room, height),
    right: 0,
    bottom: below ? Math.max(0, canvas.bottom - covered.top) : 0,
    left: below ? 0 : Math.max(0, covered.right - canvas.left),
  });
}

/**
 * The line below the map: the last answer or the end of its task, and the place under the pointer.
 * Without a pointer, it names the map, unless the answer needs the room.
 */
function AnswerLine() {
  const answer = store.answer.value;
  const at = store.pointed.value;
  const other = answer && answer.robot !== store.address.value ? ofRobot(answer.robot) : "";
  let shown = answer ? `${clock(answer.time)}  ${say(answer.text)}${other}` : "";
  let tone = answer && !answer.ok ? "bad" : "";
  const task = answer?.task && store.tasks.value.find(({ id }) => id === answer.task);
  if (task && task.state in TONES) {
    shown = `${clock(task.changed)}  ${outcomeText(task)}`;
    tone = TONES[task.state];
  }
  return html`<div class="line">
    <p id="answer" role="status" class=${tone} title=${shown} tabindex=${shown ? 0 : undefined}>
      ${shown}
    </p>
    <p id="pointed" aria-hidden="true">
      ${at ? placeText(at) : html`<span>${mapText(store.shownMap.value)}</span>`}
    </p>
  </div>`;
}

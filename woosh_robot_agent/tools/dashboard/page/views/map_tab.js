// The robot's place and its maps: set pose, switch map, make a map.

import { effect, html, signal, useState } from "../vendor/preact.js";
import { commandProps, mappingEnd } from "../allowed.js";
import { run, startPose } from "../commands.js";
import * as store from "../store.js";
import { say, t } from "../texts.js";
import { Icon, useSettling } from "./parts.js";

/**
 * True once a map has been saved in deployment mode, false before; null if the page does not know,
 * because the robot was in this mode when the page opened.
 */
const saved = signal(/** @type {boolean | null} */ (null));
effect(() => {
  const robot = store.robot.value;
  if (robot?.work !== "deploy") saved.value = robot?.known ? false : null;
});

export function MapTab() {
  const may = store.mayControl.value;
  const robot = store.robot.value;
  const mapping = robot?.state === "mapping";
  return html`<section>
      <h2>${t("place.name")}</h2>
      ${
        may
          ? html`<div class="act">
                <button
                  type="button"
                  id="set-pose"
                  ...${commandProps("setPose")}
                  onClick=${startPose}
                >
                  <${Icon} name="pose" />${t("pose.set")}
                </button>
                <${CommandButton} id="keep-pose" command="keepPose" />
              </div>
              <p class="faint">${t("place.hint")}</p>`
          : html`<p class="faint">${t("dock.looking")}</p>`
      }
    </section>
    <${Scenes} />
    ${may && html`<${Mapping} key=${store.chosen.value} mapping=${mapping} />`}`;
}

function Scenes() {
  const robot = store.robot.value;
  const scenes = store.scenes.value;
  return html`<section>
    <h2>${t("maps.name")}</h2>
    ${!scenes.length && html`<p class="faint">${t("maps.none")}</p>`}
    <ul class="rows" id="maps">
      ${scenes.flatMap(({ name: scene, maps }) =>
        maps.map((map) => {
          const used = robot?.scene === scene && robot.map === map;
          return html`<li key=${`${scene} ${map}`} class=${used ? "chosen" : ""}>
            <div>
              <b>${map}</b>
              <small>${t("maps.scene", { scene })}</small>
            </div>
            ${
              used
                ? html`<small>${t("maps.used")}</small>`
                : store.mayControl.value &&
                  html`<${Confirmed}
                    command="switchMap"
                    label=${t("maps.switch")}
                    question=${t("maps.sure")}
                    onConfirm=${() => run("switchMap", { scene, map })}
                  />`
            }
          </li>`;
        }),
      )}
    </ul>
  </section>`;
}

/**
 * The steps of making a map: 1 deployment mode, 2 begin, 3 drive and save, 4 marks, 5 task mode. The
 * current step is marked; the last one never is, and none while the page does not know it.
 * @param {{mapping: boolean}} props
 */
function Mapping({ mapping }) {
  const robot = store.robot.value;
  const [typedScene, setScene] = useState(/** @type {string | null} */ (null));
  const scene = typedScene ?? robot?.scene ?? "";
  const [name, setName] = useState("");
  const exists = store.scenes.value.some((each) => each.name === scene && each.maps.includes(name));
  const isUsed = robot?.scene === scene && robot.map === name;
  // a map that the robot does not have can be added, and the map that it uses can be improved
  const nameState = !(scene && name)
    ? "unnamed"
    : !exists
      ? "notKnown"
      : isUsed
        ? "known"
        : "notUsed";
  const deploying = robot?.work === "deploy";
  const ending = mappingEnd();
  const ends = ending !== null; // the robot may end it before it answers
  const ready = deploying && !mapping && !ends;
  const afterMode = saved.value === null ? 0 : saved.value ? 4 : 2;
  const step = mapping || ends ? 3 : ready ? afterMode : 1;
  /** @param {string} type */
  const begin = (type) => {
    saved.value = false;
    run("buildMap", { type, scene, map: name });
  };
  const save = async () => {
    const address = store.address.value; // the viewer may choose another robot meanwhile
    if (!(await run("saveMap")) || store.address.value !== address) return;
    saved.value = true;
    setScene(null);
    setName("");
  };
  return html`<section id="mapping">
    <h2>${t("mapping.name")}</h2>
    <ol class="steps">
      <li aria-current=${step === 1 ? "step" : undefined}>
        <p>${t("mapping.deploy")}</p>
        ${
          !deploying &&
          html`<${CommandButton}
            id="deploy"
            command="workMode"
            label=${t("work.setDeploy")}
            onClick=${() => run("workMode", { mode: "deploy" })}
          />`
        }
      </li>
      <li aria-current=${step === 2 ? "step" : undefined}>
        <p>${t("mapping.begin")}</p>
        ${
          ready &&
          html`<label class="field">
              ${t("mapping.scene")}
              <input
                id="scene"
                maxlength="60"
                value=${scene}
                onInput=${(/** @type {any} */ e) => setScene(e.currentTarget.value)}
              />
            </label>
            <label class="field">
              ${t("mapping.map")}
              <input
                id="map-name"
                maxlength="60"
                value=${name}
                onInput=${(/** @type {any} */ e) => setName(e.currentTarget.value)}
              />
            </label>
            <div class="act">
              <${CommandButton}
                id="add-map"
                command="buildMap"
                label=${t("mapping.add")}
                isPrimary=${step === 2}
                isComplete=${nameState === "notKnown"}
                onClick=${() => begin("add")}
              />
              <${CommandButton}
                id="update-map"
                command="buildMap"
                label=${t("mapping.update")}
                isComplete=${nameState === "known"}
                onClick=${() => begin("update")}
              />
            </div>
            <p class="faint" id="mapping-off">${t(`mapping.${nameState}`)}</p>`
        }
      </li>
      <li aria-current=${step === 3 ? "step" : undefined}>
        <p>${t("mapping.drive")}</p>
        ${
          step === 3 &&
          html`<div class="act">
              <${CommandButton} id="save-map" command="saveMap" isPrimary onClick=${save} />
              <${Confirmed}
                command="discardMap"
                label=${t("command.discardMap")}
                question=${t("mapping.sure")}
                onConfirm=${() => run("discardMap")}
              />
            </div>
            ${ending && html`<p class="faint" id="mapping-ends">${say(ending)}</p>`}`
        }
      </li>
      <li aria-current=${step === 4 ? "step" : undefined}>
        <p>${t("mapping.marks")}</p>
        ${ready && html`<${CommandButton} id="collect-mark" command="collectMark" />`}
      </li>
      <li>
        <p>${t("mapping.use")}</p>
        ${
          ready &&
          html`<${CommandButton}
            id="task-mode"
            command="workMode"
            label=${t("work.setTask")}
            onClick=${() => run("workMode", { mode: "task" })}
          />`
        }
      </li>
    </ol>
  </section>`;
}

/**
 * A button that gives a command, by default without arguments.
 * @param {{id: string, command: string, label?: string, isPrimary?: boolean, isComplete?: boolean,
 *   onClick?: () => void}} props
 */
function CommandButton({ id, command, label, isPrimary, isComplete, onClick }) {
  return html`<button
    type="button"
    id=${id}
    class=${isPrimary ? "primary" : ""}
    ...${commandProps(command, isComplete)}
    onClick=${onClick ?? (() => run(command))}
  >
    ${label ?? t(`command.${command}`)}
  </button>`;
}

/**
 * A button that asks for confirmation before it acts.
 * @param {{command: string, label: string, question: string, onConfirm: () => void}} props
 */
function Confirmed({ command, label, question, onConfirm }) {
  const [asks, setAsks] = useState(false);
  if (!asks)
    return html`<button type="button" ...${commandProps(command)} onClick=${() => setAsks(true)}>
      ${label}
    </button>`;
  const confirm = () => {
    setAsks(false);
    onConfirm();
  };
  return html`<${Question} onCancel=${() => setAsks(false)}>
    <button type="button" class="primary" ...${commandProps(command)} onClick=${confirm}>
      ${question}
    </button>
  <//>`;
}

/**
 * The button that confirms, and one that does not. They replace the button that was pressed.
 * @param {{onCancel: () => void, children?: unknown}} props
 */
function Question({ onCancel, children }) {
  return html`<fieldset class="act asks" disabled=${useSettling(true)}>
    ${children}
    <button type="button" aria-label=${t("target.cancel")} onClick=${onCancel}>
      <${Icon} name="close" />
    </button>
  </fieldset>`;
}

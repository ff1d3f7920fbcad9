// Modes and settings of the robot, and of this page.

import { html, useEffect, useState } from "../vendor/preact.js";
import { commandProps } from "../allowed.js";
import { run } from "../commands.js";
import * as store from "../store.js";
import { remember, remembered, t } from "../texts.js";

const SPEEDS = [0.1, 0.2, 0.3, 0.5, 0.8, 1.2]; // m/s
const THEMES = ["system", "light", "dark"];
const THEME = "woosh.theme"; // in the storage of the browser

/** Show the page in the colours that were chosen. */
export function startTheme(theme = remembered(THEME) || "system") {
  document.documentElement.dataset.theme = theme;
}

export function Setup() {
  const may = store.mayControl.value;
  const robot = store.robot.value;
  return html`${
      may &&
      robot?.known &&
      html`<${Modes} robot=${robot} />
        <${Speed} />
        ${robot.sound && html`<${Sound} sound=${robot.sound} />`}
        <${Speech} />
        ${robot.light && html`<${Light} />`}`
    }<${Page} />`;
}

/** @param {{robot: store.Robot}} props */
function Modes({ robot }) {
  return html`<section>
    <h2>${t("setup.modes")}</h2>
    <${Choice}
      name="control"
      command="controlMode"
      value=${robot.control}
      choices=${["auto", "manual", "maintain"]}
    />
    <${Choice}
      name="work"
      command="workMode"
      value=${robot.work}
      choices=${["task", "deploy", "schedule"]}
    />
    <p class="faint">${t("setup.key")}</p>
  </section>`;
}

/**
 * Buttons for the modes of the robot; the button of the current mode is pressed.
 * @param {{name: string, command: string, value: string | null, choices: string[]}} props
 */
function Choice({ name, command, value, choices }) {
  return html`<div class="choice" role="group" aria-label=${t(`command.${command}`)} id=${command}>
    <span>${t(`command.${command}`)}</span>
    <div>
      ${choices.map(
        (each) =>
          html`<button
            type="button"
            key=${each}
            aria-pressed=${value === each}
            ...${commandProps(command)}
            onClick=${() => run(command, { mode: each })}
          >
            ${t(`${name}.${each}`)}
          </button>`,
      )}
    </div>
  </div>`;
}

function Speed() {
  const control = store.control.value;
  return html`<section>
    <h2>${t("setup.speed")}</h2>
    <label class="field">
      ${t("setup.limit")}
      <select
        id="speed-limit"
        value=${String(control?.speedLimit ?? "")}
        ...${commandProps("speedLimit")}
        onChange=${(/** @type {any} */ event) => {
          const { value } = event.currentTarget;
          run("speedLimit", { limit: value ? Number(value) : null });
        }}
      >
        <option value="">${t("setup.noLimit")}</option>
        ${SPEEDS.map((each) => html`<option key=${each} value=${String(each)}>${each} m/s</option>`)}
      </select>
    </label>
    <p class="faint">${t("setup.limitHint", { maximum: control?.maximum ?? 0 })}</p>
    ${control?.speedRefusal && html`<p class="bad">${t("setup.limitRefused", { reason: control.speedRefusal })}</p>`}
  </section>`;
}

/** @param {{sound: {mute: boolean, volume: number}}} props */
function Sound({ sound }) {
  const [volume, setVolume] = useState(sound.volume);
  useEffect(() => setVolume(sound.volume), [sound.volume]);
  return html`<section>
    <h2>${t("setup.sound")}</h2>
    <label class="field">
      ${t("setup.volume")}
      <span class="range">
        <input
          type="range"
          id="volume"
          min="0"
          max="100"
          step="5"
          value=${volume}
          ...${commandProps("sound")}
          onInput=${(/** @type {any} */ event) => setVolume(Number(event.currentTarget.value))}
          onChange=${async () => {
            if (!(await run("sound", { mute: sound.mute, volume }))) setVolume(sound.volume);
          }}
        />
        <output>${volume} %</output>
      </span>
    </label>
    <button
      type="button"
      id="mute"
      aria-pressed=${sound.mute}
      ...${commandProps("sound")}
      onClick=${() => run("sound", { mute: !sound.mute, volume })}
    >
      ${t("setup.mute")}
    </button>
  </section>`;
}

function Speech() {
  const [text, setText] = useState("");
  return html`<section>
    <h2>${t("command.speak")}</h2>
    <form
      class="pair wide-first"
      onSubmit=${(/** @type {Event} */ event) => {
        event.preventDefault();
        run("speak", { text });
      }}
    >
      <input
        id="speak-text"
        maxlength="200"
        aria-label=${t("setup.text")}
        placeholder=${t("setup.text")}
        value=${text}
        onInput=${(/** @type {any} */ event) => setText(event.currentTarget.value)}
      />
      <button id="speak" ...${commandProps("speak", text.trim() !== "")}>
        ${t("command.speak")}
      </button>
    </form>
  </section>`;
}

function Light() {
  const [effect, setEffect] = useState(0);
  const [color, setColor] = useState(0);
  return html`<section>
    <h2>${t("command.light")}</h2>
    <form
      class="pair three"
      onSubmit=${(/** @type {Event} */ event) => {
        event.preventDefault();
        run("light", { effect, color });
      }}
    >
      <label class="field">
        ${t("setup.effect")}
        <input
          id="effect"
          type="number"
          min="0"
          max="4294967295"
          value=${effect}
          onInput=${(/** @type {any} */ e) => setEffect(Number(e.currentTarget.value))}
        />
      </label>
      <label class="field">
        ${t("setup.color")}
        <input
          id="color"
          type="number"
          min="0"
          max="16777215"
          value=${color}
          onInput=${(/** @type {any} */ e) => setColor(Number(e.currentTarget.value))}
        />
      </label>
      <button id="light" ...${commandProps("light")}>${t("setup.set")}</button>
    </form>
    <p class="faint">${t("setup.lightHint")}</p>
  </section>`;
}

function Page() {
  return html`<section>
    <h2>${t("setup.page")}</h2>
    <label class="field">
      ${t("setup.theme")}
      <select
        id="theme"
        value=${document.documentElement.dataset.theme}
        onChange=${(/** @type {any} */ event) => {
          remember(THEME, event.currentTarget.value);
          startTheme(event.currentTarget.value);
          dispatchEvent(new Event("themechange"));
        }}
      >
        ${THEMES.map((each) => html`<option key=${each} value=${each}>${t(`theme.${each}`)}</option>`)}
      </select>
    </label>
  </section>`;
}

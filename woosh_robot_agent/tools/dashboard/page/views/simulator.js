// Controls of a simulated robot: obstacles, faults, the emergency stop and the key.

import { html, useState } from "../vendor/preact.js";
import * as commands from "../commands.js";
import * as store from "../store.js";
import { say, t } from "../texts.js";

export function Simulator() {
  const { known, faults } = /** @type {store.Simulator} */ (store.simulator.value);
  const [name, setName] = useState(known[0].name);
  const [text, setText] = useState("");
  const isPlacing = store.tool.value === "obstacle";
  const chosen = known.find((each) => each.name === name) ?? known[0];
  return html`<section>
      <h2>${t("simulator.robot")}</h2>
      <div class="act">
        <${Toggle} name="emergency_stop" id="emergency-stop" />
        <${Toggle} name="key_switch" id="key-switch" />
        <button type="button" id="obstacle" aria-pressed=${isPlacing} onClick=${toggleObstacles}>
          ${t("simulator.obstacles")}
        </button>
      </div>
      ${isPlacing && html`<p class="faint">${t("simulator.obstacleHint")}</p>`}
    </section>
    <section>
      <h2>${t("simulator.faults")}</h2>
      <form
        class="stack"
        onSubmit=${(/** @type {Event} */ event) => {
          event.preventDefault();
          commands.run("fault", { text: `${name} ${text}`.trim() });
        }}
      >
        <label class="field">
          ${t("simulator.fault")}
          <select
            id="fault-name"
            value=${name}
            onChange=${(/** @type {any} */ e) => setName(e.currentTarget.value)}
          >
            ${known.map((each) => html`<option key=${each.name} value=${each.name}>${each.name}</option>`)}
          </select>
        </label>
        <p class="faint">${say(chosen.description)}</p>
        <label class="field">
          ${t("simulator.arguments")}
          <input
            id="fault-arguments"
            maxlength="200"
            placeholder="key=value ... for=10"
            value=${text}
            onInput=${(/** @type {any} */ e) => setText(e.currentTarget.value)}
          />
        </label>
        ${chosen.arguments && html`<p class="faint">${t("simulator.known", { names: chosen.arguments })}</p>`}
        <button id="begin-fault">${t("simulator.begin")}</button>
      </form>
      <ul class="rows" id="faults">
        ${faults.map(
          (fault) =>
            html`<li key=${fault.id}>
              <div>${fault.text}</div>
              <button type="button" onClick=${() => commands.run("endFault", { id: fault.id })}>
                ${t("simulator.end")}
              </button>
            </li>`,
        )}
      </ul>
      <button
        type="button"
        id="clear-faults"
        disabled=${!faults.length}
        onClick=${() => commands.run("clearFaults")}
      >
        ${t("simulator.endAll")}
      </button>
    </section>`;
}

function toggleObstacles() {
  commands.forgetTarget();
  store.tool.value = store.tool.value === "obstacle" ? "go" : "obstacle";
}

/** @param {{name: string, id: string}} props */
function Toggle({ name, id }) {
  const active = store.simulator.value?.faults.find((fault) => fault.name === name);
  return html`<button
    type="button"
    id=${id}
    aria-pressed=${Boolean(active)}
    onClick=${() => (active ? commands.run("endFault", { id: active.id }) : commands.run("fault", { text: name }))}
  >
    ${t(`simulator.${name}`)}
  </button>`;
}

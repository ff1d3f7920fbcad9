// Marks to go to, and the kinds of tasks that can be done there.

import { html, useState } from "../vendor/preact.js";
import { commandProps, refusal } from "../allowed.js";
import * as commands from "../commands.js";
import * as store from "../store.js";
import { t, tOr } from "../texts.js";
import { Icon, TYPES, taskType } from "./parts.js";

/** @type {Record<string, string>} usual type of task at a mark, by the type of the mark */
const USUAL = { charger: "charge", parkspot: "parking" };
/** @type {Record<string, string>} icons of marks that the map shows with a symbol, by their type */
const ICONS = { charger: "charge", parkspot: "park" };
const DIRECTIONS = ["unknown", "feeding", "cutting"];

export function Go() {
  const [query, setQuery] = useState("");
  const marks = store.map.value?.marks ?? [];
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  const found = marks.filter((mark) => {
    const about =
      `${mark.number} ${mark.text} ${tOr(`mark.${mark.type}`, mark.type)}`.toLowerCase();
    return words.every((word) => about.includes(word));
  });
  const may = store.mayControl.value;
  const hasMap = Boolean(store.map.value?.resolution);
  const canCharge = !hasMap || marks.some(({ type }) => type === "charger");
  const noMarks = hasMap ? "none" : store.robot.value?.known ? "noMap" : "unknown";
  const canPark = marks.some(({ type }) => type === "parkspot");
  return html`${
      may &&
      html`<section class="pair">
          <button type="button" id="charge" disabled=${!canCharge} onClick=${charge}>
            <${Icon} name="charge" />${t("type.charge")}
          </button>
          <button
            type="button"
            id="park"
            disabled=${!canPark}
            onClick=${() => chooseNearest("parkspot")}
          >
            <${Icon} name="park" />${t("type.parking")}
          </button>
        </section>
        ${!canCharge && html`<p class="faint" id="no-charger">${t("marks.noCharger")}</p>`}
        ${!canPark && html`<p class="faint" id="no-parking">${t("marks.noParking")}</p>`}`
    }
    <section>
      <h2>${t("marks.name")}</h2>
      <input
        type="search"
        id="search"
        placeholder=${t("marks.search", { count: marks.length })}
        aria-label=${t("marks.search", { count: marks.length })}
        value=${query}
        onInput=${(/** @type {any} */ event) => setQuery(event.currentTarget.value)}
      />
      <ul class="rows" id="marks">
        ${found.map((mark) => html`<${Mark} key=${mark.number} mark=${mark} />`)}
      </ul>
      ${!found.length && html`<p class="faint">${t(`marks.${marks.length ? "notFound" : noMarks}`)}</p>`}
    </section>`;
}

/** @param {{mark: import("../store.js").Mark}} props */
function Mark({ mark }) {
  const chosen = store.target.value?.mark === mark.number;
  return html`<li>
    <button
      type="button"
      class="row"
      aria-pressed=${chosen}
      onClick=${() => commands.setTargetMark(mark)}
    >
      <span>
        <b>${mark.number}</b>
        <small
          >${[tOr(`mark.${mark.type}`, mark.type), mark.text].filter(Boolean).join(" · ")}</small
        >
      </span>
      <${Icon} name=${ICONS[mark.type] ?? "go"} />
    </button>
  </li>`;
}

function charge() {
  if (!chooseNearest("charger")) commands.setTarget({ command: "charge", plan: null });
}

/**
 * Select the nearest mark of a type as the target.
 * @param {string} type
 * @returns {boolean} false if there is no mark of the type
 */
function chooseNearest(type) {
  const from = store.pose.value ?? { x: 0, y: 0 };
  const distance = (/** @type {store.Mark} */ { x, y }) => Math.hypot(x - from.x, y - from.y);
  const marks = (store.map.value?.marks ?? []).filter((mark) => mark.type === type);
  const [nearest] = marks.sort((one, other) => distance(one) - distance(other));
  if (nearest) commands.setTargetMark(nearest);
  return Boolean(nearest);
}

/**
 * The choice of the task at the target, and the button that sends the robot there.
 * @param {{target: store.Target, command: string}} props
 */
export function TaskOptions({ target, command }) {
  const mark = store.map.value?.marks?.find(({ number }) => number === target.mark);
  const usual = command === "charge" ? "charge" : ((mark && USUAL[mark.type]) ?? "pick");
  const initial = target.kind ?? { type: usual, number: 0, direction: "unknown" };
  const [kind, setKind] = useState(`${initial.type} ${initial.number}`); // the value of an option
  const [direction, setDirection] = useState(initial.direction);
  const [type, number] = kind.split(" ");
  const reason = refusal(command);
  // the reason takes the place of the direction, except while an answer is awaited
  const refused = reason && reason.key !== "reason.pending";
  const named = store.map.value?.taskTypes ?? [];
  const kinds = TYPES.flatMap((each) => {
    const kindsOfType = named.filter((one) => one.type === each);
    if (!kindsOfType.length) return [{ value: `${each} 0`, name: taskType(each) }];
    return kindsOfType.map((one) => ({
      value: `${each} ${one.number}`,
      name: `${taskType(each)}: ${one.name}`,
    }));
  });
  // a kind that the map does not name, e.g. of a repeated task
  if (!kinds.some(({ value }) => value === kind)) {
    kinds.push({ value: kind, name: `${taskType(type)}: ${number}` });
  }
  const go = async () => {
    // for other kinds of tasks, a direction that was chosen before is no longer shown
    const shownDirection = type === "carry" ? direction : "unknown";
    const args = { type, number: Number(number), direction: shownDirection };
    const place = target.mark ? { mark: target.mark } : target.pose;
    const where = command === "charge" ? {} : { ...place, ...store.shownMap.value };
    const accepted = await commands.run(command, { ...where, ...args });
    // the viewer may have chosen another target meanwhile
    if (accepted && store.target.value?.pose === target.pose) commands.forgetTarget();
  };
  return html`${
      command === "goMark" &&
      html`<label class="kind">
        <span aria-hidden="true">${kinds.find(({ value }) => value === kind)?.name}</span>
        <select
          id="kind"
          aria-label=${t("target.kind")}
          value=${kind}
          onChange=${(/** @type {any} */ event) => setKind(event.currentTarget.value)}
        >
          ${kinds.map(({ value, name }) => html`<option key=${value} value=${value}>${name}</option>`)}
        </select>
      </label>`
    }
    ${
      type === "carry" &&
      !refused &&
      html`<select
        id="direction"
        aria-label=${t("target.direction")}
        value=${direction}
        onChange=${(/** @type {any} */ event) => setDirection(event.currentTarget.value)}
      >
        ${DIRECTIONS.map((each) => html`<option key=${each} value=${each}>${t(`direction.${each}`)}</option>`)}
      </select>`
    }
    <button type="button" class="primary" id="go" ...${commandProps(command)} onClick=${go}>
      ${t("target.go")}
    </button>`;
}

// A card for each robot.

import { html } from "../vendor/preact.js";
import { chooseRobot } from "../commands.js";
import * as store from "../store.js";
import { alarmCount, say, t, tOr } from "../texts.js";
import { goalText, LEVEL_CLASSES, objectionText, robotLabel, toneOf } from "./parts.js";

export function Fleet() {
  return html`<section>
    <h2>${t("fleet.name")}</h2>
    <ul class="cards" id="fleet">
      ${store.fleet.value.map(
        (card, index) => html`<li key=${index}><${Card} card=${card} index=${index} /></li>`,
      )}
    </ul>
  </section>`;
}

/** @param {{card: store.Card, index: number}} props */
function Card({ card, index }) {
  const { order, battery } = card;
  const [tone, state] = stateOf(card);
  return html`<button
    type="button"
    class="card"
    aria-current=${store.chosen.value === index}
    onClick=${() => chooseRobot(index)}
  >
    <span class="top">
      <b>${robotLabel(card.address)}</b>
      <span>${battery ? `${battery.power} %` : ""}</span>
    </span>
    <span class="state ${tone}"><span class="dot"></span>${state}</span>
    ${card.link === "connected" && !card.silence && card.moves && html`<small class="accent">${t("fleet.moves")}</small>`}
    ${card.problems > 0 && html`<small class="bad">${alarmCount(card.problems)}</small>`}
    ${order && html`<${OrderLines} order=${order} />`}
    <small>${card.address}</small>
  </button>`;
}

/**
 * Return the most important of what is known of a robot.
 * @param {store.Card} card
 * @returns {[string, string]} CSS class and text
 */
function stateOf({ link, silence, known, objection, level, state, task }) {
  if (link !== "connected") return ["bad", t(`link.${link}`)];
  if (silence) return ["bad", t("link.noData", { seconds: silence })];
  if (!known) return ["", t("link.connecting")];
  if (objection) return [toneOf(objection), objectionText(objection).reason];
  const shown = task ? goalText(task) : tOr(`state.${state}`, state);
  return [LEVEL_CLASSES[level] ?? "ok", shown];
}

/** @param {{order: store.Order}} props */
function OrderLines({ order }) {
  const parts = [
    order.id ? t("order.id", { id: order.id }) : t("order.none"),
    order.node && t("order.node", { node: order.node }),
    order.nodesLeft &&
      t(order.nodesLeft === 1 ? "order.oneLeft" : "order.left", { count: order.nodesLeft }),
    order.paused && t("task.paused"),
  ];
  return html`<small class="order">${parts.filter(Boolean).join(" · ")}</small> ${order.errors.map(
      ({ type, text, level }) =>
        html`<small key=${type} class=${level === "WARNING" ? "warn" : "bad"}
          >${type}: ${say(text)}</small
        >`,
    )}`;
}

// The state of the robot: objections to a task, battery, faults, plots, diagnostics.

import { effect, html, signal, useEffect, useState } from "../vendor/preact.js";
import { connection } from "../commands.js";
import * as store from "../store.js";
import { meaningOf, moment, say, t, tOr } from "../texts.js";
import { notices, otherProblems, wrongCount } from "./notices.js";
import {
  alarmText,
  degrees,
  driverText,
  LEVEL_CLASSES,
  linkText,
  mapText,
  objectionText,
  placeText,
  speedTexts,
  workText,
} from "./parts.js";
import { Plot } from "./plot.js";

/** @typedef {[number, number | null, number | null, number | null, boolean | null]} Sample  Unix time in s, speed in
 *   m/s, battery in percent, delay in ms, true while the battery is charged */

const MAX_SAMPLES = 900; // half an hour, like the history of the dashboard
const GAP = 10; // seconds between two samples beyond which samples are missing
const TREND_TIME = 300; // seconds that the samples must span for a trend of the battery
const UNSTEADY = 2; // factor between two paces of the battery beyond which its time left is not known

const samples = signal(/** @type {Sample[]} */ ([]));

async function loadHistory() {
  const robot = store.address.value;
  const { ok, data } = await connection.command("history");
  // over a slow connection, the history of the former robot may come after that of the chosen one
  if (ok && robot === store.address.value) samples.value = data.samples;
}

// Add each new sample, or load all of them again if some are missing.
effect(() => {
  const sample = /** @type {Sample | null} */ (store.sample.value);
  const known = samples.peek();
  const last = known.at(-1);
  if (!sample || !last || sample[0] === last[0]) return;
  const step = sample[0] - last[0]; // negative if the clock was set back
  if (step < 0 || step > GAP) loadHistory();
  else samples.value = [...known.slice(1 - MAX_SAMPLES), sample];
});

export function State() {
  const source = [store.you.value, store.chosen.value]; // the connection and the robot
  useEffect(() => {
    samples.value = [];
  }, source);
  useEffect(() => {
    if (!samples.peek().length) loadHistory(); // again with each connection, until it has come
  }, [...source, store.problem.value]);
  const robot = store.robot.value;
  if (!robot?.known)
    return html`<${Problems} />
      <section><p class="faint">${t("notice.unknown")}</p></section>`;
  return html`<${Problems} />
    <${Summary} robot=${robot} />
    <${Plots} />
    <${Codes} />
    <${Details} />`;
}

/** @param {{robot: store.Robot}} props */
function Summary({ robot }) {
  const pose = store.pose.value;
  const { driver, speedLimit, speedRefusal } = store.control.value ?? {};
  return html`<section>
    <${NewTask} robot=${robot} />
    <dl class="facts-list" id="facts">
      <dt>${t("robot.state")}</dt>
      <dd>${tOr(`state.${robot.state}`, robot.state)}</dd>
      <dt>${t("robot.mode")}</dt>
      <dd>
        ${tOr(`control.${robot.control}`, robot.control ?? "–")} ·${" "}
        ${robot.work ? workText(robot.work) : "–"}
      </dd>
      <dt>${t("robot.driver")}</dt>
      <dd>
        ${driver && driverText(driver.name)}
        ${driver?.detail && html`<small>${say(driver.detail)}</small>`}
      </dd>
      <dt>${t("robot.battery")}</dt>
      <dd><${BatteryLine} battery=${robot.battery} /></dd>
      <dt>${t("robot.map")}</dt>
      <dd>${mapText(robot) || t("map.none")}</dd>
      <dt>${t("robot.pose")}</dt>
      <dd>${pose ? `${placeText(pose)} · ${degrees(pose.theta)}` : "–"}</dd>
      <dt>${t("robot.speed")}</dt>
      <dd>${pose ? speedTexts(pose).join(" · ") : "–"}</dd>
      ${
        speedLimit &&
        html`<dt>${t("setup.limit")}</dt>
          <dd>
            ${speedLimit} m/s
            ${speedRefusal && html`<small>${t("setup.limitRefused", { reason: speedRefusal })}</small>`}
          </dd>`
      }
      ${robot.actions.map(
        ({ name, state, text }) =>
          html`<dt key=${name}>${name}</dt>
            <dd>${tOr(`actionState.${state}`, state)} ${say(text)}</dd>`,
      )}
    </dl>
  </section>`;
}

/** @param {{robot: store.Robot}} props */
function NewTask({ robot }) {
  const old = store.outdated.value;
  if (!robot.objections.length && !old) {
    if (robot.taskable === null) return null;
    return html`<p id="new-task" class="verdict ok">${t("newTask.accepted")}</p>`;
  }
  const ordinary = !old && robot.objections.every(({ name }) => name === "busy");
  return html`<div id="new-task" class="verdict ${ordinary ? "" : "warn"}">
    <b>${t(old ? "newTask.unknown" : "newTask.rejected")}</b>
    <ul>
      ${robot.objections.map((each) => {
        const { reason, remedy } = objectionText(each);
        return html`<li key=${each.name}>${reason}: ${remedy}</li>`;
      })}
    </ul>
  </div>`;
}

/** @param {{battery: store.Battery | null}} props */
function BatteryLine({ battery }) {
  if (!battery) return "–";
  const trend = batteryTrend(battery.charging);
  const parts = [
    `${battery.power} %`,
    battery.charging && t("battery.charging"),
    trend !== null && t("battery.trend", { change: trend > 0 ? `+${trend}` : String(trend) }),
    !battery.charging && timeLeftText(),
    battery.temperature > 0 && `${battery.temperature} °C`,
    battery.cycles > 0 && t("battery.cycles", { count: battery.cycles }),
  ];
  return parts.filter(Boolean).join(" · ");
}

/**
 * Return by how many percent the battery changes in an hour; null if unknown.
 * @param {boolean} charging
 */
function batteryTrend(charging) {
  const known = samples.value.filter(([, , power]) => power !== null);
  const begin = known.findLastIndex((each) => each[4] !== charging) + 1;
  const [first, last] = [known[begin], known.at(-1)];
  if (!first || !last || last[0] - first[0] < TREND_TIME) return null;
  const change = Number(last[2]) - Number(first[2]);
  return Math.round((change * 3600) / (last[0] - first[0]));
}

/**
 * Return for how long the battery lasts at the pace at which it has fallen; empty unless it has fallen
 * steadily. The pace is measured between changes of the percentage, which is a whole number.
 */
function timeLeftText() {
  const known = samples.value;
  const begin = known.findLastIndex(([, , power, , charging]) => power === null || charging) + 1;
  const powers = known.slice(begin).map(([time, , power]) => ({ time, power: Number(power) }));
  const changes = powers.filter(({ power }, index) => index && power !== powers[index - 1].power);
  const [first, last, now] = [changes[0], changes.at(-1), powers.at(-1)];
  if (changes.length < 3 || !last || !now || last.time - first.time < TREND_TIME) return "";
  const paces = changes.slice(1).map(({ time, power }, index) => {
    const former = changes[index];
    return (time - former.time) / (former.power - power); // seconds for each percent
  });
  const pace = (last.time - first.time) / (first.power - last.power);
  const slowest = Math.max(...paces, now.time - last.time);
  if (Math.min(...paces) <= 0 || slowest > UNSTEADY * Math.min(...paces)) return "";
  const minutes = Math.floor((pace * now.power) / 600) * 10;
  if (minutes >= 120) return t("battery.hoursLeft", { hours: Math.floor(minutes / 60) });
  return minutes ? t("battery.minutesLeft", { minutes }) : "";
}

/** The list of all that the bar counts as alarms. */
function Problems() {
  const alarms = [...store.alarms.value];
  if (!wrongCount.value) return null;
  return html`<section>
    <h2>${t("problems.name")}</h2>
    <ul class="rows" id="problems">
      ${alarms.map(([robot, reason]) => {
        const about = [t("alarm.reason", { reason }), t("alarm.advice")];
        return html`<${Line} key=${robot} tone="bad" text=${alarmText([robot])} about=${about} />`;
      })}
      ${notices().map(({ tone, title, text }) => html`<${Line} key=${title + text} tone=${tone} text=${title} about=${[text]} />`)}
      ${otherProblems().map((code) => html`<${CodeLine} key=${code.code} code=${code} />`)}
    </ul>
  </section>`;
}

/** @param {{tone: string, text: string, about: string[]}} props */
function Line({ tone, text, about }) {
  return html`<li>
    <div>
      <p class=${tone}>${text}</p>
      ${about.filter(Boolean).map((each) => html`<small key=${each}>${each}</small>`)}
    </div>
  </li>`;
}

/** @param {{code: store.Code, time?: number}} props */
function CodeLine({ code, time }) {
  const meaning = meaningOf(code);
  const about = [time && moment(time), code.code, meaning && code.text !== meaning && code.text];
  return html`<li>
    <div>
      <p>
        <span class=${LEVEL_CLASSES[code.level] ?? ""}
          >${tOr(`level.${code.level}`, code.level)}</span
        >${" "} ${meaning || code.text || t("codes.unknown")}
      </p>
      <small>${about.filter(Boolean).join(" · ")}</small>
    </div>
  </li>`;
}

function Codes() {
  const [lowest, setLowest] = useState("normal"); // level
  const [query, setQuery] = useState("");
  const levels = ["normal", "tips", "warn", "fault"];
  const shown = store.codes.value.filter((code) => {
    const about = `${code.code} ${code.text} ${meaningOf(code)}`.toLowerCase();
    const level = levels.indexOf(code.level); // -1 if unknown
    return (level < 0 || level >= levels.indexOf(lowest)) && about.includes(query.toLowerCase());
  });
  return html`<section>
    <h2>${t("codes.name")}</h2>
    <div class="pair">
      <select
        aria-label=${t("codes.level")}
        value=${lowest}
        onChange=${(/** @type {any} */ event) => setLowest(event.currentTarget.value)}
      >
        ${levels.map((each) => html`<option key=${each} value=${each}>${t(`codes.from.${each}`)}</option>`)}
      </select>
      <input
        type="search"
        placeholder=${t("codes.search")}
        aria-label=${t("codes.search")}
        value=${query}
        onInput=${(/** @type {any} */ event) => setQuery(event.currentTarget.value)}
      />
    </div>
    ${
      shown.length
        ? html`<ul class="rows" id="codes">
            ${shown.map((code, index) => html`<${CodeLine} key=${index} code=${code} time=${code.time} />`)}
          </ul>`
        : html`<p class="faint">${t("codes.none")}</p>`
    }
  </section>`;
}

function Plots() {
  const known = samples.value;
  const times = known.map(([time]) => time);
  const plots = [
    { name: t("plot.speed"), index: 1, unit: "m/s", minTop: 0.5 },
    { name: t("plot.battery"), index: 2, unit: "%", minTop: 100 },
    { name: t("plot.delay"), index: 3, unit: "ms", minTop: 20 },
  ];
  return html`<section id="plots">
    <h2>${t("plot.title")}</h2>
    ${plots.map(
      ({ name, index, unit, minTop }) =>
        html`<${Plot}
          key=${index}
          name=${name}
          unit=${unit}
          minTop=${minTop}
          times=${times}
          values=${known.map((each) => each[index])}
        />`,
    )}
  </section>`;
}

function Details() {
  const details = store.details.value;
  const link = store.link.value;
  if (!details || !link) return null;
  const { short, long } = linkText();
  const frames = ["received", "sent", "invalid", "dropped"].map((each) => [each, details[each]]);
  const rows = [
    [t("details.address"), details.address],
    [t("details.link"), `${short}, ${moment(link.since)}${long ? `. ${long}` : ""}`],
    [t("details.frames"), t("details.counts", Object.fromEntries(frames))],
    [t("details.connects"), details.connects],
    [t("details.clock"), details.clockOffset === null ? "–" : `${details.clockOffset} s`],
    [t("details.wifi"), [details.wifi, details.strength || ""].join(" ")],
    [t("details.mileage"), `${(details.mileage / 1000).toFixed(1)} km`],
    [t("details.software"), [details.software, details.system].filter(Boolean).join(" · ")],
    ...details.parts.map((/** @type {{part: string, state: string}} */ { part, state }) => [
      t("details.part", { part: part.replace(/^\w+/, (name) => tOr(`part.${name}`, name)) }),
      tOr(`level.${state}`, state),
    ]),
  ];
  return html`<section>
    <h2>${t("details.name")}</h2>
    <dl class="facts-list" id="details">
      ${rows.map(
        ([name, value]) =>
          html`<dt>${name}</dt>
            <dd>${value || "–"}</dd>`,
      )}
    </dl>
  </section>`;
}

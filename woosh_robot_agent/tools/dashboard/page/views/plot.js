// A plot of some values over time, by uPlot.

import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import { language, t } from "../texts.js";

const HEIGHT = 110; // pixels
const INCREMENTS = [60, 300, 600]; // seconds between the times of the axis

/**
 * @param {{name: string, unit: string, least: number, times: number[],
 *   values: (number | null)[]}} props  times: Unix time in s; least: lowest upper end of the axis
 */
export function Plot({ name, unit, least, times, values }) {
  const box = useRef(/** @type {HTMLElement | null} */ (null));
  const plot = useRef(/** @type {import("../vendor/uplot.js").default | null} */ (null));
  const data = useRef(/** @type {[number[], (number | null)[]]} */ ([times, values]));
  const [failed, setFailed] = useState(false);
  data.current = [times, values];
  useEffect(() => {
    let unmounted = false;
    const element = /** @type {HTMLElement} */ (box.current);
    const resizing = new ResizeObserver(() => {
      plot.current?.setSize({ width: element.clientWidth, height: HEIGHT });
    });
    import("../vendor/uplot.js").then(
      ({ default: UPlot }) => {
        if (unmounted) return;
        plot.current = new UPlot(options(element, least), data.current, element);
        resizing.observe(element);
      },
      () => setFailed(true), // the request was lost
    );
    return () => {
      unmounted = true;
      resizing.disconnect();
      plot.current?.destroy();
      plot.current = null;
    };
  }, [language.value]);
  useEffect(() => plot.current?.setData(data.current), [times.length, times.at(-1)]);
  const last = values.at(-1);
  const now = last === null || last === undefined ? "–" : last;
  return html`<figure class="plot">
    <figcaption>${name}<span>${now} ${unit}</span></figcaption>
    ${failed && html`<p class="faint">${t("plot.failed")}</p>`}
    <div ref=${box} aria-hidden="true"></div>
  </figure>`;
}

/**
 * @param {HTMLElement} element
 * @param {number} least
 * @returns {import("../vendor/uplot.js").default.Options}
 */
function options(element, least) {
  const colour = (/** @type {string} */ name) => () =>
    getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
  const axis = {
    stroke: colour("faint"),
    grid: { stroke: colour("line"), width: 1 },
    ticks: { show: false },
    font: "11px system-ui, sans-serif",
  };
  return {
    width: element.clientWidth,
    height: HEIGHT,
    padding: [8, 20, 0, 0],
    legend: { show: false },
    cursor: { drag: { x: false, y: false } },
    scales: { y: { range: (_, low, high) => [Math.min(0, low ?? 0), Math.max(least, high ?? 0)] } },
    axes: [
      {
        ...axis,
        size: 24,
        space: 60,
        incrs: INCREMENTS,
        values: (_, ticks) => ticks.map(hourAndMinute),
      },
      { ...axis, size: 40, space: 30 },
    ],
    series: [
      {},
      { stroke: colour("accent"), width: 1.5, points: { show: false }, spanGaps: false },
    ],
  };
}

/** @param {number} time Unix time, in seconds */
function hourAndMinute(time) {
  return new Date(time * 1000).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
}

// A plot of some values over time, by uPlot.

import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import { clock, language, t } from "../texts.js";

const HEIGHT = 110; // pixels
const INCREMENTS = [60, 300, 600]; // seconds between the times of the axis

/**
 * @param {{name: string, unit: string, minTop: number, times: number[],
 *   values: (number | null)[]}} props  times: Unix time in s; minTop: the y axis reaches at least up
 *   to this value
 */
export function Plot({ name, unit, minTop, times, values }) {
  const box = useRef(/** @type {HTMLElement | null} */ (null));
  const plot = useRef(/** @type {import("../vendor/uplot.js").default | null} */ (null));
  const data = useRef(/** @type {[number[], (number | null)[]]} */ ([times, values]));
  const [failed, setFailed] = useState(false);
  const [pointed, setPointed] = useState(/** @type {number | null} */ (null)); // index of the sample
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
        plot.current = new UPlot(options(element, minTop, setPointed), data.current, element);
        followFinger(plot.current.over);
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
  const index = pointed ?? values.length - 1;
  const time = pointed !== null && times[index] ? `${clock(times[index] * 1000)} · ` : "";
  return html`<figure class="plot">
    <figcaption>${name}<span>${time}${values[index] ?? "–"} ${unit}</span></figcaption>
    ${failed && html`<p class="faint">${t("plot.failed")}</p>`}
    <div ref=${box} aria-hidden="true"></div>
  </figure>`;
}

/**
 * Move the cursor of a plot, which otherwise follows only a mouse, with a finger.
 * @param {HTMLElement} over
 */
function followFinger(over) {
  /** @type {Record<string, string>} */
  const events = { pointerdown: "mousemove", pointermove: "mousemove", pointerleave: "mouseleave" };
  for (const [name, replaced] of Object.entries(events)) {
    over.addEventListener(name, (event) => {
      const { pointerType, clientX, clientY } = /** @type {PointerEvent} */ (event);
      if (pointerType !== "mouse")
        over.dispatchEvent(new MouseEvent(replaced, { clientX, clientY }));
    });
  }
}

/**
 * @param {HTMLElement} element
 * @param {number} minTop  the y axis reaches at least up to this value
 * @param {(index: number | null) => void} onPoint called with the index of the sample at the pointer
 * @returns {import("../vendor/uplot.js").default.Options}
 */
function options(element, minTop, onPoint) {
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
    cursor: { drag: { x: false, y: false }, sync: { key: "plots" } },
    hooks: { setCursor: [({ cursor }) => onPoint(cursor.idx ?? null)] },
    scales: {
      y: { range: (_, low, high) => [Math.min(0, low ?? 0), Math.max(minTop, high ?? 0)] },
    },
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

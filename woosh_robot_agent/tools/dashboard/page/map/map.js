// The map on its canvas: when it is drawn, and the effect of pointers, keys and tools.

import { effect } from "../vendor/preact.js";
import * as commands from "../commands.js";
import * as store from "../store.js";
import { draw, recoloured, scaleBar } from "./draw.js";
import { View } from "./view.js";

/** @typedef {import("../store.js").Point} Point */

const MAX_RECOLOURED = 16e6; // pixels; larger maps keep their shades
const OCCUPIED = 0.65; // darkness, from 0 to 1, above which a pixel is a wall, as in nav2's map_server
const FREE = 0.196; // darkness below which a pixel is floor
const TRAIL_STEP = 0.05; // metres between two points of the trail
const TRAIL_JUMP = 1; // metres between two poses beyond which a new trail begins
const TRAIL_LENGTH = 4000; // points
const DRAG = 8; // pixels beyond which a press is a drag
const DIRECTION = 24; // minimum pixels of a drag that gives a direction
const HIT = 22; // pixels within which a press hits a mark or an obstacle
const KEY_STEP = 60; // pixels by which an arrow key moves the map
const SMALL_KEY_STEP = 5; // pixels by which it does so with Shift
const SCALE_TEXT = 22; // pixels from the scale bar to the top of its text
const SCALE_ROOM = 36; // pixels from the bottom of the canvas to the top of this text
export const ZOOM_STEP = 1.4; // factor of a button or key
const COLOURS = [
  ...["accent", "edge", "faint", "ink", "laser", "map-floor", "map-unknown", "map-wall"],
  ...["on-accent", "warning", "fault"],
];

export class MapCanvas {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    this.view = new View();
    this.fittedOnce = false; // true once this map has been fitted to the window
    this.stillFitted = true; // true until the viewer pans or zooms; then a resize no longer refits
    /** @type {{map: store.Area, image: HTMLImageElement, drawn: CanvasImageSource} | null} drawn: in colours */
    this.area = null;
    /** @type {HTMLImageElement | null} */
    this.keepoutImage = null;
    /** @type {CanvasImageSource | null} `keepoutImage` in colours */
    this.keepout = null;
    /** @type {number[][]} */
    this.trail = [];
    /** @type {Map<number, Point>} pressed pointers: their positions, in pixels */
    this.pointers = new Map();
    /** @type {{start: Point, acts: boolean, dragged: boolean}} acts: it uses the tool */
    this.press = { start: { x: 0, y: 0 }, acts: false, dragged: false };
    /** @type {{from: Point, to: Point} | null} direction that a drag gives, in pixels */
    this.arrow = null;
    /** @type {import("./view.js").Inset} margins that are covered now; `view.inset` may be older */
    this.covered = this.view.inset;
    this.pending = 0; // id of the requested animation frame; 0 without one
    this.shown = ""; // address of the map's picture, once it is requested
    this.loading = ""; // the same, until the picture is loaded
    this.colours = this.readColours();
    this.bind();
  }

  /** Connect the canvas to events of the browser and to the signals of the store. */
  bind() {
    const { canvas } = this;
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.watchRatio();
    for (const query of ["(prefers-color-scheme: dark)", "(forced-colors: active)"]) {
      matchMedia(query).addEventListener("change", () => this.recolour());
    }
    addEventListener("themechange", () => this.recolour());
    canvas.addEventListener("pointerdown", (event) => this.pressed(event));
    canvas.addEventListener("pointermove", (event) => this.moved(event));
    canvas.addEventListener("pointerup", (event) => this.released(event));
    canvas.addEventListener("pointercancel", (event) => this.forgetPointer(event));
    canvas.addEventListener("pointerleave", () => (store.pointed.value = null));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.keyDown(event));
    canvas.addEventListener("focus", () => this.redraw());
    canvas.addEventListener("blur", () => this.redraw());
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * 0.0015), { x: event.offsetX, y: event.offsetY });
      },
      { passive: false },
    );
    effect(() => this.loadMap(store.map.value, store.chosen.value));
    commands.mapNames.subscribe(() => (this.trail = [])); // a trail belongs to one map
    effect(() => this.addToTrail(store.pose.value));
    effect(() => this.followRobot());
    effect(() => {
      // reading the value of a signal subscribes to it
      const signals = [store.scan, store.path, store.outline, store.layers, store.target];
      for (const each of [...signals, store.draft, store.measured, store.places]) each.value;
      for (const each of [store.simulator, store.tool, store.entered]) each.value;
      for (const each of [store.robot, store.tasks]) each.value;
      this.redraw();
    });
  }

  // View

  /** Show the whole map; without a map, show the surroundings of the robot. */
  fit() {
    this.view.inset = this.area ? this.covered : { ...this.covered, top: 0 };
    store.follow.value = false;
    const pose = store.pose.value;
    if (this.area) this.fitArea(this.corners(this.area));
    else if (pose) this.view.fit([-5, 5].map((side) => ({ x: pose.x + side, y: pose.y + side })));
    this.fittedOnce = this.area !== null;
    this.stillFitted = true;
    this.redraw();
  }

  /** Fit the map again, unless the viewer has moved it since. */
  refit() {
    if (this.stillFitted && !this.pointers.size) this.fit();
  }

  /** Show the whole map beside the scale bar, as large as possible. @param {Point[]} corners */
  fitArea(corners) {
    for (let below = 0; below <= SCALE_ROOM; below += 2) {
      this.view.fit(corners, below);
      if (!this.coversScale(corners)) return;
    }
  }

  /** Return true if the map's picture would lie under the scale bar. @param {Point[]} corners */
  coversScale(corners) {
    const { x, y, length } = scaleBar(this.view);
    const pixels = corners.map((each) => this.view.toScreen(each.x, each.y));
    const left = Math.min(...pixels.map((each) => each.x));
    const bottom = Math.max(...pixels.map((each) => each.y));
    return left < x + length * this.view.scale && bottom > y - SCALE_TEXT;
  }

  /**
   * Zoom around a pixel, or around the robot if the map follows it.
   * @param {number} factor
   * @param {Point} pixel
   */
  zoom(factor, pixel = this.view.middle) {
    this.stillFitted = false;
    this.view.zoom(factor, store.follow.value ? this.view.middle : pixel);
    this.redraw();
  }

  /**
   * Note the margins of the canvas that other elements cover. When the viewer opens or closes the
   * panel, a map that is still fitted is fitted anew. Notices, which come by themselves, move nothing.
   * @param {import("./view.js").Inset} inset
   */
  setInset(inset) {
    this.covered = inset;
    const { bottom, left } = this.view.inset;
    if (inset.bottom === bottom && inset.left === left) return;
    this.view.inset = inset;
    this.refit();
    this.followRobot();
  }

  /**
   * Keep the robot's front at the top, and the robot in the middle, if the viewer wants that. A map
   * on which a pointer is pressed stays where it is: the press means the place where it began.
   */
  followRobot() {
    const pose = store.pose.value;
    const turned = store.robotUp.value && pose ? Math.PI / 2 - pose.theta : 0;
    const isHeld = this.pointers.size > 0;
    if (turned !== this.view.angle && !isHeld) this.view.turn(turned);
    if (store.follow.value && pose && !isHeld) {
      this.stillFitted = false;
      this.view.put(pose, this.view.middle);
    }
    this.redraw();
  }

  /**
   * Return the corners of an area's picture, in world coordinates.
   * @param {{map: store.Area, image: HTMLImageElement}} area
   */
  corners({ map, image }) {
    const { x, y, theta } = /** @type {store.Pose} */ (map.origin);
    const size = /** @type {number} */ (map.resolution);
    return [0, 1].flatMap((right) =>
      [0, 1].map((up) => {
        const [a, b] = [right * image.width * size, up * image.height * size];
        return {
          x: x + a * Math.cos(theta) - b * Math.sin(theta),
          y: y + a * Math.sin(theta) + b * Math.cos(theta),
        };
      }),
    );
  }

  // Pointers: one pointer pans or uses the tool, two pointers pan and zoom

  /** @param {PointerEvent} event */
  pressed(event) {
    const at = { x: event.offsetX, y: event.offsetY };
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, at);
    const acts = this.pointers.size === 1 && event.button === 0;
    this.press = { start: at, acts, dragged: false };
    this.arrow = null;
    if (acts && store.tool.value === "measure") this.measureFrom(at);
  }

  /** @param {PointerEvent} event */
  moved(event) {
    const now = { x: event.offsetX, y: event.offsetY };
    const place = this.view.toWorld(now.x, now.y);
    store.pointed.value = place;
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const { press } = this;
    const length = distance(now, press.start);
    if (length > DRAG) press.dragged = true;
    if (this.pointers.size === 2) {
      press.acts = false;
      this.arrow = null;
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
      this.pan(midpoint(before, other), midpoint(now, other));
      const spread = Math.max(1, distance(now, other)) / Math.max(1, distance(before, other));
      this.zoom(spread, midpoint(now, other));
    } else if (!press.acts || store.tool.value === "move" || store.tool.value === "obstacle") {
      if (press.dragged) this.pan(before, now);
    } else if (store.tool.value === "measure") {
      const begun = store.measured.value;
      if (press.dragged && begun) store.measured.value = [begun[0], place];
    } else {
      this.arrow = length < DIRECTION ? null : { from: press.start, to: now };
    }
    this.pointers.set(event.pointerId, now);
    this.redraw();
  }

  /** @param {PointerEvent} event */
  released(event) {
    const { press, arrow } = this;
    const acts = press.acts && this.pointers.size === 1 && this.pointers.has(event.pointerId);
    if (acts) this.act(press, arrow);
    this.forgetPointer(event);
  }

  /** @param {PointerEvent} event */
  forgetPointer(event) {
    this.pointers.delete(event.pointerId);
    this.press.acts = false;
    this.arrow = null;
    this.followRobot();
  }

  /**
   * Use the tool for a press that has ended.
   * @param {{start: Point, dragged: boolean}} press
   * @param {{from: Point, to: Point} | null} arrow
   */
  act({ start, dragged }, arrow) {
    const place = this.view.toWorld(start.x, start.y);
    const tool = store.tool.value;
    let direction = null; // in radians; null if the press gives none
    if (arrow) {
      const { from, to } = arrow;
      const angle = Math.atan2(from.y - to.y, to.x - from.x) - this.view.angle;
      direction = Math.atan2(Math.sin(angle), Math.cos(angle)); // within -π to π
    }
    if (tool === "measure") return; // the line was drawn during the press
    if (tool === "pose") {
      if (direction !== null) store.draft.value = { ...place, theta: direction };
      else commands.tell(false, { key: "pose.drag", values: {} });
      return;
    }
    if (dragged && tool !== "go") return; // the press has moved the map
    if (tool === "obstacle") {
      const { x, y } = place;
      const hit = this.hit(start, this.obstacles, ({ radius }) => radius ?? 0);
      if (hit) commands.run("endFault", { id: hit.id });
      else commands.run("fault", { text: `obstacle x=${x.toFixed(3)} y=${y.toFixed(3)}` });
      return;
    }
    const mark = store.layers.value.marks && this.hit(start, store.map.value?.marks ?? []);
    if (mark && direction === null) commands.setTargetMark(mark);
    else if (tool === "go") commands.setTargetPlace(place, direction);
    else commands.forgetTarget();
  }

  /**
   * Move the map, from one pixel to another.
   * @param {Point} from
   * @param {Point} to
   */
  pan(from, to) {
    store.follow.value = this.stillFitted = false;
    this.view.put(this.view.toWorld(from.x, from.y), to);
    this.redraw();
  }

  /** @param {Point} pixel */
  measureFrom(pixel) {
    const place = this.view.toWorld(pixel.x, pixel.y);
    const former = store.measured.value;
    // a line that has only begun has length 0; the next press ends it
    const begins = !former || distance(former[0], former[1]) > 0;
    store.measured.value = begins ? [place, place] : [former[0], place];
  }

  /** @param {KeyboardEvent} event */
  keyDown(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return; // a shortcut of the browser
    const step = event.shiftKey ? SMALL_KEY_STEP : KEY_STEP;
    const moves = /** @type {Record<string, Point>} */ ({
      ArrowLeft: { x: step, y: 0 },
      ArrowRight: { x: -step, y: 0 },
      ArrowUp: { x: 0, y: step },
      ArrowDown: { x: 0, y: -step },
    });
    if (event.key in moves) this.pan({ x: 0, y: 0 }, moves[event.key]);
    else if (event.key === "Enter" && !event.repeat) this.enter();
    else if (event.key === "+") this.zoom(ZOOM_STEP);
    else if (event.key === "-") this.zoom(1 / ZOOM_STEP);
    else if (event.key === "0") this.fit();
    else return;
    event.preventDefault();
  }

  /** Use the tool at the cross. A pose takes two presses of Enter: at its place, then in its direction. */
  enter() {
    const { middle } = this.view;
    const tool = store.tool.value;
    if (tool === "measure") this.measureFrom(middle);
    else if (tool === "pose" && !store.entered.value) {
      store.entered.value = this.view.toWorld(middle.x, middle.y);
    } else if (tool !== "move") {
      const arrow = this.enteredArrow;
      store.entered.value = null;
      this.act({ start: arrow?.from ?? middle, dragged: false }, arrow);
    }
  }

  /** Arrow from the place that Enter has set to the cross; null if it would be too short. */
  get enteredArrow() {
    const place = store.entered.peek();
    if (!place) return null;
    const from = this.view.toScreen(place.x, place.y);
    const to = this.view.middle;
    return distance(from, to) < DIRECTION ? null : { from, to };
  }

  /**
   * Return the item at a pixel, e.g. a mark; undefined if there is none.
   * @template {{x?: number, y?: number}} T
   * @param {Point} pixel
   * @param {T[]} items
   * @param {(item: T) => number} radius in metres
   * @returns {T | undefined}
   */
  hit(pixel, items, radius = () => 0) {
    const near = items
      .map((item) => ({
        item,
        away: distance(this.view.toScreen(item.x ?? 0, item.y ?? 0), pixel),
      }))
      .filter(({ item, away }) => away < Math.max(HIT, radius(item) * this.view.scale));
    return near.sort((one, other) => one.away - other.away)[0]?.item;
  }

  get obstacles() {
    return (store.simulator.value?.faults ?? []).filter((fault) => fault.x !== undefined);
  }

  // Images and the picture

  /**
   * Show the picture of another map, once it is loaded.
   * @param {store.Area | null} map
   * @param {number} robot index
   */
  loadMap(map, robot) {
    const url = map?.resolution ? `${robot}/${map.number}.png` : "";
    if (url === this.shown) return;
    // a map that the robot is making has no name, and may grow faster than its pictures are loaded
    if (url && !map?.name && this.loading.startsWith(`${robot}/`)) return;
    this.shown = this.loading = url;
    if (!map || !url) {
      this.area = this.keepout = this.keepoutImage = null;
      this.fittedOnce = false;
      this.redraw();
      return;
    }
    this.loadPicture(url, `map/${url}`, (image) => {
      this.area = { map, image, drawn: image };
      this.keepout = this.keepoutImage = null;
      this.recolour();
      if (!this.fittedOnce) this.fit();
      if (!map.keepout) return;
      this.loadPicture(url, `keepout/${url}`, (keepout) => {
        this.keepoutImage = keepout;
        this.recolour();
      });
    });
  }

  /**
   * @param {string} wanted value of `shown`; if it has changed meanwhile, the image is dropped
   * @param {string} url
   * @param {(image: HTMLImageElement) => void} onLoad
   */
  loadPicture(wanted, url, onLoad) {
    const image = new Image();
    const end = () => {
      if (this.loading === wanted) this.loading = "";
    };
    image.onload = () => {
      end();
      if (this.shown === wanted) onLoad(image);
      this.loadMap(store.map.peek(), store.chosen.peek()); // it may have grown meanwhile
    };
    image.onerror = () => {
      end();
      if (this.shown === wanted) this.shown = ""; // tries again when the map's data come again
    };
    image.src = url;
  }

  /** @param {store.Pose | null} pose */
  addToTrail(pose) {
    if (!pose) return;
    const last = this.trail.at(-1);
    const step = last ? Math.hypot(pose.x - last[0], pose.y - last[1]) : Infinity;
    if (step < TRAIL_STEP) return;
    if (step > TRAIL_JUMP) {
      this.trail = []; // the robot was told another pose, or was not seen for a while
      if (!this.area && this.stillFitted) this.fit();
    }
    this.trail.push([pose.x, pose.y]);
    if (this.trail.length > TRAIL_LENGTH) this.trail.shift();
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`)]));
  }

  /** Draw the map in the present colours of the page. */
  recolour() {
    this.colours = this.readColours();
    const { area, colours } = this;
    if (area && area.image.width * area.image.height <= MAX_RECOLOURED) {
      const [wall, floor, unknown] = ["wall", "floor", "unknown"].map((name) =>
        components(colours[`map-${name}`]),
      );
      area.drawn = recoloured(area.image, (shade) => {
        const darkness = (255 - shade) / 255;
        return darkness > OCCUPIED ? wall : darkness < FREE ? floor : unknown;
      });
    }
    if (this.keepoutImage) {
      const [red, green, blue] = components(colours.fault);
      this.keepout = recoloured(this.keepoutImage, (shade) => {
        const isKeepOut = shade < 100;
        return [red, green, blue, isKeepOut ? 70 : 0];
      });
    }
    this.redraw();
  }

  resize() {
    this.view.width = this.canvas.clientWidth;
    this.view.height = this.canvas.clientHeight;
    if (this.stillFitted) this.fit();
    this.followRobot();
    this.draw();
  }

  /** Draw anew when the window moves to a screen with other pixels, or is zoomed. */
  watchRatio() {
    const query = matchMedia(`(resolution: ${devicePixelRatio}dppx)`);
    query.addEventListener(
      "change",
      () => {
        this.redraw();
        this.watchRatio();
      },
      { once: true },
    );
  }

  redraw() {
    this.pending ||= requestAnimationFrame(() => this.draw());
  }

  draw() {
    cancelAnimationFrame(this.pending);
    this.pending = 0;
    const { canvas, context, view, colours } = this;
    const ratio = devicePixelRatio;
    const [width, height] = [view.width, view.height].map((size) => Math.round(size * ratio));
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw({ context, view, colours }, this.picture());
  }

  /** @returns {import("./draw.js").Picture} what to draw now, without the layers that are off */
  picture() {
    const layers = store.layers.peek();
    const map = store.map.peek();
    const target = store.target.peek();
    const scan = store.scan.peek();
    const draft = store.draft.peek();
    const robot = store.robot.peek();
    const { area } = this;
    const isChosen = (/** @type {store.PlacedRobot} */ { index }) => index === store.chosen.peek();
    const places = store.places.peek();
    const others = places.filter(
      (each) => !isChosen(each) && each.scene === robot?.scene && each.map === robot?.map,
    );
    const running = store.running.peek();
    const plan = target?.plan && "path" in target.plan ? target.plan.path : [];
    return {
      area: area
        ? {
            image: area.drawn,
            width: area.image.width,
            height: area.image.height,
            resolution: /** @type {number} */ (area.map.resolution),
            origin: /** @type {store.Pose} */ (area.map.origin),
          }
        : undefined,
      keepout: (layers.keepout && this.keepout) || undefined,
      zones: (layers.zones && map?.zones) || [],
      lanes: (layers.zones && map?.lanes) || [],
      marks: (layers.marks && map?.marks) || [],
      chosenMark: target?.mark ?? (running?.to || running?.command.args?.mark),
      trail: layers.trail ? this.trail : [],
      path: layers.path ? (store.pathAhead.peek()?.points ?? store.path.peek()) : [],
      planned: plan,
      target: target?.pose,
      scan: scan && layers.laser ? { points: scan.points, pose: draft ?? scan.pose } : undefined,
      obstacles: this.obstacles,
      others: layers.others ? others : [],
      pose: store.pose.peek() ?? undefined,
      lost: store.isLost.peek(),
      name: layers.others && others.length ? places.find(isChosen)?.name : undefined,
      draft: draft ?? undefined,
      outline: layers.footprint ? store.outline.peek() : [],
      measured: store.measured.peek() ?? undefined,
      arrow: this.arrow ?? this.enteredArrow ?? undefined,
      // the place where Enter uses the tool, for users of the keyboard; "move" has no use for Enter
      cross: this.canvas.matches(":focus-visible") && store.tool.peek() !== "move",
    };
  }
}

/**
 * @param {Point} one
 * @param {Point} other
 */
function distance(one, other) {
  return Math.hypot(one.x - other.x, one.y - other.y);
}

/**
 * @param {Point} one
 * @param {Point} other
 * @returns {Point}
 */
function midpoint(one, other) {
  return { x: (one.x + other.x) / 2, y: (one.y + other.y) / 2 };
}

/**
 * Return red, green, blue and opacity of a colour.
 * @param {string} colour
 * @returns {[number, number, number, number]}
 */
function components(colour) {
  const context = /** @type {OffscreenCanvasRenderingContext2D} */ (
    new OffscreenCanvas(1, 1).getContext("2d")
  );
  context.fillStyle = colour;
  context.fillRect(0, 0, 1, 1);
  const [red, green, blue, opacity] = context.getImageData(0, 0, 1, 1).data;
  return [red, green, blue, opacity];
}

// The part of the map that is on the screen: place, scale and rotation.

/** @typedef {import("../store.js").Point} Point */
/** @typedef {{top: number, right: number, bottom: number, left: number}} Inset  in pixels */

const MIN_SCALE = 0.02; // pixels per metre
const MAX_SCALE = 400;
const FILL = 0.95; // share of the free area that a fitted map fills

export class View {
  constructor() {
    this.scale = 40; // pixels per metre
    this.centre = { x: 0, y: 0 }; // place in the middle of the canvas, in metres
    this.angle = 0; // by which the map is turned counter-clockwise, in radians
    this.width = 0; // of the canvas, in pixels
    this.height = 0;
    /** @type {Inset} */
    this.inset = { top: 0, right: 0, bottom: 0, left: 0 }; // margins that other elements cover
  }

  /**
   * Return where a place is on the canvas, in pixels.
   * @param {number} x
   * @param {number} y
   * @returns {Point}
   */
  toScreen(x, y) {
    const east = (x - this.centre.x) * this.scale;
    const north = (y - this.centre.y) * this.scale;
    const cos = Math.cos(this.angle);
    const sin = Math.sin(this.angle);
    return {
      x: this.width / 2 + east * cos - north * sin,
      y: this.height / 2 - east * sin - north * cos,
    };
  }

  /**
   * Return the place at a pixel, in metres.
   * @param {number} x
   * @param {number} y
   * @returns {Point}
   */
  toWorld(x, y) {
    const right = (x - this.width / 2) / this.scale;
    const up = (this.height / 2 - y) / this.scale;
    const cos = Math.cos(this.angle);
    const sin = Math.sin(this.angle);
    return {
      x: this.centre.x + right * cos + up * sin,
      y: this.centre.y - right * sin + up * cos,
    };
  }

  /** Middle of the part of the canvas that nothing covers, in pixels. */
  get middle() {
    const { top, right, bottom, left } = this.inset;
    return { x: (left + this.width - right) / 2, y: (top + this.height - bottom) / 2 };
  }

  /**
   * Move the map so that a place is at a pixel.
   * @param {Point} place
   * @param {Point} pixel
   */
  put(place, pixel) {
    const there = this.toWorld(pixel.x, pixel.y);
    this.centre = {
      x: this.centre.x + place.x - there.x,
      y: this.centre.y + place.y - there.y,
    };
  }

  /**
   * Zoom around a pixel.
   * @param {number} factor by which the scale grows
   * @param {Point} pixel
   */
  zoom(factor, pixel) {
    const place = this.toWorld(pixel.x, pixel.y);
    this.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, this.scale * factor));
    this.put(place, pixel);
  }

  /**
   * Turn the map around the middle, to an angle.
   * @param {number} angle as in `this.angle`
   */
  turn(angle) {
    const place = this.toWorld(this.middle.x, this.middle.y);
    this.angle = angle;
    this.put(place, this.middle);
  }

  /**
   * Show all of these places in the part of the canvas that nothing covers.
   * @param {Point[]} places
   * @param {number} below height in pixels that remains free at the bottom
   */
  fit(places, below = 0) {
    const cos = Math.cos(this.angle);
    const sin = Math.sin(this.angle);
    // in metres along the axes of the screen
    const across = places.map(({ x, y }) => x * cos - y * sin);
    const up = places.map(({ x, y }) => x * sin + y * cos);
    const [left, right] = [Math.min(...across), Math.max(...across)];
    const [low, high] = [Math.min(...up), Math.max(...up)];
    const { inset } = this;
    const width = Math.max(1, this.width - inset.left - inset.right);
    const height = Math.max(1, this.height - inset.top - inset.bottom - below);
    const scale = FILL * Math.min(width / (right - left || 1), height / (high - low || 1));
    this.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, scale));
    const middle = { across: (left + right) / 2, up: (low + high) / 2 };
    const x = middle.across * cos + middle.up * sin;
    const y = middle.up * cos - middle.across * sin;
    this.put({ x, y }, { x: this.middle.x, y: this.middle.y - below / 2 });
  }
}

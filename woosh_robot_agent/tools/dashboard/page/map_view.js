// The map on a canvas, with everything on it: zoom, pan, follow, and what a click means.

const MIN_SCALE = 0.02; // pixels per metre
const MAX_SCALE = 400;
const MAX_RECOLOURED = 16e6; // pixels; larger maps keep their shades
const TRAIL_STEP = 0.05; // metres between two points of the trail
const TRAIL_LENGTH = 4000; // points
const DRAG = 8; // pixels from which a press is a drag
const DIRECTION = 24; // pixels from which a drag gives a direction
const HIT = 18; // pixels within which a click hits a mark or an obstacle

export class MapView {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.scale = 40; // pixels per metre
    this.centre = {x: 0, y: 0}; // metres
    this.follow = false;
    this.tool = "look";
    this.corner = () => [0, 0]; // width and height of what lies over the lower right corner
    this.onAct = () => {}; // called with the tool, a place and the direction, or a mark
    this.pointers = new Map();
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.dark.addEventListener("change", () => { this.recolour(); this.redraw(); });
    this.forget();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.watchRatio();
    canvas.addEventListener("pointerdown", (event) => this.pressed(event));
    canvas.addEventListener("pointermove", (event) => this.moved(event));
    canvas.addEventListener("pointerup", (event) => this.released(event));
    canvas.addEventListener("pointercancel", (event) => this.dropped(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, {passive: false});
  }

  /** Forget the former robot. */
  forget() {
    this.image = null;
    this.picture = null;
    this.map = null;
    this.marks = [];
    this.pose = null;
    this.outline = [];
    this.path = [];
    this.obstacles = [];
    this.trail = [];
    this.scan = null;
    this.arrow = null;
    this.fitted = false;
    this.redraw();
  }

  setMap(map, url) {
    this.map = map;
    this.marks = map.marks ?? [];
    if (!map.resolution) {
      this.image = this.picture = null;
      this.redraw();
      return;
    }
    const image = new Image();
    image.onload = () => {
      if (this.map !== map) return;
      this.image = image;
      this.recolour();
      if (!this.fitted) this.fit();
      this.redraw();
    };
    image.src = url;
  }

  setPose(pose) {
    this.pose = pose;
    const last = this.trail.at(-1);
    if (pose && (!last || Math.hypot(pose.x - last[0], pose.y - last[1]) > TRAIL_STEP)) {
      this.trail.push([pose.x, pose.y]);
      if (this.trail.length > TRAIL_LENGTH) this.trail.shift();
    }
    if (pose && this.follow) this.centre = {x: pose.x, y: pose.y};
    this.redraw();
  }

  setScan(buffer) {
    const head = new DataView(buffer);
    const [x, y, theta, forward, left, first, step] =
      [0, 1, 2, 3, 4, 5, 6].map((index) => head.getFloat32(4 + 4 * index, true));
    const laserX = x + forward * Math.cos(theta) - left * Math.sin(theta);
    const laserY = y + forward * Math.sin(theta) + left * Math.cos(theta);
    const points = [];
    for (let index = 0, at = 32; at + 1 < buffer.byteLength; index++, at += 2) {
      const range = head.getUint16(at, true) / 1000;
      if (!range) continue;
      const angle = theta + first + index * step;
      points.push(laserX + range * Math.cos(angle), laserY + range * Math.sin(angle));
    }
    this.scan = points;
    this.redraw();
  }

  set(name, value) {
    this[name] = value;
    this.redraw();
  }

  /** Show the whole map. */
  fit() {
    if (!this.image) return;
    const corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(([a, b]) =>
      this.fromPicture(a * this.image.width, b * this.image.height));
    const xs = corners.map((corner) => corner.x), ys = corners.map((corner) => corner.y);
    const [left, right] = [Math.min(...xs), Math.max(...xs)];
    const [low, high] = [Math.min(...ys), Math.max(...ys)];
    const [width, height] = this.corner();
    const areas = [[this.width - width, this.height], [this.width, this.height - height]];
    const scaleIn = ([across, down]) => Math.min(across / (right - left), down / (high - low));
    const area = scaleIn(areas[0]) > scaleIn(areas[1]) ? areas[0] : areas[1];
    this.scale = limited(0.95 * scaleIn(area));
    this.centre = { // the area begins at the upper left
      x: (left + right) / 2 + (this.width - area[0]) / 2 / this.scale,
      y: (low + high) / 2 - (this.height - area[1]) / 2 / this.scale,
    };
    this.fitted = true;
    this.redraw();
  }

  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const before = this.toWorld(x, y);
    this.scale = limited(this.scale * factor);
    if (!this.follow) {
      const after = this.toWorld(x, y);
      this.centre.x += before.x - after.x;
      this.centre.y += before.y - after.y;
    }
    this.redraw();
  }

  get width() { return this.canvas.clientWidth; }
  get height() { return this.canvas.clientHeight; }

  toScreen(x, y) {
    return {
      x: this.width / 2 + (x - this.centre.x) * this.scale,
      y: this.height / 2 - (y - this.centre.y) * this.scale,
    };
  }

  toWorld(x, y) {
    return {
      x: this.centre.x + (x - this.width / 2) / this.scale,
      y: this.centre.y - (y - this.height / 2) / this.scale,
    };
  }

  /** Return the place of a point of the picture, whose rows begin at the top. */
  fromPicture(column, row) {
    const {resolution, origin} = this.map;
    const x = column * resolution, y = (this.image.height - row) * resolution;
    return {
      x: origin.x + x * Math.cos(origin.theta) - y * Math.sin(origin.theta),
      y: origin.y + x * Math.sin(origin.theta) + y * Math.cos(origin.theta),
    };
  }

  // Pointers: one pans or acts, two zoom

  pressed(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, {x: event.offsetX, y: event.offsetY});
    this.acting = this.pointers.size === 1 && event.button === 0 && this.tool !== "look";
    this.start = {x: event.offsetX, y: event.offsetY};
    this.dragged = false;
  }

  moved(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = {x: event.offsetX, y: event.offsetY};
    if (Math.hypot(now.x - this.start.x, now.y - this.start.y) > DRAG) this.dragged = true;
    if (this.pointers.size === 2) {
      this.acting = false;
      this.arrow = null;
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
      const spread = (p) => Math.max(1, Math.hypot(p.x - other.x, p.y - other.y));
      this.zoom(spread(now) / spread(before), (now.x + other.x) / 2, (now.y + other.y) / 2);
    } else if (this.acting && this.tool !== "obstacle") {
      const length = Math.hypot(now.x - this.start.x, now.y - this.start.y);
      this.arrow = length < DIRECTION ? null : {from: this.start, to: now};
    } else if (this.dragged) {
      this.centre.x -= (now.x - before.x) / this.scale;
      this.centre.y += (now.y - before.y) / this.scale;
      this.set("follow", false);
      this.onFollow?.(false);
    }
    this.pointers.set(event.pointerId, now);
    this.redraw();
  }

  released(event) {
    const acts = this.acting && this.pointers.size === 1 && this.pointers.has(event.pointerId);
    const arrow = this.arrow;
    this.dropped(event);
    if (!acts) return;
    const place = this.toWorld(this.start.x, this.start.y);
    const mark = this.hit(this.marks);
    const obstacle = this.hit(this.obstacles);
    let theta = null;
    if (arrow) theta = Math.atan2(arrow.from.y - arrow.to.y, arrow.to.x - arrow.from.x);
    this.onAct(this.tool, place, theta, arrow ? null : mark, obstacle);
  }

  dropped(event) {
    this.pointers.delete(event.pointerId);
    this.acting = false;
    this.arrow = null;
    this.redraw();
  }

  /** Return what is at the place of the press. */
  hit(items) {
    return items.find((item) => {
      const at = this.toScreen(item.x, item.y);
      const reach = Math.max(HIT, (item.radius ?? 0) * this.scale);
      return Math.hypot(at.x - this.start.x, at.y - this.start.y) < reach;
    }) ?? null;
  }

  // Drawing

  resize() {
    if (!this.fitted) this.fit();
    this.draw();
  }

  /** Draw anew when the window moves to a screen with other pixels, or is zoomed. */
  watchRatio() {
    matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", () => {
      this.redraw();
      this.watchRatio();
    }, {once: true});
  }

  /** Give the canvas as many pixels as it has on the screen; return their number per CSS pixel. */
  fitPixels() {
    const ratio = devicePixelRatio;
    const width = Math.round(this.width * ratio), height = Math.round(this.height * ratio);
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
    return ratio;
  }

  redraw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.draw();
    });
  }

  /** Give the picture the colours of the page. */
  recolour() {
    this.picture = this.image;
    if (!this.image || !this.dark.matches) return;
    const {width, height} = this.image;
    if (width * height > MAX_RECOLOURED) return;
    const copy = new OffscreenCanvas(width, height);
    const context = copy.getContext("2d");
    context.filter = "invert(0.88)";
    context.drawImage(this.image, 0, 0);
    this.picture = copy;
  }

  draw() {
    const context = this.context;
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`);
    const ratio = this.fitPixels();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    this.drawPicture();
    this.drawLine(this.trail, colour("faint"), 1.5, [3, 5]);
    this.drawLine(this.path, colour("good"), 3);
    for (const obstacle of this.obstacles) this.drawObstacle(obstacle, colour("warning"));
    this.drawScan(colour("bad"));
    for (const mark of this.marks) this.drawMark(mark, colour("ink"), colour("accent"));
    if (this.pose) this.drawRobot(colour("accent"), colour("paper"));
    if (this.arrow) this.drawArrow(colour("accent"));
  }

  drawPicture() {
    if (!this.picture) return;
    const context = this.context;
    const {resolution, origin} = this.map;
    const corner = this.toScreen(origin.x, origin.y);
    context.save();
    context.translate(corner.x, corner.y);
    context.rotate(-origin.theta);
    const pixel = resolution * this.scale;
    context.imageSmoothingEnabled = pixel < 1;
    context.drawImage(
      this.picture, 0, -this.image.height * pixel, this.image.width * pixel,
      this.image.height * pixel);
    context.restore();
  }

  drawLine(points, colour, width, dashes = []) {
    if (points.length < 2) return;
    const context = this.context;
    context.beginPath();
    for (const [x, y] of points) {
      const at = this.toScreen(x, y);
      context.lineTo(at.x, at.y);
    }
    context.setLineDash(dashes);
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
    context.setLineDash([]);
  }

  drawScan(colour) {
    if (!this.scan) return;
    this.context.fillStyle = colour;
    for (let index = 0; index < this.scan.length; index += 2) {
      const at = this.toScreen(this.scan[index], this.scan[index + 1]);
      this.context.fillRect(at.x - 1, at.y - 1, 2, 2);
    }
  }

  drawMark(mark, ink, accent) {
    const context = this.context;
    const at = this.toScreen(mark.x, mark.y);
    context.save();
    context.translate(at.x, at.y);
    context.rotate(-mark.theta);
    context.beginPath();
    context.moveTo(9, 0);
    context.lineTo(-6, 5.5);
    context.lineTo(-6, -5.5);
    context.closePath();
    context.fillStyle = accent;
    context.globalAlpha = 0.75;
    context.fill();
    context.restore();
    context.fillStyle = ink;
    context.font = "12px system-ui, sans-serif";
    context.fillText(mark.number, at.x + 9, at.y - 7);
  }

  drawObstacle({x, y, radius}, colour) {
    const at = this.toScreen(x, y);
    this.context.beginPath();
    this.context.arc(at.x, at.y, Math.max(4, radius * this.scale), 0, 2 * Math.PI);
    this.context.fillStyle = colour;
    this.context.fill();
  }

  drawRobot(colour, light) {
    const context = this.context;
    const {x, y, theta} = this.pose;
    const corners = this.outline.length > 2 ? this.outline :
      [[0.3, 0.25], [-0.3, 0.25], [-0.3, -0.25], [0.3, -0.25]];
    const at = this.toScreen(x, y);
    const size = Math.max(this.scale, 18 / Math.max(...corners.map(([a, b]) => Math.hypot(a, b))));
    context.save();
    context.translate(at.x, at.y);
    context.rotate(-theta);
    context.beginPath();
    for (const [forward, left] of corners) context.lineTo(forward * size, -left * size);
    context.closePath();
    context.globalAlpha = 0.85;
    context.fillStyle = colour;
    context.fill();
    const front = Math.max(...corners.map(([forward]) => forward)) * size;
    context.globalAlpha = 1;
    context.fillStyle = light;
    context.beginPath();
    context.moveTo(front * 0.8, 0);
    context.lineTo(front * 0.2, front * 0.4);
    context.lineTo(front * 0.2, -front * 0.4);
    context.fill();
    context.restore();
  }

  drawArrow(colour) {
    const context = this.context;
    const {from, to} = this.arrow;
    const angle = Math.atan2(to.y - from.y, to.x - from.x);
    context.strokeStyle = colour;
    context.lineWidth = 3;
    context.beginPath();
    context.arc(from.x, from.y, 6, 0, 2 * Math.PI);
    context.moveTo(from.x, from.y);
    context.lineTo(to.x, to.y);
    for (const side of [2.6, -2.6]) {
      context.moveTo(to.x, to.y);
      context.lineTo(to.x + 12 * Math.cos(angle + side), to.y + 12 * Math.sin(angle + side));
    }
    context.stroke();
  }
}

function limited(scale) {
  return Math.min(MAX_SCALE, Math.max(MIN_SCALE, scale));
}

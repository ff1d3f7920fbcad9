// Drawing of the map. It needs no other state of the page than a `Picture`.

/** @typedef {import("./view.js").View} View */
/** @typedef {import("../store.js").Point} Point */
/** @typedef {import("../store.js").Pose} Pose */
/**
 * @typedef {object} Painter what is needed to draw
 * @property {CanvasRenderingContext2D} context
 * @property {View} view
 * @property {Record<string, string>} colours by the names of the custom properties, without `--`
 */
/**
 * @typedef {object} Picture the objects to draw; absent properties are not drawn
 * @property {{image: CanvasImageSource, width: number, height: number, resolution: number,
 *   origin: Pose}} [area]
 * @property {CanvasImageSource} [keepout] image of the same size as the image of the area
 * @property {import("../store.js").Zone[]} zones
 * @property {number[][][]} lanes
 * @property {import("../store.js").Mark[]} marks
 * @property {string} [chosenMark] number of the mark that is selected, or else where the robot goes
 * @property {number[][]} trail where the robot has been
 * @property {number[][]} path that the robot follows, from where it is
 * @property {number[][]} planned path to the target
 * @property {Pose} [target]
 * @property {{pose: Pose, points: Float32Array}} [scan]
 * @property {import("../store.js").Fault[]} obstacles
 * @property {import("../store.js").PlacedRobot[]} others
 * @property {Pose} [pose]
 * @property {boolean} lost true if the robot does not know its place
 * @property {string} [name] of the robot, if there are others
 * @property {Pose} [draft] pose that is about to be sent to the robot, drawn instead of `pose`
 * @property {number[][]} outline
 * @property {[Point, Point]} [measured]
 * @property {{from: Point, to: Point}} [arrow] in pixels
 * @property {boolean} cross true to show the place that the enter key presses
 */

const DEFAULT_OUTLINE = [
  [0.3, 0.25],
  [-0.3, 0.25],
  [-0.3, -0.25],
  [0.3, -0.25],
]; // outline of a robot that has not reported its own, in metres
const MIN_RADIUS = 16; // minimum pixels from the middle of a robot to its farthest corner
const FONT = "600 12px system-ui, sans-serif"; // of the texts
const BOLT = new Path2D("M1 -6 -4 1H-.5L-1.500 6 4 -1H.5z"); // of a charger, around its middle
const AT_MARK = 0.5; // metres from a mark within which it shows the end of the path
const MANY_MARKS = 150; // if more marks are on the screen, they are drawn without texts

/**
 * Draw the map and all that is on it.
 * @param {Painter} painter
 * @param {Picture} picture
 */
export function draw(painter, picture) {
  const { context, view, colours } = painter;
  context.clearRect(0, 0, view.width, view.height);
  const { area } = picture;
  if (area) {
    drawImage(painter, area, area.image);
    if (picture.keepout) drawImage(painter, area, picture.keepout);
  }
  for (const zone of picture.zones) drawZone(painter, zone);
  for (const lane of picture.lanes) line(painter, lane, colours.edge, 1, [2, 4]);
  line(painter, picture.trail, colours.faint, 1.5, [3, 5]);
  line(painter, picture.path, colours.accent, 3);
  drawEnd(painter, picture);
  line(painter, picture.planned, colours.accent, 3, [8, 6]);
  for (const obstacle of picture.obstacles) drawObstacle(painter, obstacle);
  if (picture.scan) drawScan(painter, picture.scan);
  drawMarks(painter, picture);
  for (const each of picture.others) {
    drawRobot(painter, each, each.outline, colours.edge, colours["map-floor"], each.name);
  }
  const { pose, draft, target, outline } = picture;
  if (pose && !draft) {
    const [colour, contrast] = picture.lost
      ? [colours["map-floor"], colours.warning]
      : [colours.accent, colours["on-accent"]];
    const name = [picture.name, picture.lost && "?"].filter(Boolean).join(" ");
    drawRobot(painter, pose, outline, colour, contrast, name);
  }
  if (draft) drawRobot(painter, draft, outline, colours.warning, colours["map-floor"]);
  if (target) drawTarget(painter, target);
  if (picture.measured) drawMeasured(painter, picture.measured);
  if (picture.arrow) drawArrow(painter, picture.arrow);
  if (picture.cross) drawCross(painter);
  drawScale(painter);
}

/**
 * @param {Painter} painter
 * @param {NonNullable<Picture["area"]>} area
 * @param {CanvasImageSource} image
 */
function drawImage({ context, view }, area, image) {
  const { origin, resolution, width, height } = area;
  const corner = view.toScreen(origin.x, origin.y);
  const pixel = resolution * view.scale;
  context.save();
  context.translate(corner.x, corner.y);
  context.rotate(-origin.theta - view.angle);
  context.imageSmoothingEnabled = pixel < 1;
  context.drawImage(image, 0, -height * pixel, width * pixel, height * pixel);
  context.restore();
}

/**
 * Make points of the map the current path of the canvas.
 * @param {Painter} painter
 * @param {number[][]} points
 */
function trace({ context, view }, points) {
  context.beginPath();
  for (const [x, y] of points) {
    const at = view.toScreen(x, y);
    context.lineTo(at.x, at.y);
  }
}

/**
 * Draw a line through points of the map.
 * @param {Painter} painter
 * @param {number[][]} points
 * @param {string} colour
 * @param {number} width in pixels
 * @param {number[]} dashes lengths of the dashes and gaps, in pixels
 */
function line(painter, points, colour, width, dashes = []) {
  if (points.length < 2) return;
  const { context } = painter;
  trace(painter, points);
  context.setLineDash(dashes);
  context.lineJoin = "round";
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
  context.setLineDash([]);
}

/**
 * Draw a ring at the end of the path, unless a mark is there.
 * @param {Painter} painter
 * @param {Picture} picture
 */
function drawEnd({ context, view, colours }, { path, marks }) {
  const [x, y] = path.at(-1) ?? [];
  if (x === undefined || marks.some((mark) => Math.hypot(mark.x - x, mark.y - y) < AT_MARK)) return;
  const at = view.toScreen(x, y);
  context.beginPath();
  context.arc(at.x, at.y, 7, 0, 2 * Math.PI);
  context.fillStyle = colours["map-floor"];
  context.fill();
  context.strokeStyle = colours.accent;
  context.lineWidth = 3;
  context.stroke();
}

/**
 * @param {Painter} painter
 * @param {import("../store.js").Zone} zone
 */
function drawZone(painter, zone) {
  const { context, view, colours } = painter;
  trace(painter, zone.outline);
  context.closePath();
  context.fillStyle = context.strokeStyle = colours.warning;
  context.globalAlpha = 0.1;
  context.fill();
  context.globalAlpha = 0.8;
  context.lineWidth = 1;
  context.stroke();
  context.globalAlpha = 1;
  if (zone.speed) {
    const middle = (/** @type {number} */ axis) =>
      zone.outline.reduce((sum, corner) => sum + corner[axis], 0) / zone.outline.length;
    const at = view.toScreen(middle(0), middle(1));
    text(painter, `${zone.speed} m/s`, at.x, at.y, "center");
  }
}

/**
 * @param {Painter} painter
 * @param {{pose: Pose, points: Float32Array}} scan
 */
function drawScan({ context, view, colours }, { pose, points }) {
  const at = view.toScreen(pose.x, pose.y);
  const turn = pose.theta + view.angle;
  const cos = Math.cos(turn) * view.scale;
  const sin = Math.sin(turn) * view.scale;
  context.fillStyle = colours.laser;
  for (let index = 0; index < points.length; index += 2) {
    const forward = points[index];
    const left = points[index + 1];
    const x = at.x + forward * cos - left * sin;
    const y = at.y - forward * sin - left * cos;
    context.fillRect(x - 1, y - 1, 2, 2);
  }
}

/**
 * @param {Painter} painter
 * @param {Picture} picture
 */
function drawMarks(painter, { marks, chosenMark }) {
  const { context, view, colours } = painter;
  const shown = marks
    .map((mark) => ({ mark, at: view.toScreen(mark.x, mark.y) }))
    .filter(
      ({ at }) => at.x > -20 && at.y > -20 && at.x < view.width + 20 && at.y < view.height + 20,
    );
  const many = shown.length > MANY_MARKS;
  for (const { mark, at } of shown) {
    const chosen = mark.number === chosenMark;
    const hasSymbol = !many && ["charger", "parkspot"].includes(mark.type);
    const contrast = chosen ? colours["on-accent"] : colours.accent;
    context.save();
    context.translate(at.x, at.y);
    context.rotate(-mark.theta - view.angle);
    if (hasSymbol) {
      context.fillStyle = colours.accent;
      triangle(context, 15, 8, 5);
    }
    context.beginPath();
    context.arc(0, 0, many ? 3 : hasSymbol ? 9 : 8, 0, 2 * Math.PI);
    context.fillStyle = chosen ? colours.accent : colours["map-floor"];
    context.fill();
    context.strokeStyle = colours.accent;
    context.lineWidth = 1.5;
    context.stroke();
    context.fillStyle = contrast;
    if (!hasSymbol) triangle(context, 5.5, -3, 4);
    context.restore();
    if (hasSymbol) drawSymbol(context, mark.type, at, contrast);
    if (many && !chosen) continue;
    // at the right edge, the text is to the left of the mark
    context.font = FONT;
    const fits = at.x + 11 + context.measureText(mark.number).width < view.width;
    text(painter, mark.number, at.x + (fits ? 11 : -11), at.y - 6, fits ? "left" : "right");
  }
}

/**
 * Draw the symbol of a charger or of a parking place, upright.
 * @param {CanvasRenderingContext2D} context
 * @param {string} type
 * @param {Point} at in pixels
 * @param {string} colour
 */
function drawSymbol(context, type, at, colour) {
  context.save();
  context.translate(at.x, at.y);
  context.fillStyle = colour;
  context.font = "700 12px system-ui, sans-serif";
  context.textAlign = "center";
  if (type === "charger") context.fill(BOLT);
  else context.fillText("P", 0, 4.5);
  context.restore();
}

/**
 * Fill a triangle that points along the x axis.
 * @param {CanvasRenderingContext2D} context
 * @param {number} front x of its tip
 * @param {number} back x of its other corners
 * @param {number} side distance of these from the axis
 */
function triangle(context, front, back, side) {
  context.beginPath();
  context.moveTo(front, 0);
  context.lineTo(back, side);
  context.lineTo(back, -side);
  context.fill();
}

/**
 * Write a text that can be read on any background.
 * @param {Painter} painter
 * @param {string} content
 * @param {number} x
 * @param {number} y
 * @param {CanvasTextAlign} align
 */
function text({ context, colours }, content, x, y, align = "left") {
  context.font = FONT;
  context.textAlign = align;
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = colours["map-floor"];
  context.strokeText(content, x, y);
  context.fillStyle = colours.ink;
  context.fillText(content, x, y);
}

/**
 * @param {Painter} painter
 * @param {import("../store.js").Fault} obstacle
 */
function drawObstacle({ context, view, colours }, { x = 0, y = 0, radius = 0 }) {
  const at = view.toScreen(x, y);
  context.beginPath();
  context.arc(at.x, at.y, Math.max(4, radius * view.scale), 0, 2 * Math.PI);
  context.fillStyle = colours.warning;
  context.fill();
}

/**
 * @param {Painter} painter
 * @param {Pose} pose
 * @param {number[][]} outline
 * @param {string} colour
 * @param {string} contrast colour of its border and nose
 * @param {string} name beside it
 */
function drawRobot(painter, pose, outline, colour, contrast, name = "") {
  const { context, view } = painter;
  const corners = outline.length > 2 ? outline : DEFAULT_OUTLINE;
  const at = view.toScreen(pose.x, pose.y);
  const radius = Math.max(...corners.map(([a, b]) => Math.hypot(a, b)));
  const scale = Math.max(view.scale, MIN_RADIUS / radius);
  context.save();
  context.translate(at.x, at.y);
  context.rotate(-pose.theta - view.angle);
  context.beginPath();
  for (const [forward, left] of corners) context.lineTo(forward * scale, -left * scale);
  context.closePath();
  context.lineJoin = "round";
  context.lineWidth = 2;
  context.strokeStyle = contrast;
  context.stroke();
  context.fillStyle = colour;
  context.fill();
  const front = Math.max(...corners.map(([forward]) => forward)) * scale;
  context.fillStyle = contrast;
  triangle(context, front * 0.8, front * 0.15, front * 0.42);
  context.restore();
  text(painter, name, at.x + 14, at.y - 12);
}

/**
 * @param {Painter} painter
 * @param {Pose} pose
 */
function drawTarget(painter, pose) {
  const at = painter.view.toScreen(pose.x, pose.y);
  const turn = pose.theta + painter.view.angle;
  const to = { x: at.x + 34 * Math.cos(turn), y: at.y - 34 * Math.sin(turn) };
  drawArrow(painter, { from: at, to });
}

/**
 * @param {Painter} painter
 * @param {{from: Point, to: Point}} arrow in pixels
 */
function drawArrow({ context, colours }, { from, to }) {
  const angle = Math.atan2(to.y - from.y, to.x - from.x);
  context.strokeStyle = colours.accent;
  context.lineWidth = 3;
  context.beginPath();
  context.arc(from.x, from.y, 7, 0, 2 * Math.PI);
  context.moveTo(from.x, from.y);
  context.lineTo(to.x, to.y);
  // the head: two lines, at these angles to the arrow in radians
  for (const side of [2.6, -2.6]) {
    context.moveTo(to.x, to.y);
    context.lineTo(to.x + 12 * Math.cos(angle + side), to.y + 12 * Math.sin(angle + side));
  }
  context.stroke();
}

/**
 * @param {Painter} painter
 * @param {[Point, Point]} measured
 */
function drawMeasured(painter, [from, to]) {
  const { context, view, colours } = painter;
  const begin = view.toScreen(from.x, from.y);
  const end = view.toScreen(to.x, to.y);
  const points = [from, to].map(({ x, y }) => [x, y]);
  line(painter, points, colours.ink, 2);
  for (const { x, y } of [begin, end]) {
    context.beginPath();
    context.arc(x, y, 4, 0, 2 * Math.PI);
    context.fillStyle = colours.ink;
    context.fill();
  }
  const length = `${Math.hypot(to.x - from.x, to.y - from.y).toFixed(2)} m`;
  // above the line, or beside a steep one, at a right angle to it
  const slope = Math.atan((end.y - begin.y) / (end.x - begin.x || 1e-9));
  context.font = FONT;
  const { width } = context.measureText(length);
  const away = 4 + 8 * Math.cos(slope) + (width / 2) * Math.abs(Math.sin(slope));
  const x = (begin.x + end.x) / 2 + away * Math.sin(slope);
  const y = (begin.y + end.y) / 2 - away * Math.cos(slope);
  text(painter, length, x, y + 4, "center");
}

/** @param {Painter} painter */
function drawCross(painter) {
  const { context, view, colours } = painter;
  const { x, y } = view.middle;
  for (const [colour, width] of /** @type {[string, number][]} */ ([
    [colours["map-floor"], 5],
    [colours.ink, 2],
  ])) {
    context.beginPath();
    context.moveTo(x - 14, y);
    context.lineTo(x + 14, y);
    context.moveTo(x, y - 14);
    context.lineTo(x, y + 14);
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
  }
  text(painter, "Enter", x, y + 30, "center");
}

/**
 * Return the scale bar: its left end, in pixels, and its length, in metres. Its text is above it.
 * @param {View} view
 */
export function scaleBar(view) {
  const maximum = 120 / view.scale; // metres
  const power = 10 ** Math.floor(Math.log10(maximum));
  const length = [5, 2, 1].map((factor) => factor * power).find((each) => each <= maximum) ?? power;
  return { x: 14 + view.inset.left, y: view.height - 14 - view.inset.bottom, length };
}

/** @param {Painter} painter */
function drawScale(painter) {
  const { context, view, colours } = painter;
  const { x, y, length } = scaleBar(view);
  context.beginPath();
  context.moveTo(x, y - 5);
  context.lineTo(x, y);
  context.lineTo(x + length * view.scale, y);
  context.lineTo(x + length * view.scale, y - 5);
  context.lineWidth = 2;
  context.strokeStyle = colours.ink;
  context.stroke();
  const shown = length < 1 ? `${Math.round(length * 100)} cm` : `${length} m`;
  text(painter, shown, x + (length * view.scale) / 2, y - 7, "center");
}

/**
 * Return a grey picture in the colours of the page.
 * @param {HTMLImageElement} image
 * @param {(shade: number) => [number, number, number, number]} colourOf red, green, blue, opacity
 * @returns {OffscreenCanvas}
 */
export function recoloured(image, colourOf) {
  const canvas = new OffscreenCanvas(image.width, image.height);
  const context = /** @type {OffscreenCanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.drawImage(image, 0, 0);
  const pixels = context.getImageData(0, 0, image.width, image.height);
  const colours = new Uint32Array(pixels.data.buffer); // of the pixels
  const table = Uint32Array.from({ length: 256 }, (_, shade) => {
    const [red, green, blue, opacity] = colourOf(shade);
    return new Uint32Array(Uint8ClampedArray.of(red, green, blue, opacity).buffer)[0];
  });
  for (let index = 0; index < colours.length; index++)
    colours[index] = table[pixels.data[4 * index]];
  context.putImageData(pixels, 0, 0);
  return canvas;
}

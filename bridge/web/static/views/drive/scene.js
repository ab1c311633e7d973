// Draws the objects on the map. `view.to(x, y)` is the pixel of a place, `view.scale` the number of pixels per meter.

/** The colors of the page's theme, by the names of style.css. */
export function colors() {
  const style = getComputedStyle(document.documentElement);
  const names = ["floor", "grid", "ink", "muted", "accent", "laser", "path", "layer", "area", "goal", "halo", "bad", "held",
    "robot-0", "robot-1", "robot-2", "robot-3", "robot-4", "robot-5"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

/** A grid in meters, drawn if there is no map. */
export function drawGrid(context, view, color) {
  const step = niceStep(60 / view.scale);
  const [left, top] = view.toMap(0, 0);
  const [right, bottom] = view.toMap(view.width, view.height);
  context.strokeStyle = color.grid;
  context.lineWidth = 1;
  context.beginPath();
  for (let x = Math.ceil(left / step) * step; x < right; x += step) {
    const [px] = view.to(x, 0);
    context.moveTo(Math.round(px) + 0.5, 0);
    context.lineTo(Math.round(px) + 0.5, view.height);
  }
  for (let y = Math.ceil(bottom / step) * step; y < top; y += step) {
    const [, py] = view.to(0, y);
    context.moveTo(0, Math.round(py) + 0.5);
    context.lineTo(view.width, Math.round(py) + 0.5);
  }
  context.stroke();
}

/** The largest of 1, 2, 5 times a power of ten that is at most `most`. */
export function niceStep(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].find((each) => each * power <= most) * power;
}

/** A scale bar in the corner, `above` pixels above the edge. */
export function drawScale(context, view, color, above) {
  const meters = niceStep(110 / view.scale);
  const wide = meters * view.scale;
  const [x, y] = [view.width - 16 - wide, view.height - above - 0.5];
  const text = meters >= 1 ? `${meters} m` : `${Math.round(meters * 100)} cm`;
  context.lineWidth = 5;
  context.strokeStyle = color.halo;
  const line = () => {
    context.beginPath();
    context.moveTo(x, y - 5);
    context.lineTo(x, y);
    context.lineTo(x + wide, y);
    context.lineTo(x + wide, y - 5);
    context.stroke();
  };
  line();
  context.lineWidth = 1.5;
  context.strokeStyle = color.ink;
  line();
  label(context, text, x + wide / 2, y - 8, color);
}

/** A text centered at x, with a halo so that it is readable on any map. */
function label(context, text, x, y, color, bold = false) {
  context.font = `${bold ? "600 " : ""}13px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  context.lineJoin = "round";
  context.lineWidth = 4;
  context.strokeStyle = color.halo;
  context.strokeText(text, x, y);
  context.fillStyle = color.ink;
  context.fillText(text, x, y);
}

const PASSED = 0.35; // opacity of the path behind the robot

/** A path through points ([x, y, x, y, ...]); the part behind the robot (`pose`, if known) is pale. */
export function drawPath(context, view, points, pose, color) {
  if (points.length < 4) return;
  const [at, x, y] = pose ? nearest(points, pose) : [0, points[0], points[1]];
  const pixels = [];
  for (let i = 0; i + 1 < points.length; i += 2) pixels.push(view.to(points[i], points[i + 1]));
  const here = view.to(x, y);
  context.lineJoin = context.lineCap = "round";
  line(context, [...pixels.slice(0, at + 1), here], 3, color.path, PASSED);
  const left = [here, ...pixels.slice(at + 1)];
  line(context, left, 6, color.halo);
  line(context, left, 3, color.path);
}

/** The robot's trail. */
export function drawTrail(context, view, points, color) {
  const pixels = [];
  for (let i = 0; i + 1 < points.length; i += 2) pixels.push(view.to(points[i], points[i + 1]));
  context.lineJoin = context.lineCap = "round";
  line(context, pixels, 3, color.path, PASSED);
}

function line(context, pixels, width, ink, opacity = 1) {
  context.lineWidth = width;
  context.strokeStyle = ink;
  context.globalAlpha = opacity;
  context.beginPath();
  for (const pixel of pixels) context.lineTo(...pixel);
  context.stroke();
  context.globalAlpha = 1;
}

/** The point on a path that is nearest to x, y: [index of the path's last corner before this point, x, y]. */
export function nearest(points, { x, y }) {
  let [least, found] = [Infinity, [0, points[0], points[1]]];
  for (let i = 0; i + 3 < points.length; i += 2) {
    const [px, py] = onLine(points[i], points[i + 1], points[i + 2], points[i + 3], x, y);
    const far = Math.hypot(px - x, py - y);
    if (far < least) [least, found] = [far, [i / 2, px, py]];
  }
  return found;
}

/** The planner's obstacles: cells of `size` meters. */
export function drawObstacles(context, view, { points, size }, color) {
  const side = Math.max(3, size * view.scale);
  context.fillStyle = color.held;
  context.globalAlpha = 0.5;
  for (let i = 0; i + 1 < points.length; i += 2) {
    const [x, y] = view.to(points[i], points[i + 1]);
    context.fillRect(x - side / 2, y - side / 2, side, side);
  }
  context.globalAlpha = 1;
}

/** The laser scan. */
export function drawLaser(context, view, points, color) {
  const size = Math.max(2, Math.min(5, view.scale * 0.04));
  context.fillStyle = color.laser;
  for (let i = 0; i + 1 < points.length; i += 2) {
    const [x, y] = view.to(points[i], points[i + 1]);
    context.fillRect(x - size / 2, y - size / 2, size, size);
  }
}

/** The robot: footprint and heading. `old`: the connection is lost, so the robot may be elsewhere. */
export function drawRobot(context, view, { pose, footprint }, color, old) {
  const [cos, sin] = [Math.cos(pose.theta), Math.sin(pose.theta)];
  const at = (x, y) => view.to(pose.x + cos * x - sin * y, pose.y + sin * x + cos * y);
  const outline = footprint?.length > 2 ? footprint : disc(0.25);
  const reach = Math.max(...outline.map(([x, y]) => Math.hypot(x, y)));
  const ink = old ? color.muted : color.accent;
  context.lineJoin = "round";
  shape(context, outline.map(([x, y]) => at(x, y)));
  context.fillStyle = ink;
  context.globalAlpha = 0.25;
  context.fill();
  context.globalAlpha = 1;
  context.lineWidth = 2;
  context.strokeStyle = ink;
  context.stroke();
  const size = Math.max(reach * 0.75, 9 / view.scale); // visible on a large map too
  shape(context, [[1, 0], [-0.7, 0.65], [-0.35, 0], [-0.7, -0.65]].map(([x, y]) => at(x * size, y * size)));
  context.lineWidth = 3;
  context.strokeStyle = color.halo;
  context.stroke();
  context.fillStyle = ink;
  context.fill();
}

const disc = (radius) => Array.from({ length: 24 }, (_, i) => [radius * Math.cos(i / 3.82), radius * Math.sin(i / 3.82)]);

function shape(context, points) {
  context.beginPath();
  for (const point of points) context.lineTo(...point);
  context.closePath();
}

/** Areas, paths and places, without their names. */
export function drawPlaces(context, view, { areas, paths, locations }, color) {
  for (const [, { points }] of areas) drawArea(context, view, points, color);
  for (const [, { points }] of paths) drawNamedPath(context, view, points, color);
  for (const [, place] of locations) drawPlace(context, view, place, color);
}

/** A place: a dot with its heading. */
function drawPlace(context, view, place, color) {
  const [x, y] = view.to(place.x, place.y);
  context.lineWidth = 2;
  context.strokeStyle = color.goal;
  context.fillStyle = color.halo;
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(x + 13 * Math.cos(place.theta), y - 13 * Math.sin(place.theta));
  context.stroke();
  context.beginPath();
  context.arc(x, y, 4.5, 0, 2 * Math.PI);
  context.fill();
  context.stroke();
}

/** An area: its outline. */
function drawArea(context, view, points, color) {
  if (points.length < 2) return;
  const pixels = points.map(([x, y]) => view.to(x, y));
  shape(context, pixels);
  context.fillStyle = color.area;
  context.globalAlpha = 0.07;
  context.fill();
  context.globalAlpha = 1;
  context.setLineDash([6, 4]);
  context.lineWidth = 1.5;
  context.strokeStyle = color.area;
  context.stroke();
  context.setLineDash([]);
}

/** A named path: a dotted line. */
function drawNamedPath(context, view, points, color) {
  if (!points.length) return;
  const pixels = points.map(([x, y]) => view.to(x, y));
  context.beginPath();
  for (const pixel of pixels) context.lineTo(...pixel);
  context.setLineDash([2, 6]);
  context.lineCap = "round";
  context.lineWidth = 3;
  context.strokeStyle = color.area;
  context.stroke();
  context.setLineDash([]);
}

/** The names of places, then those of areas and paths if there is space. */
export function drawNames(labels, view, { areas, paths, locations }, color) {
  for (const [name, place] of locations) {
    const [x, y] = view.to(place.x, place.y);
    labels.put(name, [[x + 10, y + 17], [x + 10, y - 8], [x - 10, y + 17, "right"], [x - 10, y - 8, "right"]], color.ink);
  }
  for (const [name, { points }] of areas) {
    const pixels = points.map(([x, y]) => view.to(x, y));
    const [left, top] = [0, 1].map((axis) => Math.min(...pixels.map((pixel) => pixel[axis])));
    const right = Math.max(...pixels.map(([x]) => x));
    labels.put(name, [[left + 14, top + 24], [left + 14, top + 42]], color.area, right - left - 20);
  }
  for (const [name, { points }] of paths) {
    if (!points.length) continue;
    const [x, y] = view.to(...points[0]);
    labels.put(name, [[x + 8, y - 8], [x + 8, y + 18]], color.area);
  }
}

/** The goal, or a pose being set: a ring and, with a heading, an arrow. */
export function drawPose(context, view, { x, y, theta }, ink, color, length = 30) {
  const [px, py] = view.to(x, y);
  const line = () => {
    context.beginPath();
    context.arc(px, py, 9, 0, 2 * Math.PI);
    if (typeof theta === "number") {
      const [dx, dy] = [Math.cos(theta), -Math.sin(theta)];
      const [ex, ey] = [px + length * dx, py + length * dy];
      context.moveTo(px + 9 * dx, py + 9 * dy);
      context.lineTo(ex, ey);
      context.moveTo(ex - 9 * dx - 6 * dy, ey - 9 * dy + 6 * dx);
      context.lineTo(ex, ey);
      context.lineTo(ex - 9 * dx + 6 * dy, ey - 9 * dy - 6 * dx);
    }
    context.stroke();
  };
  context.lineJoin = context.lineCap = "round";
  context.lineWidth = 6;
  context.strokeStyle = color.halo;
  line();
  context.lineWidth = 2.5;
  context.strokeStyle = ink;
  line();
}

/** A cross at the center of the window, where the keyboard sets poses. */
export function drawCross(context, view, color) {
  const [x, y] = [Math.round(view.width / 2) + 0.5, Math.round(view.height / 2) + 0.5];
  for (const [width, ink] of [[5, color.halo], [2, color.ink]]) {
    context.lineWidth = width;
    context.strokeStyle = ink;
    context.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(x + 4 * dx, y + 4 * dy);
      context.lineTo(x + 14 * dx, y + 14 * dy);
    }
    context.stroke();
  }
}

/** Whether x, y is inside the polygon `points`. */
export function inside(points, x, y) {
  let odd = false;
  points.forEach(([ax, ay], i) => {
    const [bx, by] = points[(i + 1) % points.length];
    if (ay > y !== by > y && x < ax + ((y - ay) * (bx - ax)) / (by - ay)) odd = !odd;
  });
  return odd;
}

/** The point on the line from a to b that is nearest to x, y. */
function onLine(ax, ay, bx, by, x, y) {
  const [dx, dy] = [bx - ax, by - ay];
  const share = Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
  return [ax + share * dx, ay + share * dy];
}

/** The distance of x, y from the line through `points`. */
export function distanceFrom(points, x, y) {
  let least = Infinity;
  points.forEach(([bx, by], i) => {
    const [ax, ay] = points[Math.max(i - 1, 0)];
    const [px, py] = onLine(ax, ay, bx, by, x, y);
    least = Math.min(least, Math.hypot(px - x, py - y));
  });
  return least;
}

/** A measured line from a to b, with its length. */
export function drawMeasure(context, view, [a, b], color) {
  const [ax, ay] = view.to(a.x, a.y);
  const [bx, by] = view.to(b.x, b.y);
  for (const [width, ink] of [[5, color.halo], [2, color.ink]]) {
    context.lineWidth = width;
    context.strokeStyle = ink;
    context.beginPath();
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
    for (const [x, y] of [[ax, ay], [bx, by]]) {
      context.moveTo(x + 4, y);
      context.arc(x, y, 4, 0, 2 * Math.PI);
    }
    context.stroke();
  }
  const text = `${Math.hypot(b.x - a.x, b.y - a.y).toFixed(2)} m`;
  label(context, text, (ax + bx) / 2, (ay + by) / 2 - 9, color, true);
}

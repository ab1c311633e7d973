// The visible part of the map: the center in meters, and CSS pixels per meter.

const NEAREST = 400;
const FARTHEST = 0.5;

/** Converts places on the map to pixels and back; y of the map points up. */
export class Viewport {
  constructor() {
    this.x = 0;
    this.y = 0;
    this.scale = 40;
    this.width = 1;
    this.height = 1;
  }

  /** The pixel of a place. */
  to(x, y) {
    return [(x - this.x) * this.scale + this.width / 2, this.height / 2 - (y - this.y) * this.scale];
  }

  /** The place of a pixel. */
  toMap(px, py) {
    return [(px - this.width / 2) / this.scale + this.x, (this.height / 2 - py) / this.scale + this.y];
  }

  /** Move by pixels. */
  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** Zoom around a pixel. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toMap(px, py);
    this.scale = Math.min(NEAREST, Math.max(FARTHEST, this.scale * factor));
    const [nowX, nowY] = this.toMap(px, py);
    this.x += x - nowX;
    this.y += y - nowY;
  }

  /** Show a whole map; `room`: pixels at each edge that controls cover. */
  fit(map, room) {
    const corners = mapCorners(map);
    const [left, right] = [Math.min(...corners.map(([x]) => x)), Math.max(...corners.map(([x]) => x))];
    const [low, high] = [Math.min(...corners.map(([, y]) => y)), Math.max(...corners.map(([, y]) => y))];
    this.x = (left + right) / 2;
    this.y = (low + high) / 2;
    const wide = Math.max(50, this.width - room.left - room.right);
    const tall = Math.max(50, this.height - room.top - room.bottom);
    this.scale = Math.min(NEAREST, Math.max(FARTHEST, Math.min(wide / (right - left), tall / (high - low))));
    this.pan((room.left - room.right) / 2, (room.top - room.bottom) / 2);
  }
}

function mapCorners({ width, height, resolution, origin }) {
  const [cos, sin] = [Math.cos(origin.theta), Math.sin(origin.theta)];
  return [[0, 0], [width, 0], [0, height], [width, height]].map(([column, row]) => {
    const [x, y] = [column * resolution, row * resolution];
    return [origin.x + cos * x - sin * y, origin.y + sin * x + cos * y];
  });
}

/**
 * Set a context's transform to the cells of a map's image (one unit is one cell, the first row is at the top); returns
 * {scale: device pixels per cell, part: the visible cells}. `ratio`: device pixels per CSS pixel.
 */
export function toCells(context, view, map, ratio) {
  const { resolution, height, origin } = map;
  const [cos, sin] = [Math.cos(origin.theta), Math.sin(origin.theta)];
  const k = view.scale * resolution;
  // the image's first pixel is the map's upper left corner: `height` cells above the origin
  const [px, py] = view.to(origin.x - sin * height * resolution, origin.y + cos * height * resolution);
  context.setTransform(ratio * k * cos, -ratio * k * sin, ratio * k * sin, ratio * k * cos, ratio * px, ratio * py);
  const cells = [[0, 0], [view.width, 0], [0, view.height], [view.width, view.height]].map(([x, y]) => {
    const [dx, dy] = [(x - px) / k, (y - py) / k];
    return [cos * dx - sin * dy, sin * dx + cos * dy];
  });
  const [xs, ys] = [0, 1].map((axis) => cells.map((cell) => cell[axis]));
  const part = { left: Math.min(...xs), right: Math.max(...xs), top: Math.min(...ys), bottom: Math.max(...ys) };
  return { scale: ratio * k, part };
}

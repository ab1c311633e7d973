// A layer's blocked cells, where a robot would collide, as a tint with the obstacles' heights.

import { meters } from "../../lib/format.js";
import { toCells } from "./viewport.js";

const TINT = 0.45;
const SHIFT = 0x100000; // more than the number of columns of a layer

/** The obstacle at a cell as text; "" if `cell` is null. */
export function heightWords(cell) {
  if (!cell) return "";
  return cell.height === null ? "a drop, or unknown height" : `hit at ${meters(cell.height)}`;
}

/** The feed `layer`, drawn once on a separate canvas, with lookup by position. */
export class HitLayer {
  constructor() {
    this.take(null);
  }

  /** Set the feed's value, or null. */
  take(value) {
    this.value = value;
    this.heights = new Map(); // row and column -> height
    this.image = null; // created on first drawing
    if (!value) return;
    const [rows, lefts, rights] = [[], [], []];
    for (const [row, column, ...heights] of value.runs) {
      rows.push(row);
      lefts.push(column);
      rights.push(column + heights.length);
      heights.forEach((height, i) => this.heights.set(row * SHIFT + column + i, height));
    }
    const least = (all) => all.reduce((one, other) => Math.min(one, other), Infinity);
    const most = (all) => all.reduce((one, other) => Math.max(one, other), -Infinity);
    this.box = { top: most(rows), low: least(rows), left: least(lefts), right: most(rights) };
  }

  /** The cell at a place of the map: {row, column, height}; null without an obstacle. */
  at(x, y) {
    if (!this.value) return null;
    const { origin, size } = this.value;
    const [cos, sin] = [Math.cos(origin.theta), Math.sin(origin.theta)];
    const [dx, dy] = [x - origin.x, y - origin.y];
    const [column, row] = [Math.floor((cos * dx + sin * dy) / size), Math.floor((cos * dy - sin * dx) / size)];
    const height = row < 0 || column < 0 ? undefined : this.heights.get(row * SHIFT + column);
    return height === undefined ? null : { row, column, height };
  }

  /** Tint the cells; afterwards the context has the transform of the cells. */
  draw(context, view, ratio, color) {
    if (!this.heights.size) return;
    const { low, left } = this.box;
    if (this.image?.color !== color) this.paint(color);
    const { canvas } = this.image;
    toCells(context, view, { resolution: this.value.size, height: canvas.height, origin: this.corner(low, left) }, ratio);
    context.imageSmoothingEnabled = false;
    context.globalAlpha = TINT;
    context.drawImage(canvas, 0, 0);
    context.globalAlpha = 1;
  }

  paint(color) {
    const { top, low, left, right } = this.box;
    const canvas = document.createElement("canvas");
    Object.assign(canvas, { width: right - left, height: top - low + 1 });
    const context = canvas.getContext("2d");
    context.fillStyle = color;
    for (const [row, column, ...heights] of this.value.runs) context.fillRect(column - left, top - row, heights.length, 1);
    this.image = { canvas, color };
  }

  /** A frame around one cell. */
  mark(context, view, { row, column }, color) {
    const corners = [[0, 0], [0, 1], [1, 1], [1, 0]].map(([up, along]) => {
      const { x, y } = this.corner(row + up, column + along);
      return view.to(x, y);
    });
    for (const [width, ink] of [[4, color.halo], [1.5, color.ink]]) {
      context.lineWidth = width;
      context.strokeStyle = ink;
      context.beginPath();
      for (const corner of corners) context.lineTo(...corner);
      context.closePath();
      context.stroke();
    }
  }

  /** The lower left corner of a cell, with the layer's heading. */
  corner(row, column) {
    const { origin, size } = this.value;
    const [cos, sin] = [Math.cos(origin.theta), Math.sin(origin.theta)];
    const [x, y] = [column * size, row * size];
    return { x: origin.x + cos * x - sin * y, y: origin.y + sin * x + cos * y, theta: origin.theta };
  }
}

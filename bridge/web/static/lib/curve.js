// Values of the last minute as a curve.

import { svg } from "./dom.js";

export const SPAN = 60; // seconds
const MOST = 1200; // maximum number of points in a series: those of a minute at 20 Hz

/** The numbers of the last minute, with the times at which they arrived. */
export class Series {
  constructor() {
    this.points = []; // [seconds, value], oldest first
  }

  add(value, now = performance.now() / 1000) {
    if (typeof value !== "number" || !Number.isFinite(value)) return;
    this.points.push([now, value]);
    const old = this.points.findIndex(([time]) => time >= now - SPAN);
    this.points.splice(0, Math.max(old, this.points.length - MOST));
  }

  /** Smallest and largest value. */
  range() {
    let [low, high] = [Infinity, -Infinity];
    for (const [, value] of this.points) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    return [low, high];
  }
}

/** A small curve next to a row. `from`: the lowest value of its axis; undefined: the smallest of the numbers. */
export class Spark {
  constructor(label) {
    this.line = svg("path", { class: "curve-line", "vector-effect": "non-scaling-stroke" });
    this.element = svg("svg", { class: "spark", viewBox: "0 0 60 20", preserveAspectRatio: "none", role: "img", "aria-label": label }, this.line);
  }

  draw(series, from = 0) {
    this.line.setAttribute("d", path(series, 60, 20, from));
  }
}

/** The SVG path of a minute's numbers in a box of `wide` x `high`, with gaps where no number arrived for long. */
function path(series, wide, high, from) {
  const { points } = series;
  if (points.length < 2) return "";
  const [low, top] = series.range();
  const bottom = Math.min(from ?? low, low);
  const span = top - bottom;
  const end = points.at(-1)[0];
  const pause = 3 * Math.max(1, (end - points[0][0]) / points.length);
  let text = "";
  let before = -Infinity;
  for (const [time, value] of points) {
    const x = wide * (1 - (end - time) / SPAN);
    const y = span ? high - 1 - ((value - bottom) / span) * (high - 2) : from === undefined ? high / 2 : high - 1;
    text += `${time - before > pause ? "M" : "L"}${x.toFixed(1)} ${y.toFixed(1)}`;
    before = time;
  }
  return text;
}

/** A large curve with its smallest, largest and newest value. */
export class Chart {
  constructor(label, format) {
    this.format = format;
    this.line = svg("path", { class: "curve-line", "vector-effect": "non-scaling-stroke" });
    this.plot = svg("svg", { class: "plot", viewBox: "0 0 600 120", preserveAspectRatio: "none", role: "img", "aria-label": label },
      svg("path", { class: "curve-grid", d: "M0 1H600M0 60H600M0 119H600M150 0V120M300 0V120M450 0V120", "vector-effect": "non-scaling-stroke" }),
      this.line);
  }

  /** Draw; returns [smallest, largest, newest] as texts. */
  draw(series) {
    this.line.setAttribute("d", path(series, 600, 120, undefined));
    const [low, high] = series.range();
    return series.points.length ? [low, high, series.points.at(-1)[1]].map(this.format) : ["–", "–", "–"];
  }
}

// Painting flags on the map, with undo and redo.

import { button, el, icon } from "../../lib/dom.js";
import { notify } from "../../lib/messages.js";
import { parts, runsOf } from "./strokes.js";

const FLAGS = [["Keep out", 1], ["Temporary obstacle", 2], ["Enlarged obstacle", 3], ["Wall", 4], ["Unknown", 5], ["Free", 0]];
const BRUSHES = [["One cell", 0], ["10 cm", 0.1], ["25 cm", 0.25], ["50 cm", 0.5], ["1 m", 1], ["2 m", 2]];
const MOST_RUNS = 2000; // per call, the console's limit
const MOST_CELLS = 200000;
const MOST_STEPS = 100; // maximum number of changes that can be undone
const MOST_WAITING = 20; // maximum number of strokes that the console has not confirmed
const SHOWN = 3000; // ms that a stroke stays drawn after the console's reply, until the new map arrives

/** The editor of flags on a map; see `MapBlock.edit`. */
export class PaintEditor {
  constructor(map, socket) {
    this.map = map;
    this.socket = socket;
    this.stroke = null; // {points, radius, flag}: the current stroke
    this.strokes = new Set(); // strokes that are not yet in the map
    this.undos = []; // {map, runs}, the newest last
    this.redos = [];
    this.work = Promise.resolve(); // changes run one after the other
    this.waiting = 0;
    this.flags = choice("Flag", FLAGS, 1);
    this.brushes = choice("Brush", BRUSHES, 0.25);
    this.flags.addEventListener("change", () => this.erase(false));
    this.eraser = button("Erase", () => this.erase(this.eraser.getAttribute("aria-pressed") !== "true"), { "aria-pressed": "false", title: "Restore the flags from the occupancy" });
    this.undoButton = step("Undo", "Z", "M9 5L4 10l5 5M4 10h10a6 6 0 0 1 0 12h-3", () => this.step(this.undos, this.redos, "Undo"));
    this.redoButton = step("Redo", "Y", "M15 5l5 5-5 5M20 10H10a6 6 0 0 0 0 12h3", () => this.step(this.redos, this.undos, "Redo"));
    this.controls = [this.flags, this.eraser, this.brushes, this.undoButton, this.redoButton];
    this.changed();
  }

  get hint() {
    if (!this.map.layers.on("flags")) return "The layer Flags is off: painted flags are not shown.";
    return this.map.values.map ? "" : "No map to paint on.";
  }

  erase(on) {
    this.eraser.setAttribute("aria-pressed", String(on));
  }

  /** The flag to paint; null: the flag for the occupancy. */
  get flag() {
    return this.eraser.getAttribute("aria-pressed") === "true" ? null : Number(this.flags.value);
  }

  changed() {
    this.undoButton.disabled = !this.undos.length;
    this.redoButton.disabled = !this.redos.length;
    this.map.redraw();
  }

  // -- gestures and keys

  press(px, py) {
    this.stroke = { points: [this.map.view.toMap(px, py)], radius: this.brushes.value / 2, flag: this.flag };
    this.map.redraw();
  }

  move(px, py) {
    const at = this.map.view.toMap(px, py);
    const [x, y] = this.stroke.points.at(-1);
    if (Math.hypot(at[0] - x, at[1] - y) * this.map.view.scale >= 2) this.stroke.points.push(at);
    this.map.redraw();
  }

  let(px, py, far) {
    if (far) this.move(px, py);
    const { stroke } = this;
    this.stroke = null;
    this.paint(stroke);
  }

  forget() {
    this.stroke = null;
    this.map.redraw();
  }

  key(event) {
    const { view } = this.map;
    const from = [view.x, view.y];
    const step = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[event.key];
    const letter = event.ctrlKey || event.metaKey ? event.key.toLowerCase() : "";
    if (letter === "z" && !event.shiftKey) this.undoButton.click();
    else if (letter === "y" || letter === "z") this.redoButton.click();
    else if (event.key === "Enter") this.paint({ points: [from], radius: this.brushes.value / 2, flag: this.flag });
    else if (step && event.shiftKey) {
      this.map.pan(...step);
      this.paint({ points: [from, [view.x, view.y]], radius: this.brushes.value / 2, flag: this.flag });
    } else return false;
    return true;
  }

  // -- changes

  paint(stroke) {
    const { map } = this.map.values;
    if (!map) return;
    const runs = runsOf(map, stroke.points, stroke.radius).map((run) => [...run, stroke.flag]);
    if (!runs.length) return;
    this.strokes.add(stroke);
    this.map.redraw();
    this.change(map, runs, "Paint").then((undo) => {
      setTimeout(() => this.strokes.delete(stroke) && this.map.redraw(), undo ? SHOWN : 0);
      if (undo?.length) this.keep(this.undos, { map, runs: undo });
      if (undo?.length) this.redos = [];
      this.changed();
    });
  }

  /** Undo the newest change in `from`, and add its inverse to `to`. */
  step(from, to, word) {
    const newest = from.pop();
    if (!newest) return;
    this.strokes.clear(); // the map shows the current state
    this.changed();
    this.change(newest.map, newest.runs, word).then((undo) => {
      if (undo?.length) this.keep(to, { map: newest.map, runs: undo });
      else if (undo) notify(`${word}: nothing to change, because others have painted over it.`);
      else this.keep(from, newest); // it failed, and can be tried again
      this.changed();
    });
  }

  keep(steps, step) {
    steps.push(step);
    if (steps.length > MOST_STEPS) steps.shift();
  }

  /** Paint runs after all pending changes; resolves to the runs that undo them, or null on failure. */
  change(map, runs, word) {
    if (this.waiting >= MOST_WAITING) {
      notify("The store is slow: wait until your strokes are saved.", { bad: true });
      return Promise.resolve(null);
    }
    this.waiting++;
    const done = this.work.then(() => this.send(map, runs, word)).finally(() => this.waiting--);
    this.work = done;
    return done;
  }

  async send(map, runs, word) {
    const undo = [];
    for (const part of parts(runs, MOST_RUNS, MOST_CELLS)) {
      try {
        const done = await this.socket.call("paint_flags", { map: map.name, size: [map.width, map.height], runs: part });
        undo.unshift(...done.undo);
      } catch (error) {
        notify(`${word} failed: ${error.message}`, { bad: true });
        return undo.length ? undo : null; // the part that succeeded can be undone
      }
    }
    return undo;
  }

  // -- drawing

  draw(context, view, color) {
    for (const stroke of [...this.strokes, this.stroke]) if (stroke) this.drawStroke(context, view, color, stroke);
  }

  drawStroke(context, view, color, { points, radius, flag }) {
    const cell = this.map.values.map?.resolution ?? 0;
    context.lineJoin = context.lineCap = "round";
    context.lineWidth = Math.max(2, Math.max(2 * radius, cell) * view.scale);
    context.strokeStyle = color[{ 1: "bad", 2: "held", 3: "area", 4: "ink" }[flag] ?? "floor"];
    context.globalAlpha = 0.55;
    context.beginPath();
    for (const [x, y] of points) context.lineTo(...view.to(x, y));
    if (points.length === 1) context.lineTo(...view.to(points[0][0] + 1e-6, points[0][1]));
    context.stroke();
    context.globalAlpha = 1;
  }
}

function step(label, key, path, pressed) {
  const made = button(undefined, pressed, { class: "step", "aria-label": label, title: `${label} (Ctrl+${key})`, "aria-keyshortcuts": `Control+${key}` });
  made.append(icon(path));
  return made;
}

function choice(label, options, chosen) {
  const made = el("select", { "aria-label": label, title: label },
    ...options.map(([text, value]) => el("option", { value: String(value), text })));
  made.value = String(chosen);
  return made;
}

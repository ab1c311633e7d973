// Drawing an area: each tap adds a corner, or one drag draws a rectangle.

import { button, write } from "../../lib/dom.js";
import { keep, LONGEST_NAME } from "../../lib/names.js";
import { question, notify } from "../../lib/messages.js";

const NEAR = 18; // px from the first corner within which a tap closes the area
const MOST = 500; // maximum number of corners, the console's limit

/** The editor of areas on a map; see `MapBlock.edit`. */
export class AreaEditor {
  constructor(map, socket) {
    this.map = map;
    this.socket = socket;
    this.corners = []; // [x, y] on the map
    this.drag = null; // the first and the newest corner of a rectangle, as pixels
    this.asks = false;
    this.dragged = false; // whether the corners were drawn as a rectangle
    this.finishButton = button("Finish", () => this.finish());
    this.backButton = button("Undo corner", () => this.back());
    this.controls = [this.finishButton, this.backButton];
    this.changed();
  }

  get hint() {
    const count = this.corners.length;
    if (!count) return "Tap the corners, or drag a rectangle.";
    return count < 3 ? "Tap the next corner." : "Tap the next corner, or the first to finish.";
  }

  changed() {
    this.finishButton.disabled = this.corners.length < 3;
    this.backButton.disabled = !this.corners.length;
    write(this.map.hint, this.hint);
    this.map.redraw();
  }

  // -- fingers

  press(px, py) {
    this.drag = [[px, py], [px, py]];
  }

  move(px, py) {
    this.drag[1] = [px, py];
    this.map.redraw();
  }

  let(px, py, far) {
    const [[ax, ay]] = this.drag;
    this.drag = null;
    if (far && !this.corners.length) {
      this.corners = [[ax, ay], [px, ay], [px, py], [ax, py]].map(([x, y]) => this.map.view.toMap(x, y));
      this.dragged = true;
      this.finish();
    } else {
      this.corner(px, py);
    }
  }

  forget() {
    this.drag = null;
    this.map.redraw();
  }

  key(event) {
    if (event.key === "Enter") this.corner(this.map.view.width / 2, this.map.view.height / 2);
    else if (event.key === "Backspace") this.back();
    else return false;
    return true;
  }

  corner(px, py) {
    const { corners, map } = this;
    if (this.asks) return;
    if (corners.length >= 3) {
      const [fx, fy] = map.view.to(...corners[0]);
      if (Math.hypot(fx - px, fy - py) < NEAR) {
        this.finish();
        return;
      }
    }
    if (corners.length >= MOST) notify(`An area has at most ${MOST} corners.`, { bad: true });
    else corners.push(map.view.toMap(px, py));
    this.changed();
  }

  back() {
    if (!this.asks) this.corners.pop();
    this.changed();
  }

  /** Ask for the name and save the area; if saving fails, the corners stay. */
  async finish() {
    if (this.asks || this.corners.length < 3) return;
    this.asks = true;
    this.changed();
    const points = this.corners.map(([x, y]) => [rounded(x), rounded(y)]);
    const answer = await question("Save this area", { name: { label: "Name", value: "", maxlength: LONGEST_NAME } }, "Save");
    const kept = answer && await keep(this.socket, this.map.values.places, "area", "keep_area", { name: answer.name, points }, `Saved the area ${answer.name}.`);
    this.asks = false;
    if (kept || (this.dragged && !answer)) this.corners = []; // a rectangle is discarded if the question is canceled
    this.dragged = false;
    this.changed();
  }

  // -- drawing

  draw(context, view, color) {
    const pixels = this.corners.map(([x, y]) => view.to(x, y));
    if (this.drag && !this.corners.length) {
      const [[ax, ay], [bx, by]] = this.drag;
      pixels.push([ax, ay], [bx, ay], [bx, by], [ax, by]);
    }
    if (!pixels.length) return;
    context.beginPath();
    for (const pixel of pixels) context.lineTo(...pixel);
    if (pixels.length > 2) context.closePath();
    context.fillStyle = color.area;
    context.globalAlpha = 0.15;
    context.fill();
    context.globalAlpha = 1;
    for (const [width, ink] of [[5, color.halo], [2, color.area]]) {
      context.lineWidth = width;
      context.strokeStyle = ink;
      context.stroke();
    }
    for (const [x, y] of pixels) {
      context.beginPath();
      context.arc(x, y, 5, 0, 2 * Math.PI);
      context.fillStyle = color.halo;
      context.fill();
      context.stroke();
    }
  }
}

const rounded = (meters) => Math.round(meters * 1000) / 1000;

// The map: its content, moving objects, and gestures.

import { button, el, icon, mark, write } from "../../lib/dom.js";
import { degrees, position } from "../../lib/format.js";
import { gestures } from "./gestures.js";
import { HitLayer, heightWords } from "./hitlayer.js";
import { Labels } from "./labels.js";
import { layerMenu } from "./layers.js";
import { drawRobotNames, drawRobots, seen } from "./robots.js";
import { MapImages } from "./mapimages.js";
import { isHere } from "../../lib/names.js";
import * as scene from "./scene.js";
import { Trail } from "./trail.js";
import { Viewport } from "./viewport.js";

const NEAR = 18; // px from a place within which a tap selects it
const NARROW = 560; // px; on a narrower map, the tools span the width, as in view.css
const ROOM = { top: 12, right: 68, bottom: 68, left: 12 }; // px at each edge that the controls cover
const NARROW_ROOM = { top: 64, right: 6, bottom: 108, left: 6 };
const LOW = 360; // px; a map that is less high extends below the controls
const LOW_ROOM = { top: 6, right: 6, bottom: 6, left: 6 };
const AIMED = 14; // px that a finger must move to set a heading

/**
 * The map in a block of the page.
 *
 * `tools`: {name: {label, hint, icon, done(pose)}}. A tool handles one press on the map; a drag sets the heading, and
 * without a drag `pose` has no `theta`. If a tool has `open()`, that is called instead. `menu(at, place, pixel, shape)`
 * is called when the operator touches the map at `at` ({x, y}); `place` is the name of the touched place, `shape`
 * ({kind, name}) the area or path there, if any. Feeds are followed between `show` and `hide`.
 */
export class MapBlock {
  constructor(socket, tools, menu) {
    this.socket = socket;
    this.tools = tools;
    this.menu = menu;
    this.view = new Viewport();
    this.values = {}; // newest value of each feed
    this.watches = {}; // feed -> function that stops watching it
    this.follows = false;
    this.placed = false; // whether the visible part has been fitted to a map or a robot
    this.tool = null;
    this.aim = null; // {x, y, theta} of the current press
    this.editor = null; // the editor that receives the gestures, see `edit`
    this.measured = [];
    this.point = null; // the point of the open menu
    this.dirty = false;
    this.frame = 0;
    this.shown = false;
    this.pointer = null; // the pixel under the pointer
    this.hits = new HitLayer();
    this.trail = new Trail();
    this.images = new MapImages(() => this.redraw());
    this.layers = layerMenu(() => this.layersChanged());
    this.build();
    this.themes();
    socket.addEventListener("frame", () => this.dirty && this.draw());
    socket.addEventListener("state", () => this.redraw());
  }

  build() {
    this.canvas = el("canvas", {
      tabindex: "0", role: "application", "aria-roledescription": "map",
      "aria-label": "Map. Arrow keys pan, plus and minus zoom, F follows the robot, Enter opens the menu at the center. With a tool or in edit mode, Enter acts as a press at the center.",
      on: { keydown: (event) => this.key(event) },
    });
    this.context = this.canvas.getContext("2d", { alpha: false });
    this.hint = el("p", { class: "hint", role: "status" });
    this.height = el("p", { class: "height", hidden: true });
    this.pose = el("p", { class: "pose", title: "Robot pose: x, y in meters, heading" });
    this.toolButtons = Object.entries(this.tools).map(([name, tool]) =>
      el("button", { type: "button", class: tool.drives ? "drives" : "", "aria-pressed": "false", title: tool.label,
        on: { click: () => (tool.open ? tool.open() : this.choose(this.tool === name ? null : name)) } }, icon(tool.icon), el("span", { text: tool.label })));
    this.followButton = round("Follow the robot", "M12 4v3M12 17v3M4 12h3M17 12h3M12 8a4 4 0 1 0 0 8a4 4 0 0 0 0-8z", () => this.follow(!this.follows));
    const corner = el("div", { class: "corner" },
      round("Zoom in", "M12 5v14M5 12h14", () => this.zoom(1.4)),
      round("Zoom out", "M5 12h14", () => this.zoom(1 / 1.4)),
      round("Show the whole map", "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5", () => this.fit()),
      this.followButton,
      this.layers.element);
    this.toolRow = el("div", { class: "tools", role: "toolbar", "aria-label": "Tools of the map" }, ...this.toolButtons);
    this.element = el("div", { class: "map" }, this.canvas, this.height, this.pose, this.hint, corner, this.toolRow);
    gestures(this.canvas, {
      aims: () => this.tool !== null || this.editor !== null,
      press: (x, y) => this.press(x, y),
      aim: (x, y) => this.turn(x, y),
      let: (x, y, far) => this.let(x, y, far),
      forget: () => this.forget(),
      pan: (dx, dy) => this.pan(dx, dy),
      zoom: (factor, x, y) => this.zoom(factor, x, y),
      tap: (x, y) => this.tap(x, y),
    });
    this.canvas.addEventListener("pointermove", (event) => this.pointed(event.pointerType === "touch" ? null : [event.offsetX, event.offsetY]));
    this.canvas.addEventListener("pointerleave", () => this.pointed(null));
    new ResizeObserver(() => this.sized()).observe(this.element);
  }

  // -- feeds

  show() {
    this.shown = true;
    this.layersChanged();
    this.sized();
  }

  hide() {
    this.shown = false;
    this.edit(null);
    this.layersChanged();
  }

  layersChanged() {
    const wanted = new Set(this.shown ? ["robot", "robots", "driving", "map", "maps"] : []);
    if (this.shown) for (const feed of this.layers.feeds()) wanted.add(feed);
    for (const [feed, end] of Object.entries(this.watches)) {
      if (wanted.has(feed)) continue;
      end();
      delete this.watches[feed];
      delete this.values[feed];
      if (feed === "layer") this.hits.take(null);
    }
    for (const feed of wanted) {
      this.watches[feed] ??= this.socket.watch(feed, (value, why) => this.take(feed, value, why));
    }
    this.images.show(this.values.map, this.layers.on("flags"), this.dark.matches);
    this.redraw();
  }

  take(feed, value, why) {
    this.values[feed] = value;
    this.redraw();
    if (feed === "layer") this.hits.take(value);
    if (feed === "robot") this.robotMoved(value, why);
    if (feed === "robot") this.trail.robot(value?.pose);
    if (feed === "driving") this.trail.driving(value);
    if (feed === "map") this.mapChanged(value, why);
    if (!this.placed && (feed === "map" || feed === "robot") && value) this.fit();
  }

  robotMoved(robot, why) {
    const pose = robot?.pose;
    write(this.pose, pose ? `${position(pose.x, pose.y)}  ${degrees(pose.theta)}` : why || "The robot's pose is unknown.");
    mark(this.pose, "data-why", pose ? null : "1");
    if (this.follows && pose) Object.assign(this.view, { x: pose.x, y: pose.y });
  }

  mapChanged(map, why) {
    if (map && this.mapName !== map.name && (this.mapName !== undefined || !this.moved)) this.placed = false;
    if (map) this.mapName = map.name;
    this.noMap = map ? "" : why || "No map.";
    this.images.show(this.values.map, this.layers.on("flags"), this.dark.matches);
    this.showHint();
  }

  themes() {
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.colors = scene.colors();
    this.dark.addEventListener("change", () => {
      this.colors = scene.colors();
      this.images.show(this.values.map, this.layers.on("flags"), this.dark.matches);
      this.redraw();
    });
  }

  // -- the window

  sized() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.ratio = Math.min(devicePixelRatio, 2);
    Object.assign(this.canvas, { width: Math.round(width * this.ratio), height: Math.round(height * this.ratio) });
    Object.assign(this.view, { width, height });
    if (!this.moved) this.placed = false; // the window still shows the whole map, and must be fitted again
    if (!this.placed && (this.values.map || this.values.robot)) this.fit();
    this.draw();
  }

  fit() {
    const { map, robot } = this.values;
    const { width, height } = this.view;
    if (map) this.view.fit(map, height < LOW ? LOW_ROOM : width < NARROW ? NARROW_ROOM : ROOM);
    else if (robot) Object.assign(this.view, { x: robot.pose.x, y: robot.pose.y, scale: 50 });
    this.placed = Boolean(map || robot);
    this.moved = false;
    if (this.follows) this.follow(false);
    this.redraw();
  }

  follow(on) {
    this.follows = on;
    this.followButton.setAttribute("aria-pressed", String(on));
    const pose = this.values.robot?.pose;
    if (!on || !pose) return;
    this.moved = true;
    Object.assign(this.view, { x: pose.x, y: pose.y });
    this.redraw();
  }

  /** Center the window on a place. */
  center(x, y) {
    this.follow(false);
    this.moved = this.placed = true;
    Object.assign(this.view, { x, y, scale: Math.max(this.view.scale, 40) });
    this.redraw();
  }

  pan(dx, dy) {
    if (this.follows) this.follow(false);
    this.moved = true;
    this.view.pan(dx, dy);
    this.redraw();
  }

  zoom(factor, x, y) {
    this.moved = true;
    if (this.follows) this.view.zoom(factor);
    else this.view.zoom(factor, x, y);
    this.redraw();
  }

  /** Set the pointer's pixel, or null; the height of an obstacle is shown next to it. */
  pointed(pixel) {
    this.pointer = pixel;
    if (this.values.layer) this.redraw();
  }

  /** The obstacle at a place as text; "" if there is none. */
  hitAt(x, y) {
    return heightWords(this.hits.at(x, y));
  }

  showHeight() {
    const cell = this.pointer && this.hits.at(...this.view.toMap(...this.pointer));
    this.height.hidden = !cell;
    if (!cell) return;
    write(this.height, heightWords(cell));
    const [x, y] = this.pointer;
    const { offsetWidth: width, offsetHeight: height } = this.height;
    const left = x + 14 + width > this.view.width ? x - 14 - width : x + 14;
    this.height.style.setProperty("left", `${Math.max(4, left)}px`);
    this.height.style.setProperty("top", `${Math.max(4, y - 12 - height)}px`);
    this.hits.mark(this.context, this.view, cell, this.colors);
  }

  // -- tools

  choose(name) {
    this.tool = name;
    this.forget();
    if (name !== "measure") this.measured = [];
    Object.keys(this.tools).forEach((each, i) => this.toolButtons[i].setAttribute("aria-pressed", String(each === name)));
    this.element.classList.toggle("aims", name !== null);
    this.showHint();
    this.redraw();
  }

  showHint() {
    write(this.hint, this.editor?.hint ?? (this.tool ? this.tools[this.tool].hint : this.noMap || ""));
  }

  /**
   * Pass gestures to an editor: {press(px, py), move(px, py), let(px, py, far), forget(), key(event) -> whether it
   * was handled, draw(context, view, color), hint}; null ends editing.
   */
  edit(editor) {
    this.choose(null);
    this.editor = editor;
    this.toolRow.hidden = editor !== null;
    this.element.classList.toggle("aims", editor !== null);
    this.showHint();
    this.redraw();
  }

  press(px, py) {
    if (this.editor) return this.editor.press(px, py);
    const [x, y] = this.view.toMap(px, py);
    this.aim = { x, y };
    this.pressed = [px, py];
    if (this.tool === "measure") this.measured = [this.aim];
    this.redraw();
  }

  turn(px, py) {
    if (this.editor) return this.editor.move(px, py);
    const [x, y] = this.view.toMap(px, py);
    if (this.tool === "measure") this.measured = [this.aim, { x, y }];
    else if (Math.hypot(px - this.pressed[0], py - this.pressed[1]) < AIMED) delete this.aim.theta;
    else this.aim.theta = Math.atan2(y - this.aim.y, x - this.aim.x);
    this.redraw();
  }

  let(px, py, far) {
    if (this.editor) return this.editor.let(px, py, far);
    this.turn(px, py);
    const [tool, pose] = [this.tool, this.aim];
    this.aim = null;
    if (tool !== "measure") this.choose(null); // a tool works once
    this.tools[tool].done(pose, this.measured);
  }

  forget() {
    this.editor?.forget();
    this.aim = null;
    this.redraw();
  }

  tap(px, py) {
    let [x, y] = this.view.toMap(px, py);
    const place = Object.entries(this.values.places?.locations ?? {}).find(([, each]) => {
      const [ex, ey] = this.view.to(each.x, each.y);
      return this.isHere(each) && Math.hypot(ex - px, ey - py) < NEAR;
    });
    if (place) ({ x, y } = place[1]);
    this.point = { x, y };
    this.redraw();
    this.menu({ x, y }, place?.[0] ?? null, this.view.to(x, y), this.shapeAt(x, y));
  }

  /** The area that contains a point, or the path at the point: {kind, name}; null if there is neither. */
  shapeAt(x, y) {
    const { areas, paths } = this.named(this.values);
    const [path] = paths.find(([, { points }]) => scene.distanceFrom(points, x, y) * this.view.scale < NEAR / 2) ?? [];
    if (path !== undefined) return { kind: "path", name: path };
    const [area] = areas.findLast(([, { points }]) => scene.inside(points, x, y)) ?? [];
    return area === undefined ? null : { kind: "area", name: area };
  }

  key(event) {
    const step = 60;
    const actions = {
      ArrowLeft: () => this.pan(step, 0), ArrowRight: () => this.pan(-step, 0),
      ArrowUp: () => this.pan(0, step), ArrowDown: () => this.pan(0, -step),
      "+": () => this.zoom(1.25), "=": () => this.zoom(1.25), "-": () => this.zoom(0.8),
      f: () => this.follow(!this.follows), F: () => this.follow(!this.follows),
      Enter: () => this.enter(this.view.width / 2, this.view.height / 2),
      Escape: () => this.choose(null),
    };
    if (this.editor?.key(event)) return event.preventDefault();
    if (!(event.key in actions) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    actions[event.key]();
  }

  /** Handle Enter as a press at the center; for a measurement it sets the first end, then the second. */
  enter(px, py) {
    const [x, y] = this.view.toMap(px, py);
    if (this.tool === "measure") this.measured = this.measured.length === 1 ? [this.measured[0], { x, y }] : [{ x, y }];
    else if (this.tool) {
      this.press(px, py);
      this.let(px, py, false);
    } else this.tap(px, py);
    this.redraw();
  }

  // -- drawing

  redraw() {
    this.dirty = true;
    this.frame ||= requestAnimationFrame(() => {
      this.frame = 0;
      if (this.dirty) this.draw(); // unless new values have already been drawn
    });
  }

  draw() {
    this.dirty = false;
    if (!this.shown || !this.canvas.width) return;
    const { context, view, values, colors: color, ratio } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = color.floor;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    if (values.map) this.images.draw(context, view, values.map, ratio);
    this.hits.draw(context, view, ratio, color.layer);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (!values.map) scene.drawGrid(context, view, color);
    const named = this.named(values);
    scene.drawPlaces(context, view, named, color);
    if (this.layers.on("path")) scene.drawTrail(context, view, this.trail.points, color);
    if (this.layers.on("path")) scene.drawPath(context, view, values.path?.points ?? [], values.robot?.pose, color);
    if (this.layers.on("obstacles") && values.obstacles) scene.drawObstacles(context, view, values.obstacles, color);
    if (this.layers.on("laser")) scene.drawLaser(context, view, values.laser?.points ?? [], color);
    const [labels, others] = [new Labels(context, view.width, color), seen(values.robots, color)];
    drawRobotNames(labels, view, others);
    scene.drawNames(labels, view, named, color);
    drawRobots(context, view, others, color, this.layers.on("path"), !this.socket.open);
    if (values.driving?.goal) scene.drawPose(context, view, values.driving.goal, color.path, color);
    if (values.robot?.pose) scene.drawRobot(context, view, values.robot, color, !this.socket.open);
    this.showHeight();
    this.editor?.draw(context, view, color);
    if ((this.editor || this.tool) && document.activeElement === this.canvas) scene.drawCross(context, view, color);
    if (this.measured.length === 1 && !this.aim) {
      const [x, y] = view.toMap(view.width / 2, view.height / 2);
      scene.drawMeasure(context, view, [this.measured[0], { x, y }], color);
    } else if (this.measured.length === 2) scene.drawMeasure(context, view, this.measured, color);
    else if (this.aim) scene.drawPose(context, view, this.aim, color.accent, color, 44);
    if (this.point) scene.drawPose(context, view, this.point, color.accent, color);
    scene.drawScale(context, view, color, view.width < NARROW ? 76 : 16);
  }

  isHere(each) {
    return isHere(this.socket, this.values.maps?.current, each);
  }

  /** Named objects on the current map whose layer is on. */
  named({ places }) {
    const here = (named, layer) => (this.layers.on(layer) ? Object.entries(named ?? {}) : []).filter(([, each]) => this.isHere(each));
    return {
      areas: here(places?.areas, "areas"), paths: here(places?.paths, "areas"), locations: here(places?.locations, "places"),
    };
  }
}

function round(label, path, pressed) {
  const made = button(undefined, pressed, { class: "round", "aria-label": label, title: label });
  made.append(icon(path));
  return made;
}

// The hub's daemons, their sides, and the connected machines, as a graph.

import { el, mark, svg } from "../../lib/dom.js";

const [WIDEST, HIGH, GAP, ROW] = [168, 48, 14, 92]; // pixels of a box, and between boxes
const LETTER = 7.4; // approximate width of a letter, pixels
const GOOD = new Set(["running", "ready", "up", "ok"]);

function short(text, wide) {
  const most = Math.floor(wide / LETTER);
  return text.length > most ? `${text.slice(0, most - 1)}…` : text;
}

/** The graph as {element, fill(status)}. `own`: the name of this console's daemon. */
export function networkGraph(own) {
  const drawing = svg("svg", { role: "img" });
  const element = el("div", { class: "graph" }, drawing);
  let [status, drawn] = [null, ""];
  new ResizeObserver(draw).observe(element);

  function draw() {
    const wide = Math.max(element.clientWidth, 200);
    const broad = Math.min(WIDEST, (wide - GAP) / 2); // at least two per row, because a single column would look like a chain
    if (status === null || !element.clientWidth) return;
    const parts = partsOf(status, own());
    const now = JSON.stringify([wide, parts]);
    if (now === drawn) return;
    drawn = now;
    const columns = Math.max(2, Math.floor((wide + GAP) / (broad + GAP)));
    const above = placed(parts.sides, columns, broad, wide, 0);
    const level = above.rows * ROW;
    const below = placed(parts.others, columns, broad, wide, level + ROW);
    const middle = { x: (wide - broad) / 2, y: level, broad, ...parts.own };
    const lines = [
      ...above.boxes.map(({ x, y }) => line(x + broad / 2, y + HIGH, wide / 2, level)),
      ...below.boxes.map(({ x, y }) => line(wide / 2, level + HIGH, x + broad / 2, y)),
    ];
    drawing.replaceChildren(...lines, ...[...above.boxes, middle, ...below.boxes].map(box));
    const high = below.boxes.length ? level + (1 + below.rows) * ROW - ROW + HIGH : level + HIGH;
    mark(drawing, "viewBox", `0 0 ${wide} ${high + 2}`);
    mark(drawing, "height", high + 2);
    mark(drawing, "aria-label", describe(parts));
  }

  return {
    element,
    fill(value) {
      status = value;
      draw();
    },
  };
}

/** The nodes of the graph: {own, sides, others}, each with {name, about, mood, kind}. */
function partsOf({ workers, machines }, own) {
  const sidesOf = (daemon) => workers.filter((each) => each.daemon === daemon && each.side);
  const mood = (states) => (states.every((state) => GOOD.has(state)) ? "calm" : "held");
  const daemons = [...new Set(workers.map(({ daemon }) => daemon))].filter((name) => name && name !== own).sort();
  const address = (name) => machines.find((each) => each.name === name)?.address ?? "";
  const strangers = machines.filter(({ name }) => !name || !daemons.includes(name));
  return {
    own: { name: own ?? "this daemon", about: "this hub", mood: "calm", kind: "daemon" },
    sides: sidesOf(own).map(({ side, state, text }) => ({ name: side, about: text && !GOOD.has(state) ? `${state}: ${text}` : state, mood: mood([state]), kind: "side" })),
    others: [
      ...daemons.map((name) => ({ name, about: [sidesOf(name).map(({ side }) => side).join(", "), address(name)].filter(Boolean).join(" · ") || "a daemon",
        mood: mood(workers.filter(({ daemon }) => daemon === name).map(({ state }) => state)), kind: "daemon" })),
      ...strangers.map(({ name, address: at, trusted }) => ({ name: name || "no certificate", about: `${at ?? ""}${trusted ? "" : " · watch only"}`, mood: "calm", kind: "machine" })),
    ],
  };
}

function placed(items, columns, broad, wide, top) {
  const rows = Math.ceil(items.length / columns);
  const boxes = items.map((item, i) => {
    const row = Math.floor(i / columns);
    const inRow = Math.min(columns, items.length - row * columns);
    const left = (wide - inRow * (broad + GAP) + GAP) / 2;
    return { ...item, broad, x: left + (i % columns) * (broad + GAP), y: top + row * ROW };
  });
  return { boxes, rows };
}

const line = (x1, y1, x2, y2) => svg("path", { class: "link", d: `M${x1} ${y1}C${x1} ${(y1 + y2) / 2} ${x2} ${(y1 + y2) / 2} ${x2} ${y2}` });

function box({ x, y, broad, name, about, mood, kind }) {
  return svg("g", { transform: `translate(${x} ${y})`, "data-kind": kind, "data-mood": mood },
    svg("title", { text: `${name}: ${about}` }),
    svg("rect", { x: 1, y: 1, width: broad - 2, height: HIGH - 2, rx: kind === "side" ? 22 : 6 }),
    svg("text", { x: broad / 2, y: 20, class: "name", text: short(name, broad - 34) }),
    svg("text", { x: broad / 2, y: 37, text: short(about, broad) }));
}

function describe({ own, sides, others }) {
  const list = (items) => items.map(({ name, about }) => `${name} (${about})`).join(", ") || "none";
  return `${own.name}. Its sides: ${list(sides)}. Other daemons and machines: ${list(others)}.`;
}

// The view Frames: the tree of /tf with the age of each frame, and the pose of one frame in another.

import { el, mark, rows, write } from "../../lib/dom.js";
import { rate, seconds } from "../../lib/format.js";
import { framePose } from "./framepose.js";
import { searchField } from "../../lib/table.js";

const OLD = 2; // seconds after which a moving frame is shown as outdated

/** Builds the view. */
export default function framesView(root, socket) {
  const body = el("tbody", { role: "rowgroup" });
  const empty = el("p", { class: "empty" });
  const number = el("span", { class: "count" });
  let [frames, search] = [null, ""];
  const head = ["Frame", "Age", "Rate"].map((text, i) => el("th", { scope: "col", role: "columnheader", class: i ? "num" : "wide", text }));
  const pose = framePose(socket);
  root.append(pose.element, el("section", { class: "block frames", "aria-labelledby": "frames-title" },
    el("div", { class: "heading" }, el("h2", { text: "Frames", id: "frames-title" }), number,
      searchField("Search frames", (text) => {
        search = text.trim().toLowerCase();
        show("");
      })),
    el("div", { class: "table" },
      el("table", { role: "table", "aria-label": "Frames" }, el("thead", { role: "rowgroup" }, el("tr", { role: "row" }, ...head)), body)),
    empty));

  function show(why) {
    const all = ordered(frames ?? []);
    const shown = search ? all.filter(({ frame }) => frame.name.toLowerCase().includes(search)) : all;
    rows(body, shown, ({ frame }) => frame.name, frameRow, fill);
    write(number, String(all.length));
    write(empty, shown.length ? "" : all.length ? "Nothing found." : why || "No frames.");
  }

  let end = null;
  return {
    show() {
      end = socket.watch("frames", (value, why) => {
        frames = value;
        show(why);
        pose.offer(ordered(value ?? []).map(({ frame }) => frame.name));
      });
      pose.show();
    },
    hide() {
      end();
      pose.hide();
    },
  };
}

/** The frames, each below its parent: [{frame, depth}]. Frames in loops, which are invalid, come last, as roots. */
export function ordered(frames) {
  const children = new Map();
  const names = new Set(frames.map(({ name }) => name));
  const known = [...frames];
  for (const { parent } of frames) {
    if (!parent || names.has(parent)) continue;
    names.add(parent); // a root is a parent, but has no transform itself
    known.push({ name: parent, parent: null, age: undefined, rate: null });
  }
  for (const frame of known) {
    const above = frame.parent || "";
    if (!children.has(above)) children.set(above, []);
    children.get(above).push(frame);
  }
  for (const each of children.values()) each.sort((a, b) => (a.name < b.name ? -1 : 1));
  const found = [];
  const seen = new Set();
  const under = (frame) => {
    const waiting = [{ frame, depth: 0 }];
    while (waiting.length) {
      const next = waiting.pop();
      if (seen.has(next.frame.name)) continue;
      seen.add(next.frame.name);
      found.push(next);
      const below = children.get(next.frame.name) ?? [];
      for (const child of [...below].reverse()) waiting.push({ frame: child, depth: next.depth + 1 });
    }
  };
  for (const root of children.get("") ?? []) under(root);
  for (const frame of known) under(frame);
  return found;
}

function frameRow({ frame }) {
  const [name, parent] = [el("span", { class: "first", text: frame.name }), el("span", { class: "hidden" })];
  const quarrel = el("p", { class: "quarrel" });
  const cell = el("th", { scope: "row", role: "rowheader", class: "wide" }, name, parent, quarrel);
  const [age, often] = [el("td", { role: "cell", class: "num" }), el("td", { role: "cell", class: "num" })];
  return Object.assign(el("tr", { role: "row" }, cell, age, often), { parts: { cell, parent, quarrel, age, often } });
}

function fill({ parts }, { frame, depth }) {
  parts.cell.style.setProperty("--depth", Math.min(depth, 12));
  const several = frame.parents?.length > 1;
  write(parts.parent, frame.parent ? `, below ${frame.parent}` : "");
  write(parts.quarrel, several ? `Conflicting parents: ${frame.parents.join(", ")}` : "");
  write(parts.age, frame.age === undefined ? "" : frame.age === null ? "static" : seconds(frame.age));
  write(parts.often, frame.age === null || frame.age === undefined ? "" : rate(frame.rate));
  mark(parts.age, "data-mood", frame.age > OLD ? "bad" : frame.age === null ? "quiet" : "calm");
}

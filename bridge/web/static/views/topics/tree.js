// A message as a tree: branches stay open while values change, and numbers can be drawn as curves.

import { button, el, icon, mark, rows, write } from "../../lib/dom.js";
import { number } from "../../lib/format.js";

const CUT = "..."; // {"...": 360} stands for the omitted elements of a long array
const JOIN = "\n"; // separates the keys of a path; no key of a message contains it
const DEEP = 3; // number of levels that are open at first
const FEW = 12; // maximum number of children of a branch that is open at first

const isBranch = (value) => value !== null && typeof value === "object";
const isCut = (value) => isBranch(value) && !Array.isArray(value) && Object.keys(value).length === 1 && CUT in value;

/** `opened`: Map path -> boolean, kept by the caller; `drawn(path)`: whether a number has a curve; `pick(path)`. */
export class Tree {
  constructor(opened, drawn, pick) {
    this.opened = opened;
    this.drawn = drawn;
    this.pick = pick;
    this.element = el("ul", { class: "tree" });
  }

  /** Show a message. */
  fill(message) {
    this.branch(this.element, message, "", 0);
  }

  branch(list, value, path, depth) {
    const items = Object.entries(value).map(([key, child]) => ({ key, child, path: path + JOIN + key, list: Array.isArray(value) }));
    const kind = ({ child }) => (isCut(child) ? "cut" : isBranch(child) ? "branch" : typeof child === "number" ? "number" : "leaf");
    rows(list, items, (item) => `${kind(item)} ${item.key}`, (item) => this[`${kind(item)}Row`](item, depth),
      (row, item) => row.update(item));
  }

  isOpen(path, child, depth) {
    return this.opened.get(path) ?? (depth < DEEP && Object.keys(child).length <= FEW);
  }

  branchRow({ key, path }, depth) {
    const brief = el("span", { class: "brief" });
    const list = el("ul");
    let last = null;
    const opener = button(undefined, () => {
      this.opened.set(path, !this.isOpen(path, last, depth));
      row.update({ child: last });
    }, { class: "opener" });
    opener.append(icon("M9 6l6 6-6 6"), el("span", { class: "key", text: key }), brief);
    const row = el("li", {}, opener, list);
    row.update = ({ child }) => {
      last = child;
      const open = this.isOpen(path, child, depth);
      mark(opener, "aria-expanded", String(open));
      mark(list, "hidden", open ? null : "");
      write(brief, open && Object.keys(child).length ? "" : inBrief(child));
      if (open) this.branch(list, child, path, depth + 1);
    };
    return row;
  }

  numberRow({ key, path }) {
    const value = button("", () => {
      this.pick(path);
      mark(value, "aria-pressed", String(this.drawn(path)));
    }, { class: "value number", title: "Draw a curve" });
    const row = el("li", { class: "leaf" }, el("span", { class: "key", text: key }), value);
    row.update = ({ child }) => {
      write(value, number(child));
      mark(value, "aria-pressed", String(this.drawn(path)));
      mark(value, "aria-label", `${key}: ${number(child)}, draw a curve`);
    };
    return row;
  }

  leafRow({ key }) {
    const value = el("span", { class: "value" });
    const row = el("li", { class: "leaf" }, el("span", { class: "key", text: key }), value);
    row.update = ({ child }) => write(value, child === null ? "none" : String(child));
    return row;
  }

  cutRow() {
    const row = el("li", { class: "leaf cut" });
    row.update = ({ child }) => write(row, `… ${child[CUT]} in all`);
    return row;
  }
}

function inBrief(value) {
  if (!Array.isArray(value)) return Object.keys(value).length === 0 ? "empty" : Object.keys(value).slice(0, 4).join(", ") + (Object.keys(value).length > 4 ? " …" : "");
  const cut = value.find(isCut);
  const length = cut ? cut[CUT] : value.length;
  return `${length} ${length === 1 ? "item" : "items"}`;
}

/** The number at a path of a message, or undefined. */
export function at(message, path) {
  let value = message;
  for (const key of path.split(JOIN).slice(1)) value = isBranch(value) ? value[key] : undefined;
  return value;
}

/** A path in dot notation. */
export const pathWords = (path) => path.split(JOIN).slice(1).join(".");

// Tables with stable rows and changing values, sortable by column, searchable by words.

import { button, el, rows, write } from "./dom.js";

const MAX_ROWS = 400; // further rows can be found by a search

/**
 * A table. `key(item)` identifies a row. Each of the `columns` has a `label` and either `text(item)` or
 * `made(item)`. `made` is called once per row and returns {element, update(item)}; `update` is called on each update.
 * Optional: `class`, `title(item)`, `mood(item)`, `head` for the rows' headings, `value(item)` to sort by.
 */
export class Table {
  constructor(label, columns, key) {
    this.columns = columns;
    this.key = key;
    this.sorted = null; // {column, down}
    this.search = "";
    this.items = [];
    this.sight = new IntersectionObserver((changes) => changes.forEach(({ target, isIntersecting }) => {
      target.outOfSight = !isIntersecting;
      if (isIntersecting) this.update(target, target.item);
    }), { rootMargin: "200px" });
    this.head = el("tr", { role: "row" }, ...columns.map((column) => this.heading(column)));
    this.body = el("tbody", { role: "rowgroup" });
    this.more = el("p", { class: "empty" });
    this.element = el("div", { class: "table" },
      el("table", { class: "rows", role: "table", "aria-label": label }, el("thead", { role: "rowgroup" }, this.head), this.body),
      this.more);
  }

  heading(column) {
    const cell = el("th", { scope: "col", role: "columnheader", class: column.class });
    if (column.value) cell.append(button(column.label, () => this.sort(column)));
    else cell.textContent = column.label;
    return cell;
  }

  sort(column) {
    const again = this.sorted?.column === column;
    this.sorted = again && this.sorted.down === Boolean(column.down) ? { column, down: !column.down } : { column, down: Boolean(column.down) };
    this.columns.forEach((each, i) => {
      const cell = this.head.children[i];
      if (each === column) cell.setAttribute("aria-sort", this.sorted.down ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    });
    this.fill(this.items);
  }

  /** Show the rows that contain all words; an item's words are the texts of its columns. */
  find(search) {
    this.search = search.trim().toLowerCase();
    this.fill(this.items);
  }

  /** Show items; `empty`: the text if there are none. */
  fill(items, empty = this.empty ?? "") {
    this.items = items;
    this.empty = empty;
    const words = this.search.split(/\s+/).filter(Boolean);
    const found = words.length ? items.filter((item) => {
      const text = this.columns.map((column) => column.text?.(item) ?? "").join(" ").toLowerCase();
      return words.every((word) => text.includes(word));
    }) : [...items];
    if (this.sorted) found.sort(this.order());
    const shown = found.slice(0, MAX_ROWS);
    rows(this.body, shown, this.key, (item) => this.row(item), (row, item) => {
      row.item = item;
      if (!row.outOfSight) this.update(row, item); // only visible rows are updated
    });
    const left = found.length - shown.length;
    write(this.more, left ? `${left} more. Search to see them.` : found.length ? "" : items.length ? "Nothing found." : empty);
    return found.length;
  }

  order() {
    const { column, down } = this.sorted;
    const sign = down ? -1 : 1;
    return (a, b) => {
      const [x, y] = [column.value(a), column.value(b)];
      if (x === y) return this.key(a) < this.key(b) ? -1 : 1;
      if (x === null || x === undefined) return 1;
      if (y === null || y === undefined) return -1;
      return x < y ? -sign : sign;
    };
  }

  row(item) {
    const row = el("tr", { role: "row" });
    row.parts = this.columns.map((column) => {
      const cell = el(column.head ? "th" : "td", { class: column.class, role: column.head ? "rowheader" : "cell", scope: column.head ? "row" : null, "data-label": column.label });
      const part = column.made?.(item);
      if (part) cell.append(part.element);
      row.append(cell);
      return part ?? cell;
    });
    this.sight.observe(row);
    return row;
  }

  update(row, item) {
    this.columns.forEach((column, i) => {
      const part = row.parts[i];
      if (column.made) part.update(item);
      else {
        write(part, column.text(item));
        if (column.title) part.title = column.title(item);
      }
      if (column.mood) row.children[i].dataset.mood = column.mood(item);
    });
  }
}

/** A search field; calls `changed(text)`. */
export function searchField(label, changed) {
  return el("input", { type: "search", placeholder: label, "aria-label": label, autocomplete: "off", spellcheck: "false",
    on: { input: (event) => changed(event.target.value) } });
}

/** Two lines in one cell: the first may break anywhere. */
export function twoLines(upper, lower) {
  const [first, second] = [el("span", { class: "first" }), el("span", { class: "second" })];
  return {
    element: el("div", { class: "two" }, first, second),
    update(item) {
      write(first, upper(item));
      write(second, lower(item));
    },
  };
}

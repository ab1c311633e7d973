// The live log of the daemon and its workers. The console filters it, so that no matching line is missed.

import { button, el, mark, write } from "../../lib/dom.js";
import { clock } from "../../lib/format.js";
import { searchField } from "../../lib/table.js";

const MOST = 1000; // maximum number of lines that are shown
const PATIENCE = 250; // ms without a key press until the search starts
const LEVELS = [["debug", "All levels"], ["info", "Info and above"], ["warning", "Warnings and errors"], ["error", "Errors"]];

/** Builds the part: {element, show(), hide()}. */
export function logPart(socket) {
  const list = el("ol", { class: "log", tabindex: "0", "aria-label": "Log lines", on: { scroll: scrolled } });
  const empty = el("p", { class: "empty" });
  const newer = button("Newest ↓", () => follow(true), { class: "newest" });
  const level = el("select", { "aria-label": "Level", on: { change: anew } },
    ...LEVELS.map(([value, text]) => el("option", { value, text })));
  const worker = el("select", { "aria-label": "Worker", on: { change: anew } }, el("option", { value: "", text: "All workers" }));
  let [wait, words] = [0, ""];
  const search = searchField("Search the log", (text) => {
    clearTimeout(wait);
    words = text.trim();
    wait = setTimeout(anew, PATIENCE);
  });
  const element = el("section", { class: "block logs", "aria-label": "Log" },
    el("div", { class: "heading" }, level, worker, search), list, empty, newer);
  let [last, wanted, round, busy, bound, end] = [0, 0, 0, false, true, () => {}];

  function anew() {
    [last, round] = [0, round + 1];
    list.replaceChildren();
    follow(true);
    read();
  }

  async function read() {
    if (busy) return;
    busy = true;
    const mine = round;
    let failed = false;
    try {
      const found = await socket.call("log", { after: last, level: level.value, worker: worker.value, text: words });
      if (mine === round) take(found);
    } catch (error) {
      failed = true; // the feed's next value tries again; without a connection, calls fail at once
      if (mine === round) write(empty, error.message);
    } finally {
      busy = false;
    }
    if (mine !== round || (!failed && last < wanted)) read();
  }

  function take({ last: newest, lines }) {
    last = wanted = Math.max(newest, 0);
    list.append(...lines.map(row));
    while (list.childElementCount > MOST) list.firstElementChild.remove();
    write(empty, list.childElementCount ? "" : "No matching lines.");
    if (bound) follow(true);
  }

  function row({ time, level: how, worker: who, text }) {
    return el("li", { "data-level": how }, el("time", { text: clock(time), title: new Date(time * 1000).toLocaleString() }),
      el("span", { class: "worker", text: who }), el("span", { class: "hidden", text: ` ${how}: ` }), el("span", { class: "text", text }));
  }

  function scrolled() {
    bound = list.scrollHeight - list.scrollTop - list.clientHeight < 40;
    mark(newer, "hidden", bound ? "" : null);
  }

  function follow(on) {
    bound = on;
    list.scrollTop = list.scrollHeight;
    mark(newer, "hidden", "");
  }

  function offer(names) {
    const old = worker.value;
    const values = ["", ...names];
    if (values.length === worker.options.length && values.every((name, i) => worker.options[i].value === name)) return;
    if (old && !values.includes(old)) values.push(old);
    worker.replaceChildren(...values.map((name) => el("option", { value: name, text: name || "All workers", selected: name === old })));
  }

  return {
    element,
    show() {
      if (socket.open) anew();
      end = socket.watch("log", (value, why) => {
        if (value === null) return write(empty, why || "Waiting for the log.");
        offer(value.workers);
        if (value.last < last) return anew(); // the daemon was restarted
        wanted = value.last;
        if (wanted > last || !list.childElementCount) read();
      });
    },
    hide() {
      end();
      clearTimeout(wait);
      round++;
    },
  };
}

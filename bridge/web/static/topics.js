// The view Topics: the list, and one topic with its newest message.

import { button, el, mark, rows, write } from "./dom.js";
import { Chart, Series } from "./curve.js";
import { number, rate } from "./format.js";
import { pictureBlock, PICTURES } from "./picture.js";
import { searchField } from "./table.js";
import { at, pathWords, Tree } from "./tree.js";

const MOST_CURVES = 6;
const MOST_TOPICS = 500;

/** Builds the view; `look` takes the name of a topic. */
export function topicsView(root, socket) {
  const list = el("ul", { class: "topic-list" });
  const empty = el("p", { class: "empty" });
  let [topics, search, chosen] = [null, "", ""];
  const topic = topicBlock(socket);
  const showList = (why) => {
    const words = search.toLowerCase().split(/\s+/).filter(Boolean);
    const found = (topics ?? []).filter((each) => words.every((word) => `${each.topic} ${each.type}`.toLowerCase().includes(word)));
    const often = new Map(); // how many types a name has
    for (const { topic: name } of topics ?? []) often.set(name, (often.get(name) ?? 0) + 1);
    rows(list, found.slice(0, MOST_TOPICS), (each) => `${each.topic} ${each.type}`, topicRow, ({ parts }, each) => {
      const name = often.get(each.topic) > 1 ? `${each.topic}@${each.type}` : each.topic;
      write(parts.type, each.type);
      write(parts.sides, `${ends(each.publishers)} → ${ends(each.subscribers)}`);
      mark(parts.link, "href", `#topics/${encodeURIComponent(name)}`);
      mark(parts.link, "aria-current", name === chosen ? "true" : null);
    });
    const left = found.length - MOST_TOPICS;
    write(empty, left > 0 ? `${left} more: search to see them.` : found.length ? "" : topics?.length ? "Nothing found." : why || "No topics.");
  };
  const field = searchField("Search topics", (text) => {
    search = text;
    showList();
  });
  root.append(
    el("div", { class: "block topics" }, el("div", { class: "heading" }, el("h2", { text: "Topics" }), field), list, empty),
    topic.element,
  );
  let end = null;
  return {
    show() {
      end = socket.watch("topics", (value, why) => {
        topics = value;
        showList(why);
      });
    },
    look(name) {
      chosen = name;
      root.dataset.topic = name ? "one" : "none";
      showList("");
      topic.choose(name);
    },
    hide() {
      end();
      topic.choose("");
    },
  };
}

/** How many ends: a number, or a list of names. */
const ends = (value) => (Array.isArray(value) ? value.length : (value ?? "–"));

function topicRow({ topic }) {
  const [type, sides] = [el("span", { class: "second" }), el("span", { class: "ends", title: "Publishers → subscribers" })];
  const link = el("a", {}, el("span", { class: "first", text: topic }), type, sides);
  return Object.assign(el("li", {}, link), { parts: { type, sides, link } });
}

/** One topic: {element, choose(name)}; the empty name closes it. */
function topicBlock(socket) {
  const title = el("h2");
  const type = el("p", { class: "second" });
  const often = el("span", { class: "figure" });
  const why = el("p", { class: "empty" });
  const charts = el("div", { class: "charts" });
  const crossing = el("ul", { class: "crossing" });
  const body = el("div", { class: "message" });
  const opened = new Map(); // topic -> Map path -> whether its branch is open
  const curves = new Map(); // path -> {series, chart, row}
  const picture = pictureBlock(socket);
  let [topic, tree, newest, end] = ["", null, null, () => {}];

  function pick(path) {
    if (curves.has(path)) return drop(path);
    if (curves.size >= MOST_CURVES) drop(curves.keys().next().value);
    const words = pathWords(path);
    const chart = new Chart(`Curve of ${words}`, number);
    const figures = ["least", "most", "now"].map((name) => el("dd", { class: name }));
    const row = el("figure", { class: "chart" },
      el("figcaption", {}, el("span", { text: words }), button("×", () => drop(path), { class: "close", "aria-label": `Close the curve of ${words}` })),
      chart.plot,
      el("dl", {}, el("dt", { text: "least" }), figures[0], el("dt", { text: "most" }), figures[1], el("dt", { text: "now" }), figures[2]));
    charts.append(row);
    curves.set(path, { series: new Series(), chart, row, figures });
    plot(newest);
  }

  function drop(path) {
    curves.get(path)?.row.remove();
    curves.delete(path);
    if (newest) tree.fill(newest);
  }

  function plot(message) {
    for (const [path, { series, chart, figures }] of curves) {
      series.add(at(message, path));
      chart.draw(series).forEach((text, i) => write(figures[i], text));
    }
  }

  async function explain() {
    const name = topic;
    let found;
    try {
      found = await socket.call("explain", { name: name.split("@")[0] });
    } catch (error) {
      found = [{ side: "", decision: "Not known", why: error.message, cure: "" }];
    }
    if (name !== topic) return; // another one was chosen meanwhile
    crossing.replaceChildren(...found.map((each) => el("li", {},
      el("p", {}, el("strong", { text: each.side }), ` ${each.decision}`),
      each.why ? el("p", { class: "reason", text: each.why }) : null,
      each.cure ? el("code", { text: each.cure }) : null)));
  }

  const element = el("section", { class: "block topic", "aria-label": "Topic", hidden: true },
    el("div", { class: "heading" },
      el("a", { href: "#topics", class: "back", text: "All topics" }), title, often,
      button("Why does it cross?", explain, { class: "why" })),
    type, crossing, why, picture.element, charts, body);
  return {
    element,
    choose(name) {
      if (name === topic) return;
      end();
      end = () => {};
      topic = name;
      newest = null;
      for (const path of [...curves.keys()]) drop(path);
      crossing.replaceChildren();
      body.replaceChildren();
      picture.close();
      element.hidden = !name;
      write(title, name.split("@")[0]);
      write(type, "");
      write(often, "");
      if (!name) return;
      write(why, "Waiting for a message.");
      if (!opened.has(name)) opened.set(name, new Map());
      tree = new Tree(opened.get(name), (path) => curves.has(path), pick);
      body.append(tree.element);
      end = socket.watch(`topic:${name}`, (value, reason) => {
        write(why, value ? "" : reason || "Waiting for a message.");
        newest = value?.message ?? null;
        if (!value) return;
        write(type, value.type);
        if (PICTURES.has(value.type)) picture.open(name);
        write(often, rate(value.rate));
        tree.fill(value.message);
        plot(value.message);
      });
    },
  };
}

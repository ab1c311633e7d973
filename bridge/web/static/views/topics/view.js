// The view Topics: the lists of topics and services, and one topic with its newest message.

import { explained } from "../../lib/cure.js";
import { button, el, mark, rows, write } from "../../lib/dom.js";
import { Chart, Series } from "../../lib/curve.js";
import { number, rate } from "../../lib/format.js";
import { opener, sendBlock } from "./form.js";
import { pictureBlock, PICTURES } from "./picture.js";
import { notify } from "../../lib/messages.js";
import { serviceBlock } from "./services.js";
import { searchField } from "../../lib/table.js";
import { at, pathWords, Tree } from "./tree.js";

const MOST_CURVES = 6;
const MOST_TOPICS = 500;

/** Builds the view; `navigate` takes the name of a topic, "services" or "service:" and the name of a service. */
export default function topicsView(root, socket) {
  const topic = topicBlock(socket, (name) => topics.typesOf(name)[0]);
  const service = serviceBlock(socket);
  const topics = namesList(socket, "topics", "Topics", ({ topic: name }) => name, (name) => `#topics/${encodeURIComponent(name)}`,
    (each) => [`${ends(each.publishers)} → ${ends(each.subscribers)}`, "Publishers → subscribers"]);
  const services = namesList(socket, "services", "Services", ({ service: name }) => name, (name) => `#topics/${encodeURIComponent(`service:${name}`)}`,
    (each) => [each.servers ? "" : "no server", "Servers"], true);
  root.append(topics.element, services.element, topic.element, service.element);
  let list = null;
  return {
    show() {},
    navigate(name) {
      const isService = name === "services" || name.startsWith("service:");
      const wanted = isService ? services : topics;
      if (list !== wanted) {
        list?.hide();
        list = wanted;
        list.show();
      }
      const chosen = name === "services" ? "" : name.replace(/^service:/, "");
      root.dataset.topic = chosen ? "one" : "none";
      list.choose(chosen);
      topic.choose(isService ? "" : chosen);
      service.choose(isService ? chosen : "");
    },
    hide() {
      list?.hide();
      list = null;
      topic.choose("");
      service.choose("");
    },
  };
}

/**
 * The list of topics or of services: {element, show(), hide(), choose(name), typesOf(name)}. `always`: links
 * always contain the type; otherwise they do only if the name has several types.
 */
function namesList(socket, feed, title, nameOf, href, about, always = false) {
  const list = el("ul", { class: "topic-list" });
  const empty = el("p", { class: "empty" });
  let [items, search, chosen, end] = [null, "", "", () => {}];
  const typesOf = (name) => (items ?? []).filter((each) => nameOf(each) === name).map(({ type }) => type);
  const fill = (why) => {
    const words = search.toLowerCase().split(/\s+/).filter(Boolean);
    const found = (items ?? []).filter((each) => words.every((word) => `${nameOf(each)} ${each.type}`.toLowerCase().includes(word)));
    const often = new Map(); // name -> its number of types
    for (const each of items ?? []) often.set(nameOf(each), (often.get(nameOf(each)) ?? 0) + 1);
    rows(list, found.slice(0, MOST_TOPICS), (each) => `${nameOf(each)} ${each.type}`, (each) => nameRow(nameOf(each)), ({ parts }, each) => {
      const full = always || often.get(nameOf(each)) > 1 ? `${nameOf(each)}@${each.type}` : nameOf(each);
      const [text, meaning] = about(each);
      write(parts.type, each.type);
      write(parts.ends, text);
      mark(parts.ends, "title", meaning);
      mark(parts.link, "href", href(full));
      mark(parts.link, "aria-current", full === chosen ? "true" : null);
    });
    const left = found.length - MOST_TOPICS;
    write(empty, left > 0 ? `${left} more. Search to see them.` : found.length ? "" : items?.length ? "Nothing found." : why || `No ${feed}.`);
  };
  const field = searchField(`Search ${feed}`, (text) => {
    search = text;
    fill("");
  });
  const tabs = [["Topics", "#topics"], ["Services", "#topics/services"]].map(([text, to]) => el("a", { href: to, text, "aria-current": text === title ? "true" : null }));
  const element = el("div", { class: "block topics", hidden: true },
    el("div", { class: "heading" }, el("nav", { class: "parts", "aria-label": "Topics or services" }, ...tabs), field), list, empty);
  return {
    element,
    typesOf,
    show() {
      element.hidden = false;
      end = socket.watch(feed, (value, why) => {
        items = value;
        fill(why);
      });
    },
    hide() {
      end();
      element.hidden = true;
    },
    choose(name) {
      chosen = name;
      fill("");
    },
  };
}

/** The number of endpoints, which are given as a number or a list of names. */
const ends = (value) => (Array.isArray(value) ? value.length : (value ?? "–"));

function nameRow(name) {
  const [type, sides] = [el("span", { class: "second" }), el("span", { class: "ends" })];
  const link = el("a", {}, el("span", { class: "first", text: name }), type, sides);
  return Object.assign(el("li", {}, link), { parts: { type, ends: sides, link } });
}

/** One topic: {element, choose(name)}; the empty name closes it. `typeOf(name)`: its type if it has no publisher. */
function topicBlock(socket, typeOf) {
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
  const block = sendBlock("Publish once", (message) => socket.call("publish", { topic: topic.split("@")[0], type: shownType(), message }));
  const form = opener("Publish …", socket, block, () => ({ type: shownType() }), (reason) => notify(reason, { bad: true }));
  const shownType = () => topic.split("@")[1] ?? (type.textContent || typeOf(topic) || "");
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
      found = [{ side: "", decision: "Unknown", why: error.message, cure: "", users: [] }];
    }
    if (name !== topic) return; // another topic was chosen meanwhile
    crossing.replaceChildren(...explained(name.split("@")[0], found));
  }

  const element = el("section", { class: "block topic", "aria-label": "Topic", hidden: true },
    el("div", { class: "heading" },
      el("a", { href: "#topics", class: "back", text: "All topics" }), title, often,
      form.element, button("Explain", explain, { class: "why" })),
    type, block.element, crossing, why, picture.element, charts, body);
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
      form.close();
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
        if (!value) {
          write(often, "");
          return;
        }
        write(type, value.type);
        if (PICTURES.has(value.type)) picture.open(name);
        write(often, rate(value.rate));
        tree.fill(value.message);
        plot(value.message);
      });
    },
  };
}

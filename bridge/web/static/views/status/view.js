// The view Status: workers, refused topics with their cures, and every route.

import { cureLine, explained } from "../../lib/cure.js";
import { button, el, mark, rows, write } from "../../lib/dom.js";
import { bytes, count, percent, rate, seconds } from "../../lib/format.js";
import { Series, Spark } from "../../lib/curve.js";
import { networkGraph } from "./network.js";
import { searchField, Table, twoLines } from "../../lib/table.js";

const GOOD = new Set(["running", "ready", "up", "ok"]);

const routeKey = (route) => JSON.stringify([route.daemon, route.side, route.direction, route.topic, route.type]);
const workerKey = (worker) => JSON.stringify([worker.daemon, worker.worker]);

/** Builds the view. */
export default function statusView(root, socket) {
  const curves = new Map(); // route -> its rates of the last minute
  const workers = workerTable();
  const routes = routeTable(curves);
  const refused = refusedList(socket);
  const found = el("span", { class: "count" });
  const search = searchField("Search routes", (text) => {
    routes.find(text);
    showCount();
  });
  let last = null;
  const showCount = () => {
    const shown = routes.body.childElementCount;
    const all = last?.routes.length ?? 0;
    write(found, shown === all ? String(all) : `${shown} of ${all}`);
  };
  const why = el("p", { class: "empty" });
  const network = networkGraph(() => socket.hello?.daemon);
  const endpoints = endpointList();
  root.append(
    why,
    refused.element,
    endpoints.element,
    block("Network", "network", network.element),
    block("Workers", "workers", workers.element),
    block("Routes", "routes", routes.element, found, search),
  );
  let end = null;
  return {
    show() {
      end = socket.watch("status", (status, reason) => {
        last = status;
        write(why, status ? "" : reason || "Waiting for the status.");
        if (status === null) return;
        remember(curves, status.routes);
        workers.fill(status.workers, "No workers.");
        routes.fill(status.routes, "No routes.");
        refused.fill(status.refused);
        network.fill(status);
        endpoints.fill(status.endpoints);
        showCount();
      });
    },
    hide() {
      end();
    },
  };
}

function block(title, id, content, ...beside) {
  return el("section", { class: `block ${id}`, "aria-labelledby": `${id}-title` },
    el("div", { class: "heading" }, el("h2", { text: title, id: `${id}-title` }), ...beside), content);
}

/** Add each route's rate to its curve; curves of removed routes are deleted. */
function remember(curves, routes) {
  const gone = new Set(curves.keys());
  for (const route of routes) {
    const key = routeKey(route);
    gone.delete(key);
    if (!curves.has(key)) curves.set(key, new Series());
    curves.get(key).add(route.rate);
  }
  for (const key of gone) curves.delete(key);
}

function workerTable() {
  const name = (worker) => worker.worker;
  return new Table("Workers", [
    { label: "Worker", class: "wide", head: true, value: name, text: (w) => `${w.worker} ${w.daemon}`,
      made: () => twoLines(name, (worker) => worker.daemon) },
    { label: "State", class: "state", value: (w) => w.state, text: (w) => `${w.state} ${w.text}`,
      mood: (w) => (GOOD.has(w.state) ? "calm" : "bad"), made: () => twoLines((w) => w.state, (w) => w.text) },
    { label: "Processor", class: "num", down: true, value: (w) => w.cpu, text: (w) => percent(w.cpu) },
    { label: "Memory", class: "num", down: true, value: (w) => w.rss, text: (w) => bytes(w.rss) },
    { label: "Restarts", class: "num", down: true, value: (w) => w.restarts, text: (w) => count(w.restarts),
      mood: (w) => (w.restarts ? "held" : "calm") },
  ], workerKey);
}

function routeTable(curves) {
  return new Table("Routes", [
    { label: "Topic", class: "wide", head: true, value: (r) => r.topic, text: (r) => `${r.topic} ${r.type}`,
      made: () => topicLines() },
    { label: "Direction", class: "short", value: (r) => `${r.side} ${r.direction}`, text: (r) => `${r.side} ${r.direction} ${r.daemon}`,
      made: () => twoLines((r) => `${r.side} ${r.direction}`, (r) => r.daemon) },
    { label: "Rate", class: "num", down: true, value: (r) => r.rate, text: (r) => rate(r.rate) },
    { label: "Last minute", class: "curve", made: (item) => {
      const spark = new Spark("Rate of the last minute");
      return { element: spark.element, update: () => spark.draw(curves.get(routeKey(item)) ?? new Series()) };
    } },
    { label: "Bytes/s", class: "num", down: true, value: (r) => r.bytes_per_second, text: (r) => bytes(r.bytes_per_second) },
    { label: "Dropped", class: "num", down: true, value: (r) => r.dropped, text: (r) => `${count(r.dropped)} ${reasons(r)}`,
      mood: (r) => (r.dropped ? "held" : "calm"), made: () => twoLines((r) => count(r.dropped), reasons) },
    { label: "Latency", class: "num", down: true, value: (r) => r.latency, text: (r) => seconds(r.latency) },
    { label: "Transport", class: "short", value: (r) => r.way ?? "", text: (r) => `${r.way ?? ""} ${r.why ?? ""}`,
      made: () => twoLines((r) => TRANSPORTS[r.way] ?? "", (r) => (r.way === "lane" ? "" : r.why ?? "")) },
  ], routeKey);
}

/** Transports between the workers. */
const TRANSPORTS = { lane: "lane", zenoh: "zenoh", both: "lane, zenoh" };

const reasons = ({ drops }) => Object.entries(drops ?? {}).filter(([, number]) => number).map(([name, number]) => `${name} ${number}`).join(", ");

/** The name of a route's topic, with a link to the topic, and its type. */
function topicLines() {
  const [link, type] = [el("a", { class: "first" }), el("span", { class: "second" })];
  return {
    element: el("div", { class: "two" }, link, type),
    update(route) {
      const service = route.kind === "service";
      const name = service ? `service:${route.hub_topic ?? route.topic}@${route.type}` : route.hub_topic ?? route.topic;
      write(link, route.topic);
      mark(link, "href", route.action || route.kind === "action" ? null : `#topics/${encodeURIComponent(name)}`);
      write(type, route.type);
    },
  };
}

/** Refused topics with reason and cure, and a form that explains the decision on any name. */
function refusedList(socket) {
  const list = el("ul", { class: "refusals" });
  const number = el("span", { class: "count" });
  const answer = el("ul", { class: "crossing" });
  const name = el("input", { type: "text", placeholder: "/topic, service or action", "aria-label": "Name of a topic, service or action", autocomplete: "off", spellcheck: "false", required: true, maxlength: "255" });
  let asked = 0;
  const form = el("form", { class: "asking", on: { submit: ask } }, name, button("Explain", () => form.requestSubmit()));

  async function ask(event) {
    event.preventDefault();
    const [mine, wanted] = [++asked, name.value.trim()];
    let found;
    try {
      found = explained(wanted, await socket.call("explain", { name: wanted }));
    } catch (error) {
      found = [el("li", { text: error.message })];
    }
    if (mine === asked) answer.replaceChildren(...found);
  }

  return {
    element: block("Not bridged", "refused", el("div", {}, answer, list), number, form),
    fill(refused) {
      write(number, String(refused.length));
      rows(list, refused, (each) => JSON.stringify([each.side, each.topic, each.reason, each.cure]), refusal, () => {});
    },
  };
}

const JOINED = new Set(["connected", "connecting", "listening"]);

/** The failing endpoints of hub.open with reason and cure; hidden if there are none. */
function endpointList() {
  const list = el("ul", { class: "refusals" });
  const element = block("Other machines cannot join", "endpoints", list);
  element.hidden = true;
  return {
    element,
    fill(endpoints) {
      const failing = endpoints.filter(({ state }) => !JOINED.has(state));
      element.hidden = !failing.length;
      rows(list, failing, (each) => JSON.stringify([each.daemon, each.way, each.endpoint, each.state, each.reason, each.cure, each.since]), failure, () => {});
    },
  };
}

function failure({ daemon, way, endpoint, state, reason, cure, since }) {
  return el("li", {},
    el("p", {}, el("strong", { text: endpoint }), ` ${state} since ${new Date(since * 1000).toLocaleTimeString()} (hub.open.${way} of ${daemon})`),
    el("p", { class: "reason", text: reason }),
    cureLine(cure, endpoint));
}

function refusal({ side, topic, reason, cure }) {
  return el("li", {},
    el("p", {}, el("strong", { text: topic }), ` on ${side}`),
    el("p", { class: "reason", text: reason }),
    cureLine(cure, topic));
}

// The view Places: maps, places, areas and paths.

import { button, el, mark, rows, write } from "../../lib/dom.js";
import { degrees, meters } from "../../lib/format.js";
import { mapsBlock } from "./mapslist.js";
import { isHere, remove, rename } from "../../lib/names.js";
import { goToPlace } from "../../lib/poses.js";
import { searchField, Table } from "../../lib/table.js";

/** Builds the view. */
export default function placesView(root, socket) {
  let [map, places, why] = [undefined, null, ""];
  const maps = mapsBlock(socket);
  const locations = locationTable(socket, () => map);
  const shapes = shapeTable(socket, () => map);
  const number = el("span", { class: "count" });
  const shapeBlock = el("section", { class: "block", "aria-labelledby": "shapes-title" },
    el("div", { class: "heading" }, el("h2", { text: "Areas and paths", id: "shapes-title" })), shapes.element);
  root.append(
    maps.element,
    el("section", { class: "block", "aria-labelledby": "places-title" },
      el("div", { class: "heading" }, el("h2", { text: "Places", id: "places-title" }), number,
        searchField("Search places", (text) => {
          locations.find(text);
          shapes.find(text);
        })), locations.element),
    shapeBlock,
  );

  function show() {
    const named = (of) => Object.entries(places?.[of] ?? {}).map(([name, each]) => ({ name, of, ...each }));
    const found = named("locations").sort((a, b) => isHere(socket, map, b) - isHere(socket, map, a) || (a.name < b.name ? -1 : 1));
    locations.fill(found, why || "No places. To save one, press the map.");
    write(number, String(found.length));
    const others = [...named("areas"), ...named("paths")];
    shapes.fill(others, "");
    mark(shapeBlock, "hidden", others.length ? null : "");
  }

  socket.addEventListener("state", () => show());
  let ends = [];
  return {
    show() {
      ends = [
        socket.watch("maps", (value, reason) => {
          map = value?.current;
          maps.take(value, reason);
          show();
        }),
        socket.watch("places", (value, reason) => {
          [places, why] = [value, reason];
          show();
        }),
      ];
    },
    hide() {
      for (const end of ends) end();
    },
  };
}

function locationTable(socket, current) {
  return new Table("Places", [
    { label: "Name", class: "wide", head: true, value: (p) => p.name, text: (p) => p.name },
    { label: "Map", class: "short", value: (p) => p.map, text: (p) => p.map },
    { label: "x", class: "num", value: (p) => p.x, text: (p) => meters(p.x) },
    { label: "y", class: "num", value: (p) => p.y, text: (p) => meters(p.y) },
    { label: "Heading", class: "num", value: (p) => p.theta, text: (p) => degrees(p.theta) },
    { label: "Do", class: "do", made: (place) => actions(socket, current, place) },
  ], (place) => place.name);
}

function actions(socket, current, { name }) {
  const go = button("Go", () => goToPlace(socket, name), { "aria-label": `Go to ${name}` });
  const show = el("a", { class: "button", text: "Show", "aria-label": `Show ${name} on the map` });
  const changing = changes(socket, "location", name);
  return {
    element: el("div", { class: "buttons" }, go, show, ...changing.elements),
    update(place) {
      const here = isHere(socket, current(), place);
      mark(go, "disabled", socket.mayDrive && here ? null : "");
      mark(show, "href", here ? `#drive/${place.x},${place.y}` : null);
      mark(show, "aria-disabled", here ? null : "true");
      changing.update();
    },
  };
}

/** The buttons that rename and delete. */
function changes(socket, kind, name) {
  const elements = [
    button("Rename", () => rename(socket, kind, name), { "aria-label": `Rename ${name}` }),
    button("Delete", () => remove(socket, kind, name), { "aria-label": `Delete ${name}` }),
  ];
  return { elements, update: () => elements.forEach((each) => mark(each, "disabled", socket.mayDrive ? null : "")) };
}

function shapeActions(socket, current, { of, name }) {
  const show = el("a", { class: "button", text: "Show", "aria-label": `Show ${name} on the map` });
  const changing = changes(socket, of === "areas" ? "area" : "path", name);
  return {
    element: el("div", { class: "buttons" }, show, ...changing.elements),
    update({ map, points }) {
      const here = isHere(socket, current(), { map }) && points.length > 0;
      const middle = [0, 1].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
      mark(show, "href", here ? `#drive/${middle.map((part) => part.toFixed(2))}` : null);
      mark(show, "aria-disabled", here ? null : "true");
      changing.update();
    },
  };
}

function shapeTable(socket, current) {
  return new Table("Areas and paths", [
    { label: "Name", class: "wide", head: true, value: (s) => s.name, text: (s) => s.name },
    { label: "Kind", class: "short", value: (s) => s.of, text: (s) => (s.of === "areas" ? "area" : "path") },
    { label: "Map", class: "short", value: (s) => s.map, text: (s) => s.map },
    { label: "Points", class: "num", value: (s) => s.points.length, text: (s) => String(s.points.length) },
    { label: "Do", class: "do", made: (shape) => shapeActions(socket, current, shape) },
  ], (shape) => `${shape.of} ${shape.name}`);
}

// Which layers of the map are drawn; the browser stores the choice.

import { button, el, icon } from "../../lib/dom.js";

const KEY = "midspan.layers";
const LAYERS = { laser: "Laser", path: "Path", obstacles: "Obstacles", layer: "3D layer", places: "Places", areas: "Areas and paths", flags: "Flags" };
const FEEDS = { laser: "laser", path: "path", obstacles: "obstacles", layer: "layer", places: "places", areas: "places" };

/** The button with its menu: {element, on(layer), feeds()}; `changed` is called after a choice. */
export function layerMenu(changed) {
  const off = new Set(remembered());
  const list = el("div", { class: "layers", id: "layers", role: "group", "aria-label": "Layers", hidden: true });
  const opener = button(undefined, () => open(list.hidden), {
    class: "round", "aria-label": "Layers", title: "Layers", "aria-expanded": "false", "aria-controls": "layers",
  });
  opener.append(icon("M12 4l9 5-9 5-9-5zM4 13.5l8 4.5 8-4.5"));
  const open = (yes) => {
    list.hidden = !yes;
    opener.setAttribute("aria-expanded", String(yes));
  };
  for (const [layer, label] of Object.entries(LAYERS)) {
    const choice = button(label, () => {
      if (!off.delete(layer)) off.add(layer);
      choice.setAttribute("aria-pressed", String(!off.has(layer)));
      remember(off);
      changed();
    }, { "aria-pressed": String(!off.has(layer)) });
    list.append(choice);
  }
  const element = el("div", { class: "layering" }, opener, list);
  element.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || list.hidden) return;
    open(false);
    opener.focus();
  });
  addEventListener("pointerdown", (event) => element.contains(event.target) || open(false));
  return {
    element,
    on: (layer) => !off.has(layer),
    feeds: () => Object.entries(FEEDS).filter(([layer]) => !off.has(layer)).map(([, feed]) => feed),
  };
}

function remembered() {
  try {
    const found = JSON.parse(localStorage.getItem(KEY) ?? "[]");
    return Array.isArray(found) ? found : [];
  } catch {
    return []; // storage is forbidden or has invalid content
  }
}

function remember(off) {
  try {
    localStorage.setItem(KEY, JSON.stringify([...off]));
  } catch {
    return; // the choice then lasts only as long as the page
  }
}

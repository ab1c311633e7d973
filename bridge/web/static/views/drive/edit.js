// Editing the map: while it is edited, tools that draw areas and paint flags replace the tool row.

import { AreaEditor } from "./area.js";
import { button, el, icon } from "../../lib/dom.js";
import { PaintEditor } from "./paint.js";

const EDITORS = {
  area: { label: "Area", icon: "M5 6l13-2 2 13-12 3zM5 6v0M18 4v0", make: (map, socket) => new AreaEditor(map, socket) },
  paint: { label: "Paint", icon: "M14 4l6 6-8 8-6-6zM6 12c-3 1-1 6-4 7 3 2 8 1 10-1", make: (map, socket) => new PaintEditor(map, socket) },
};

/** The row of editing tools: {element, open(), close()}. `left` is called when editing ends. */
export function editBar(map, socket, left) {
  const made = {}; // the editors used so far, whose drawings stay while another editor is active
  const choices = Object.fromEntries(Object.entries(EDITORS).map(([name, { label, icon: path }]) => [name,
    el("button", { type: "button", "aria-pressed": "false", title: label, on: { click: () => choose(name) } }, icon(path), el("span", { text: label }))]));
  const controls = el("div", { class: "controls", role: "group", "aria-label": "Editing" });
  const done = button("Done", () => {
    close();
    left();
  }, { class: "primary done" });
  const element = el("div", { class: "tools editing drives", role: "toolbar", "aria-label": "Editing the map", hidden: true },
    ...Object.values(choices), controls, done);

  function choose(name) {
    const editor = made[name] ??= EDITORS[name].make(map, socket);
    for (const [each, choice] of Object.entries(choices)) choice.setAttribute("aria-pressed", String(each === name));
    controls.replaceChildren(...editor.controls);
    map.edit(editor);
  }

  function close() {
    element.hidden = true;
    map.element.parentElement?.classList.remove("edits");
    map.edit(null);
  }

  element.addEventListener("keydown", (event) => event.key === "Escape" && done.click());
  return {
    element,
    close,
    open() {
      element.hidden = false;
      map.element.parentElement.classList.add("edits"); // on a phone the map then fills the screen
      choose("area");
    },
  };
}

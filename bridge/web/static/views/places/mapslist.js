// The maps of the store: choose, rename, import, export.

import { button, el, mark, rows, write } from "../../lib/dom.js";
import { download, upload } from "./files.js";
import { LONGEST_NAME } from "../../lib/names.js";
import { ask, question, notify } from "../../lib/messages.js";

/** The block "Maps"; `take(value, why)` receives the feed. */
export function mapsBlock(socket) {
  const list = el("ul", { class: "maps" });
  const empty = el("p", { class: "empty" });
  const picker = el("input", { type: "file", multiple: true, hidden: true, "aria-label": "Files of a map",
    accept: ".zip,.map,.yaml,.yml,.pgm,.ppm,.png,.bmp,.ini", on: { change: () => come() } });
  const bring = button("Import …", () => picker.click(), { class: "drives", title: "A ROS map (YAML and image) or a YARP map (.map and its files), also as a zip" });

  async function come() {
    const files = [...picker.files];
    picker.value = "";
    if (files.length) await importMaps(socket, files);
  }

  let [maps, why] = [null, ""];
  socket.addEventListener("state", () => show());

  function show() {
    const known = maps?.names ?? [];
    write(empty, known.length ? "" : why || "No maps. Import one.");
    rows(list, known, (name) => name, (name) => row(socket, name), (item, name) => {
      const current = name === maps.current;
      mark(item.firstChild, "aria-pressed", String(current));
      mark(item.firstChild, "title", current ? "Current map" : "Use this map");
      for (const each of item.querySelectorAll(".changes")) mark(each, "disabled", socket.mayDrive ? null : "");
    });
  }

  return {
    element: el("section", { class: "block", "aria-labelledby": "maps-title" },
      el("div", { class: "heading" }, el("h2", { text: "Maps", id: "maps-title" }), bring, picker), list, empty),
    take(value, reason) {
      [maps, why] = [value, reason];
      show();
    },
  };
}

function row(socket, name) {
  return el("li", {},
    button(name, () => use(socket, name), { class: "changes map-name" }),
    button("Rename", () => rename(socket, name), { class: "changes", "aria-label": `Rename the map ${name}` }),
    button("Export", () => go(socket, name), { "aria-label": `Export the map ${name}` }));
}

async function use(socket, name) {
  const sure = await question(`Use the map ${name}?`, {}, "Use it", { text: "Planner and localizer will use this map." });
  if (sure) await ask(socket, `Use the map ${name}`, "use_map", { name }, `Current map: ${name}.`);
}

async function rename(socket, name) {
  const answer = await question(`Rename the map ${name}`, { to: { label: "New name", value: name, maxlength: LONGEST_NAME } }, "Rename",
    { text: "Its places, areas and paths stay on it." });
  if (answer && answer.to !== name) await ask(socket, `Rename ${name}`, "rename_map", { name, to: answer.to }, `Renamed ${name} to ${answer.to}.`);
}

async function go(socket, name) {
  const line = notify(`Exporting ${name} …`);
  try {
    await download(socket, await socket.call("export_map", { name }));
    notify(`Exported ${name}.`);
  } catch (error) {
    notify(`Export of ${name} failed: ${error.message}`, { bad: true });
  }
  line.remove();
}

async function importMaps(socket, files) {
  const line = notify("Importing …");
  const text = line.firstChild;
  try {
    const key = await upload(socket, files, (share) => write(text, `Importing: ${Math.round(100 * share)} % …`));
    let done = await socket.call("import_map", { key });
    if (!done.done) {
      line.remove();
      const choice = await replacing(done);
      if (choice === null) return;
      done = await socket.call("import_map", { key, ...choice });
    }
    if (done.done) notify(`Imported ${done.maps.length ? done.maps.join(", ") : "the places"}.`);
    else notify(`Import failed: ${names(done.taken)} already exists.`, { bad: true });
  } catch (error) {
    notify(`Import failed: ${error.message}`, { bad: true });
  }
  line.remove();
}

const names = (taken) => taken.slice(0, 5).map(([kind, name]) => `the ${kind} ${name}`).join(", ") + (taken.length > 5 ? " …" : "");

/** Ask what to do if names are in use: another name for a single map, or replace; null: cancel. */
async function replacing({ maps, taken }) {
  const one = maps.length === 1 && taken.length === 1 && taken[0][0] === "map";
  const fields = one ? { name: { label: "Import it as", value: maps[0], maxlength: LONGEST_NAME } } : {};
  const answer = await question("Replace existing values?", fields, "Import", { text: `Already stored: ${names(taken)}${one ? ". Importing under the same name replaces it." : "."}`, danger: true });
  if (!answer) return null;
  return one && answer.name !== maps[0] ? { name: answer.name } : { replace: true };
}

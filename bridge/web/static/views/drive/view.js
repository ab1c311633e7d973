// The view Drive: the map, the robot's state, its possible goals, manual driving.

import { button, el, mark, rows, write } from "../../lib/dom.js";
import { editBar } from "./edit.js";
import { degrees, meters, position } from "../../lib/format.js";
import { MapBlock } from "./map.js";
import { isHere, remove, rename } from "../../lib/names.js";
import { patrolBlock } from "./patrol.js";
import { PointMenu } from "./pointmenu.js";
import { goTo, goToPlace, goToTyped, keepPlace, robotIsAt } from "../../lib/poses.js";
import { ask } from "../../lib/messages.js";
import { teleop } from "./teleop.js";
import { isBusy, mood, stateWords } from "../../lib/words.js";

/** Builds the view; `navigate` takes `x,y`, the point to show on the map. */
export default function driveView(root, socket) {
  const heading = () => map.values.robot?.pose?.theta ?? 0;
  const tools = {
    go: { label: "Go here", drives: true, icon: "M12 21V9M6 12l6-8 6 8", hint: "Press where to go; drag to set the heading.",
      done: (pose) => goTo(socket, pose) },
    robot: { label: "Robot is here", drives: true, icon: "M12 3l6 16-6-4-6 4z", hint: "Press at the robot's position; drag to set its heading.",
      done: (pose) => robotIsAt(socket, pose, heading()) },
    keep: { label: "Save place", drives: true, icon: "M12 21s-6-6-6-11a6 6 0 0 1 12 0c0 5-6 11-6 11zM12 8v5M9.5 10.5h5", hint: "Press the place; drag to set its heading.",
      done: (pose) => keepPlace(socket, map.values.places, pose, heading()) },
    measure: { label: "Measure", icon: "M3 16L16 3l5 5L8 21zM8 11l2 2M11 8l3 3M14 5l2 2", hint: "Drag from one point to another.", done: () => {} },
    edit: { label: "Edit map", drives: true, icon: "M4 20l1-4L16 5l3 3L8 19zM13.5 7.5l3 3", open: () => {
      menu.close();
      editing.open();
    } },
  };
  const map = new MapBlock(socket, tools, (at, place, pixel, shape) => {
    const off = { disabled: !socket.mayDrive };
    const named = place ? { kind: "location", name: place } : shape;
    menu.open([place ?? position(at.x, at.y), map.hitAt(at.x, at.y)].filter(Boolean).join(" · "), pixel, [
      place ? [`Go to ${place}`, () => goToPlace(socket, place), off] : ["Go here", () => goTo(socket, at), off],
      ["Go here, with a heading …", () => goToTyped(socket, { ...at, theta: heading() }), off],
      ["Robot is here …", () => robotIsAt(socket, at, heading()), off],
      ["Save this place …", () => keepPlace(socket, map.values.places, at, heading()), off],
      ["Measure", () => map.choose("measure")],
      ...(named ? [
        [`Rename ${named.name} …`, () => rename(socket, named.kind, named.name), off],
        [`Delete ${named.name} …`, () => remove(socket, named.kind, named.name), off],
      ] : []),
    ]);
  });
  const editing = editBar(map, socket, () => map.toolButtons.at(-1).focus());
  map.element.append(editing.element);
  const menu = new PointMenu(map.element, () => {
    map.point = null;
    map.redraw();
  });
  const doing = doingBlock(socket);
  const sending = sendBlock(socket);
  const byHand = teleop(socket);
  const panel = el("div", { class: "panel" }, doing.element, sending.element, byHand.element);
  const choose = (hand) => {
    panel.dataset.part = hand ? "hand" : "go";
    choice.children[0].setAttribute("aria-pressed", String(!hand));
    choice.children[1].setAttribute("aria-pressed", String(hand));
    byHand.end();
  };
  const choice = el("div", { class: "parts", role: "group", "aria-label": "How to drive" },
    button("Send", () => choose(false)), button("Manual", () => choose(true)));
  doing.element.after(choice);
  choose(false);
  root.append(map.element, panel);

  let ends = [];
  return {
    show() {
      ends = [socket.watch("driving", doing.take), socket.watch("driving", sending.takeDriving),
        socket.watch("places", sending.takePlaces), socket.watch("maps", sending.takeMaps), socket.watch("patrol", sending.takePatrol),
        socket.watch("patrol", doing.takePatrol)];
      map.show();
    },
    navigate(rest) {
      const target = rest.split(",").map(Number);
      if (rest && target.length === 2 && target.every(Number.isFinite)) map.center(...target);
    },
    hide() {
      for (const end of ends) end();
      byHand.end();
      menu.close();
      editing.close();
      map.hide();
    },
  };
}

/** The current state, with Pause and Stop. */
function doingBlock(socket) {
  const state = el("p", { class: "state" });
  const reason = el("p", { class: "reason", "aria-live": "polite" });
  const goal = el("dd");
  const left = el("dd");
  let [driving, patrol] = [null, null];
  const pause = button("Pause", () => (pause.textContent === "Resume"
    ? ask(socket, "Resume", "resume", {}, "Resumed.") : ask(socket, "Pause", "pause", {}, "Paused.")));
  const end = button("End drive", () => ask(socket, "End drive", "stop", {}, "Drive ended."));
  const show = () => {
    const held = patrol?.state === "held" || driving?.state === "paused";
    const under = isBusy(driving) || (patrol !== null && patrol.state !== "ended");
    write(pause, held ? "Resume" : "Pause");
    mark(pause, "disabled", held || under ? null : "");
    mark(end, "disabled", held || under || driving?.goal ? null : "");
  };
  const element = el("section", { class: "block doing", "aria-label": "Current state" },
    state, reason,
    el("dl", { class: "facts" }, el("dt", { text: "Goal" }), goal, el("dt", { text: "Left" }), left),
    el("div", { class: "buttons drives" }, pause, end));
  return {
    element,
    takePatrol(value) {
      patrol = value;
      show();
    },
    take(value, why) {
      driving = value;
      element.dataset.mood = value ? mood(value) : "calm";
      write(state, value ? stateWords(value) : "Unknown");
      write(reason, (value ? value.reason : why) || "");
      const at = value?.goal;
      write(goal, at ? `${position(at.x, at.y)}  ${degrees(at.theta)}` : "–");
      write(left, meters(value?.distance, 1));
      show();
    },
  };
}

/** Places of the current map as goals, and the planner. */
function sendBlock(socket) {
  let [places, why, current] = [null, "", ""];
  const list = el("ul", { class: "places-list drives" });
  const empty = el("p", { class: "empty" });
  const planner = el("select", { id: "planner", title: "Planner", on: {
    change: () => ask(socket, `Planner ${planner.value}`, "choose_planner", { name: planner.value }, `Planner changed to ${planner.value}.`),
  } });
  const patrol = patrolBlock(socket, () => show());
  const title = el("h2", { text: "Send to", id: "send-to" });
  const element = el("section", { class: "block send", "aria-labelledby": "send-to" },
    title, list, empty, patrol.element,
    el("label", { class: "field row drives", for: "planner" }, el("span", { text: "Planner" }), planner));
  const show = () => {
    const names = Object.entries(places?.locations ?? {})
      .filter(([, place]) => isHere(socket, current, place)).map(([name]) => name).sort();
    write(empty, names.length ? "" : why || "No places on this map. To save one, press the map.");
    rows(list, names, (name) => name, (name) => el("li", {}, button(name, () => (patrol.picks ? patrol.pick(name) : goToPlace(socket, name)), { title: name })), () => {});
    write(title, patrol.picks ? "Patrol" : "Send to");
    element.classList.toggle("picks", patrol.picks);
  };
  return {
    element,
    takePatrol: patrol.take,
    takePlaces(value, reason) {
      [places, why] = [value, reason];
      show();
    },
    takeMaps(maps) {
      current = maps?.current;
      show();
    },
    takeDriving(driving) {
      const planners = driving?.planners ?? [];
      rows(planner, planners, (name) => name, (name) => el("option", { value: name, text: name }), () => {});
      if (driving?.planner && document.activeElement !== planner) planner.value = driving.planner;
      mark(planner, "disabled", planners.length ? null : "");
    },
  };
}

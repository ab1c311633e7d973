// The joystick and the buttons for manual driving.

import { el, icon, write } from "../../lib/dom.js";
import { degrees } from "../../lib/format.js";
import { Hold } from "./hold.js";

const DEAD = 0.08; // share of the joystick's range within which a finger counts as centered
const ARROWS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };

// label, velocity as shares of the limit (forward, left, rotation), icon
const BUTTONS = [
  ["Turn left", [0, 0, 1], "M9 4L4 9l5 5M4 9h9a6 6 0 0 1 6 6v4"],
  ["Forward", [1, 0, 0], "M12 20V4M5 11l7-7 7 7"],
  ["Turn right", [0, 0, -1], "M15 4l5 5-5 5M20 9h-9a6 6 0 0 0-6 6v4"],
  ["Sideways left", [0, 1, 0], "M20 12H4M11 5l-7 7 7 7"],
  ["Back", [-1, 0, 0], "M12 4v16M5 13l7 7 7-7"],
  ["Sideways right", [0, -1, 0], "M4 12h16M13 5l7 7-7 7"],
];

/** The block "Manual driving": {element, end()}. */
export function teleop(socket) {
  const knob = el("span", { class: "knob" });
  const stick = el("div", {
    class: "stick", tabindex: "0", role: "application",
    "aria-label": "Joystick. Hold the arrow keys to drive, release to stop.",
  }, knob);
  const share = el("input", { type: "range", min: "10", max: "100", step: "5", value: "50", id: "share" });
  const shareText = el("output", { for: "share", class: "figure" });
  const commanded = el("p", { class: "commanded", "aria-live": "off" });
  let pointer = null; // the holding pointer
  let holder = null; // the held element
  const keys = new Set();

  const hold = new Hold(socket, () => {
    if (holder !== null && pointer !== null && holder.hasPointerCapture(pointer)) holder.releasePointerCapture(pointer);
    pointer = holder = null;
    keys.clear();
    for (const each of [stick, ...pad.children]) each.classList.remove("held");
    moveKnob(0, 0);
  });

  function most() {
    const { x = 0, turn = 0 } = socket.hello?.speed ?? {};
    return { x: (x * share.value) / 100, turn: (turn * share.value) / 100 };
  }

  /** Drive at shares of the limits. */
  function drive(x, y, turn) {
    const limit = most();
    return hold.drive(x * limit.x, y * limit.x, turn * limit.turn);
  }

  function moveKnob(right, down) {
    knob.style.setProperty("--right", right.toFixed(3));
    knob.style.setProperty("--down", down.toFixed(3));
  }

  /** Let a pointer hold an element: `push(event)` returns the velocity. */
  function holdable(element, push) {
    element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || pointer !== null) return;
      event.preventDefault();
      element.focus({ preventScroll: true });
      hold.end();
      pointer = event.pointerId;
      holder = element;
      element.setPointerCapture(pointer);
      element.classList.add("held");
      if (!push(event)) letGo(event);
    });
    const letGo = (event) => {
      if (event.pointerId !== pointer || holder !== element) return;
      pointer = holder = null;
      element.classList.remove("held");
      moveKnob(0, 0);
      hold.end();
    };
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) element.addEventListener(end, letGo);
    element.addEventListener("pointermove", (event) => {
      if (event.pointerId === pointer && holder === element) push(event);
    });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("blur", () => hold.end());
  }

  holdable(stick, (event) => {
    const box = stick.getBoundingClientRect();
    let right = (event.clientX - box.left - box.width / 2) / (box.width / 2);
    let down = (event.clientY - box.top - box.height / 2) / (box.height / 2);
    const deflection = Math.hypot(right, down);
    if (deflection > 1) [right, down] = [right / deflection, down / deflection];
    moveKnob(right, down);
    return deflection < DEAD ? drive(0, 0, 0) : drive(-down, 0, -right);
  });
  stick.addEventListener("keydown", (event) => {
    if (!(event.key in ARROWS) || event.altKey || event.ctrlKey || event.metaKey || pointer !== null) return;
    event.preventDefault();
    if (event.repeat) return; // a key that is still down when the hold ends does not start another
    keys.add(event.key);
    push();
  });
  stick.addEventListener("keyup", (event) => {
    if (!keys.delete(event.key)) return;
    if (keys.size) push();
    else hold.end();
  });
  function push() {
    let [ahead, left] = [0, 0];
    for (const key of keys) {
      ahead += ARROWS[key][0];
      left += ARROWS[key][1];
    }
    if (drive(ahead, 0, left)) moveKnob(-left, -ahead);
  }

  const pad = el("div", { class: "pad" });
  for (const [label, shares, path] of BUTTONS) {
    const each = el("button", { type: "button", "aria-label": label, title: label }, icon(path));
    holdable(each, () => drive(...shares));
    each.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || event.repeat || pointer !== null) return;
      event.preventDefault();
      if (drive(...shares)) each.classList.add("held");
    });
    each.addEventListener("keyup", (event) => event.key === "Enter" && hold.end());
    pad.append(each);
  }

  const shareChanged = () => {
    const limit = most();
    write(shareText, `${limit.x.toFixed(2)} m/s`);
    share.setAttribute("aria-valuetext", `${share.value} percent, ${limit.x.toFixed(2)} meters per second`);
  };
  const heldChanged = ({ x, y, turn }) => {
    write(commanded, x || y || turn
      ? `${x.toFixed(2)} m/s forward, ${y ? `${y.toFixed(2)} m/s left, ` : ""}${degrees(turn)}/s`
      : "Drives only while you hold.");
  };
  share.addEventListener("input", shareChanged);
  socket.addEventListener("state", shareChanged);
  socket.addEventListener("state", () => socket.open || heldChanged({ x: 0, y: 0, turn: 0 }));
  socket.addEventListener("held", (event) => heldChanged(event.detail));
  shareChanged();
  heldChanged({ x: 0, y: 0, turn: 0 });

  const element = el("section", { class: "block teleop drives", "aria-labelledby": "by-hand" },
    el("h2", { text: "Manual driving", id: "by-hand" }),
    el("div", { class: "sticks" }, stick, pad),
    el("label", { class: "share", for: "share" }, el("span", { text: "Speed" }), share, shareText),
    commanded);
  return { element, end: () => hold.end() };
}

// Patrols: the operator picks places in order; the robot drives to them in turn until the patrol is ended.

import { button, el, mark, rows, write } from "../../lib/dom.js";
import { ask } from "../../lib/messages.js";

const MOST = 50; // maximum number of places, the console's limit
const WAITS = [["no stop", 0], ["1 s", 1], ["2 s", 2], ["10 s", 10], ["1 min", 60], ["10 min", 600]];

/** The patrol in "Send to"; `changed()` is called when picking starts or ends. */
export function patrolBlock(socket, changed) {
  let [picked, picks, patrol] = [[], false, null];
  const line = el("p", { class: "turn", role: "status" });
  const opener = button("Patrol …", () => pickNow(!picks), { "aria-expanded": "false", "aria-controls": "turns" });
  const list = el("ol", { class: "turns", "aria-label": "Places of the patrol, in order" });
  const hint = el("p", { class: "empty", text: "Press the places in order." });
  const wait = el("select", { "aria-label": "Time at each place", title: "Time at each place" },
    ...WAITS.map(([text, value]) => el("option", { value: String(value), text: value ? `wait ${text}` : text })));
  wait.value = "0";
  const start = button("Start patrol", begin, { class: "primary" });
  const picking = el("div", { class: "picking", id: "turns", hidden: true }, hint, list, el("div", { class: "buttons" }, wait, start));
  const element = el("div", { class: "patrol drives" }, el("div", { class: "buttons" }, opener, line), picking);

  function pickNow(on) {
    picks = on;
    picked = [];
    opener.setAttribute("aria-expanded", String(on));
    write(opener, on ? "Cancel patrol" : "Patrol …");
    picking.hidden = !on;
    show();
    changed();
  }

  async function begin() {
    const done = await ask(socket, "Patrol", "patrol", { places: picked, wait: Number(wait.value) }, `Patrolling ${picked.join(", ")}.`);
    if (done) pickNow(false);
  }

  function show() {
    hint.hidden = picked.length > 0;
    start.disabled = picked.length < 2;
    const turns = picked.map((name, i) => ({ name, i }));
    rows(list, turns, ({ name, i }) => `${i} ${name}`, ({ name, i }) => el("li", {}, button(`${name} ×`, () => {
      picked.splice(i, 1);
      show();
    }, { "aria-label": `Remove ${name} from the patrol` })), () => {});
    const active = patrol !== null && patrol.state !== "ended";
    write(line, patrol ? words(patrol) : "");
    mark(line, "data-state", patrol?.state ?? null);
    mark(line, "data-mood", patrol?.state === "held" ? "held" : active ? "busy" : null);
    mark(opener, "disabled", active && !picks ? "" : null);
  }

  show();
  return {
    element,
    get picks() {
      return picks;
    },
    pick(name) {
      if (picked.length < MOST) picked.push(name);
      show();
    },
    take(value) {
      patrol = value;
      show();
    },
  };
}

/** The state of a patrol as text. */
export function words({ state, places, at, round, why }) {
  const turn = `${places[at]} (${at + 1} of ${places.length}, round ${round})`;
  return {
    drives: `Patrol: to ${turn}`,
    waits: `Patrol: at ${turn}`,
    held: `Patrol paused: ${turn}`,
    ended: `Patrol ended: ${why}`,
  }[state] ?? "";
}

// The current pose of one frame in another.

import { button, el, mark, write } from "../../lib/dom.js";
import { meters, seconds } from "../../lib/format.js";

const FIGURES = ["x", "y", "z", "roll", "pitch", "yaw"];
const FIRST = [["map", "odom"], ["base_link", "base_footprint"]]; // frames chosen initially, if they exist

/** {element, show(), hide(), offer(names)}: shows the pose of one chosen frame in another. */
export function framePose(socket) {
  const frame = el("select", { on: { change: follow } });
  const reference = el("select", { on: { change: follow } });
  const figures = FIGURES.map(() => el("dd"));
  const age = el("span", { class: "second" });
  const why = el("p", { class: "empty" });
  const list = el("dl", { class: "pose-figures" }, ...FIGURES.flatMap((name, i) => [el("dt", { text: name }), figures[i]]));
  const element = el("section", { class: "block framepose", "aria-labelledby": "pose-title" },
    el("div", { class: "heading" }, el("h2", { text: "Pose", id: "pose-title" }),
      el("label", {}, "of ", frame), el("label", {}, "in ", reference),
      button("Swap", () => {
        [frame.value, reference.value] = [reference.value, frame.value];
        picked.add(frame).add(reference);
        follow();
      }, { "aria-label": "Swap the two frames" }), age),
    list, why);
  let [names, watched, end, shown] = ["", "", () => {}, false];
  const picked = new Set(); // the selects that the operator has changed; the page may still switch the others to better frames
  for (const select of [frame, reference]) select.addEventListener("change", () => picked.add(select));

  function follow() {
    const wanted = shown && frame.value && reference.value ? `pose:${reference.value}>${frame.value}` : "";
    if (wanted === watched) return;
    end();
    watched = wanted;
    end = wanted ? socket.watch(wanted, draw) : () => {};
  }

  function draw(value, reason) {
    mark(list, "hidden", value ? null : "");
    write(why, value ? "" : reason || "Waiting for transforms.");
    write(age, value ? (value.age === null ? "static" : `${seconds(value.age)} ago`) : "");
    if (!value) return;
    const { position, angles } = value;
    const texts = [...Object.values(position).map((each) => meters(each, 3)), ...Object.values(angles).map((each) => `${((each * 180) / Math.PI).toFixed(1)}°`)];
    texts.forEach((text, i) => write(figures[i], text));
  }

  return {
    element,
    offer(found) {
      const sorted = [...found].sort();
      if (sorted.join("\n") === names) return;
      names = sorted.join("\n");
      for (const [select, first] of [[reference, FIRST[0]], [frame, FIRST[1]]]) {
        const old = select.value;
        const gone = old && !sorted.includes(old) ? [old] : []; // it may return
        select.replaceChildren(...[...sorted, ...gone].map((name) => el("option", { value: name, text: name })));
        select.value = (picked.has(select) && old) || first.find((name) => sorted.includes(name)) || old || sorted[0] || "";
      }
      follow();
    },
    show() {
      shown = true;
      follow();
    },
    hide() {
      shown = false;
      follow();
    },
  };
}

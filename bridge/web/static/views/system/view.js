// The view System: the log, the doctor's findings, the configuration.

import { configPart } from "./config.js";
import { doctorPart } from "./doctor.js";
import { el, mark } from "../../lib/dom.js";
import { logPart } from "./log.js";

const PARTS = { log: ["Log", logPart], doctor: ["Doctor", doctorPart], config: ["Configuration", configPart] };

/** Builds the view; `navigate` takes the name of a part. */
export default function systemView(root, socket) {
  const made = {}; // name -> {element, show(), hide()}
  const links = Object.entries(PARTS).map(([name, [words]]) => el("a", { href: `#system/${name}`, text: words }));
  const place = el("div", { class: "part" });
  root.append(el("nav", { class: "parts", "aria-label": "Parts of the system" }, ...links), place);
  let shown = null;

  function leave() {
    if (shown !== null) made[shown].hide();
    shown = null;
  }

  return {
    show() {}, // `navigate` is called next
    navigate(rest) {
      const wanted = Object.hasOwn(PARTS, rest) ? rest : "log";
      if (wanted === shown) return;
      leave();
      shown = wanted;
      made[wanted] ??= PARTS[wanted][1](socket);
      place.replaceChildren(made[wanted].element);
      made[wanted].show();
      for (const link of links) mark(link, "aria-current", link.hash === `#system/${wanted}` ? "true" : null);
    },
    hide: leave,
  };
}

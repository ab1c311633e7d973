// A cure as text to copy.

import { button, el } from "./dom.js";
import { say } from "./say.js";

/** A cure with its button, or null where there is none; `what` names it for those who do not see where it stands. */
export function cureLine(cure, what) {
  return cure ? el("div", { class: "cure" }, el("code", { text: cure }), button("Copy", () => copy(cure), { "aria-label": `Copy the cure for ${what}` })) : null;
}

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    say("Copied.");
  } catch {
    say("The browser does not let this page copy: select the text by hand.", { bad: true });
  }
}

// Cures as text to copy, and what workers say of a name.

import { button, el } from "./dom.js";
import { say } from "./say.js";

/** A cure with its button, or null where there is none; `what` names it for those who do not see where it stands. */
export function cureLine(cure, what) {
  return cure ? el("div", { class: "cure" }, el("code", { text: cure }), button("Copy", () => copy(cure), { "aria-label": `Copy the cure for ${what}` })) : null;
}

/** What each worker decided of `name`, as the verb `explain` says it: list items. */
export function explained(name, found) {
  if (!found.length) return [el("li", {}, el("p", { text: `No worker knows ${name}.` }))];
  return found.map(({ daemon, side, decision, why, cure }) => el("li", {},
    el("p", {}, el("strong", { text: side }), ` ${decision}${daemon ? ` (${daemon})` : ""}`),
    why ? el("p", { class: "reason", text: why }) : null,
    cureLine(cure, name)));
}

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    say("Copied.");
  } catch {
    say("The browser does not let this page copy: select the text by hand.", { bad: true });
  }
}

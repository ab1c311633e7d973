// Cures as text to copy, and the workers' decisions on a name.

import { button, el } from "./dom.js";
import { notify } from "./messages.js";

/** A cure with a button to copy it, or null if there is no cure; `what` names its subject for screen readers. */
export function cureLine(cure, what) {
  return cure ? el("div", { class: "cure" }, el("code", { text: cure }), button("Copy", () => copy(cure), { "aria-label": `Copy the cure for ${what}` })) : null;
}

/** List items with each worker's decision on `name`, as replied by the verb `explain`. */
export function explained(name, found) {
  if (!found.length) return [el("li", {}, el("p", { text: `No worker has a decision on ${name}.` }))];
  return found.map(({ daemon, side, decision, why, cure, users }) => el("li", {},
    el("p", {}, el("strong", { text: side }), ` ${decision}${daemon ? ` (${daemon})` : ""}`),
    why ? el("p", { class: "reason", text: why }) : null,
    ...users.map((text) => el("p", { class: "reason", text })),
    cureLine(cure, name)));
}

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    notify("Copied.");
  } catch {
    notify("The browser does not allow this page to copy. Select the text manually.", { bad: true });
  }
}

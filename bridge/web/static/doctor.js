// What `midspan doctor` finds, when somebody asks.

import { cureLine } from "./cure.js";
import { button, el, mark, write } from "./dom.js";

const RESULTS = { fail: "Fails", warn: "Warns", ok: "Fine", skip: "Does not apply" };
const OPEN = new Set(["fail", "warn"]);

/** Builds the part: {element, show(), hide()}. */
export function doctorPart(socket) {
  const sum = el("span", { class: "count", role: "status" });
  const lists = el("div", { class: "findings" });
  const empty = el("p", { class: "empty", text: "The doctor looks at the configuration, the daemon, all sides, the network and this machine. It changes nothing, and takes some seconds." });
  const look = button("Look now", examine, { class: "primary" });
  const element = el("section", { class: "block", "aria-labelledby": "doctor-title" },
    el("div", { class: "heading" }, el("h2", { text: "Doctor", id: "doctor-title" }), sum, look), empty, lists);

  async function examine() {
    look.disabled = true;
    write(sum, "The doctor looks …");
    try {
      fill(await socket.call("doctor"));
    } catch (error) {
      write(sum, error.message);
    } finally {
      look.disabled = false;
      look.textContent = "Look again";
    }
  }

  function fill(findings) {
    const groups = Object.keys(RESULTS).map((result) => [result, findings.filter((each) => each.result === result)]).filter(([, of]) => of.length);
    write(sum, groups.map(([result, of]) => `${RESULTS[result].toLowerCase()}: ${of.length}`).join(", "));
    mark(empty, "hidden", "");
    lists.replaceChildren(...groups.map(([result, of]) => el("details", { open: OPEN.has(result), "data-result": result },
      el("summary", { text: `${RESULTS[result]} (${of.length})` }), el("ul", {}, ...of.map(finding)))));
  }

  return { element, show() {}, hide() {} };
}

function finding({ check, title, seen, cure }) {
  return el("li", {}, el("p", { title }, el("strong", { text: check }), ` ${seen}`), cureLine(cure, check));
}

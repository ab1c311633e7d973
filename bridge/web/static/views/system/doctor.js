// The findings of `midspan doctor`, on request.

import { cureLine } from "../../lib/cure.js";
import { button, el, mark, write } from "../../lib/dom.js";

const RESULTS = { fail: "Failed", warn: "Warnings", ok: "OK", skip: "Not applicable" };
const OPEN = new Set(["fail", "warn"]);

/** Builds the part: {element, show(), hide()}. */
export function doctorPart(socket) {
  const sum = el("span", { class: "count", role: "status" });
  const lists = el("div", { class: "findings" });
  const empty = el("p", { class: "empty", text: "The doctor checks the configuration, the daemon, all sides, the network and this machine. It changes nothing, and takes a few seconds." });
  const run = button("Run checks", examine, { class: "primary" });
  const element = el("section", { class: "block", "aria-labelledby": "doctor-title" },
    el("div", { class: "heading" }, el("h2", { text: "Doctor", id: "doctor-title" }), sum, run), empty, lists);

  async function examine() {
    run.disabled = true;
    write(sum, "Running checks …");
    try {
      fill(await socket.call("doctor"));
    } catch (error) {
      write(sum, error.message);
    } finally {
      run.disabled = false;
      run.textContent = "Run again";
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

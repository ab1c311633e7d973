// The daemon's configuration with its comments, read-only, and the findings of a check.

import { button, el, mark, write } from "../../lib/dom.js";

/** Builds the part: {element, show(), hide()}. */
export function configPart(socket) {
  const file = el("code", { class: "file" });
  const verdict = el("p", { class: "verdict", role: "status" });
  const problems = el("ul", { class: "problems" });
  const text = el("ol", { class: "config", "aria-label": "The configuration, line by line" });
  const again = button("Check again", read);
  const element = el("section", { class: "block", "aria-labelledby": "config-title" },
    el("div", { class: "heading" }, el("h2", { text: "Configuration", id: "config-title" }), file, again), verdict, problems, text);

  async function read() {
    if (again.disabled) return;
    again.disabled = true;
    try {
      fill(await socket.call("config"));
    } catch (error) {
      report("bad", error.message);
    } finally {
      again.disabled = false;
    }
  }

  function report(mood, words) {
    mark(verdict, "data-mood", mood);
    write(verdict, words);
  }

  function fill(found) {
    write(file, found.file ?? "");
    const lines = found.text?.replace(/\n$/, "").split("\n") ?? [];
    text.replaceChildren(...lines.map((line) => el("li", { class: /^\s*#/.test(line) ? "comment" : null }, el("code", { text: line || " " }))));
    problems.replaceChildren(...found.problems.map((each) => problem(each)));
    for (const { line } of found.problems) text.children[line - 1]?.classList.add("wrong");
    if (found.problems.length) report("bad", `${found.problems.length === 1 ? "One problem" : `${found.problems.length} problems`}: the daemon would keep its current configuration. ${found.why}`);
    else if (found.why) report("bad", found.why);
    else report("good", found.file ? "No problems. Passwords, tokens and keys are not shown." : "No configuration file: the defaults apply.");
  }

  function problem({ line, column, key, text: words }) {
    const place = line ? button(`Line ${line}, ${column}`, () => {
      text.children[line - 1]?.scrollIntoView({ block: "center" });
    }, { class: "line-link" }) : null;
    return el("li", {}, place, el("span", {}, key ? el("strong", { text: `${key}: ` }) : null, words));
  }

  const joined = () => socket.open && read(); // also after a restart of the daemon, which may use another file
  return {
    element,
    show() {
      joined();
      socket.addEventListener("state", joined);
    },
    hide: () => socket.removeEventListener("state", joined),
  };
}

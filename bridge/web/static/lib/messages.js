// Messages about commands and their results; questions to the operator.

import { button, el } from "./dom.js";

const SHOWN = 5000;
const SHOWN_WRONG = 12000;
const MOST = 4;

let leaveOpen = () => {}; // closes the open question, if any

const notices = document.getElementById("notices");
const wrong = document.getElementById("wrong");

/** Show a message to the operator for a few seconds. */
export function notify(text, { bad = false } = {}) {
  const list = bad ? wrong : notices;
  for (const old of list.children) if (old.firstChild.textContent === text) old.remove();
  const line = el("p", { class: "toast" }, el("span", { text }));
  line.append(button("×", () => line.remove(), { class: "close", "aria-label": "Close this message" }));
  list.append(line);
  while (list.childElementCount > MOST) list.firstElementChild.remove();
  setTimeout(() => line.remove(), bad ? SHOWN_WRONG : SHOWN);
  return line;
}

/**
 * Call a verb and show its progress, then `done` or, without it, the console's reply.
 * Resolves to whether it succeeded.
 */
export async function ask(socket, what, verb, args, done) {
  const line = notify(`${what} …`);
  try {
    const value = await socket.call(verb, args);
    line.remove();
    notify(done ?? `${what}: ${typeof value === "string" && value ? value : "done"}.`);
    return true;
  } catch (error) {
    line.remove();
    notify(`${what} failed: ${error.message}`, { bad: true });
    return false;
  }
}

/**
 * Ask for values; resolves to an object of texts by field, or null if the operator cancels.
 * `fields`: {name: {label, value, ...attributes of the input}}. The page stays usable meanwhile, above all STOP.
 */
export function question(title, fields, yes, { text, danger = false } = {}) {
  return new Promise((resolve) => {
    const before = document.activeElement;
    const inputs = Object.entries(fields).map(([name, { label, ...attributes }]) => {
      const input = el("input", { type: "text", autocomplete: "off", required: true, ...attributes, name });
      return el("label", { class: "field" }, el("span", { text: label }), input);
    });
    const form = el(
      "form",
      { method: "dialog" },
      el("h2", { text: title, id: "question" }),
      text ? el("p", { text }) : null,
      el("div", { class: "fields" }, ...inputs),
      el(
        "div",
        { class: "buttons" },
        button("Cancel", () => leave(null)),
        el("button", { type: "submit", class: danger ? "danger" : "primary", text: yes }),
      ),
    );
    const dialog = el("dialog", { class: "question", "aria-labelledby": "question" }, form);
    const leave = (answer) => {
      dialog.remove();
      leaveOpen = () => {};
      before?.focus?.();
      resolve(answer);
    };
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      leave(Object.fromEntries(Object.keys(fields).map((name) => [name, form.elements[name].value.trim()])));
    });
    dialog.addEventListener("keydown", (event) => event.key === "Escape" && leave(null));
    leaveOpen(null);
    leaveOpen = leave;
    document.body.append(dialog);
    dialog.show(); // not modal: STOP stays in reach
    (form.querySelector("input") ?? form.querySelector("button")).focus();
    form.querySelector("input")?.select();
  });
}

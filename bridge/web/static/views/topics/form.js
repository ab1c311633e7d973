// A form made from a message definition: typed and nested fields, arrays, and constants to choose from.

import { button, el, icon, mark, write } from "../../lib/dom.js";

const MOST_FIXED = 36; // maximum elements of a fixed array of structures that is shown
const FEW = 8; // maximum fields of a nested message that is open at first
const NOT_NUMBERS = { nan: "NaN", inf: "Infinity", infinity: "Infinity", "-inf": "-Infinity", "-infinity": "-Infinity" };
const WHOLE = { byte: [0, 255], char: [0, 255] };
for (const bits of [8, 16, 32, 64]) {
  WHOLE[`int${bits}`] = [-(2 ** (bits - 1)), 2 ** (bits - 1) - 1];
  WHOLE[`uint${bits}`] = [0, 2 ** bits - 1];
}
let lists = 0; // number of lists of constants so far, for their ids

/** An invalid field; `input` is its element. */
class FieldError extends Error {
  constructor(input, text) {
    super(text);
    this.input = input;
  }
}

/**
 * A form: {element, read()}. `definition` comes from the console; `read` returns the message or, if a field is invalid,
 * shows that and returns null.
 */
export function messageForm(definition) {
  const body = structure(definition, definition.root, "");
  const wrong = el("p", { class: "form-wrong", role: "alert" });
  return {
    element: el("div", { class: "fields" }, body.element, wrong),
    read() {
      write(wrong, "");
      for (const input of body.element.querySelectorAll("[aria-invalid]")) mark(input, "aria-invalid", null);
      try {
        return body.read();
      } catch (error) {
        if (!(error instanceof FieldError)) throw error;
        write(wrong, error.message);
        mark(error.input, "aria-invalid", "true");
        for (let around = error.input.closest("details"); around; around = around.parentElement.closest("details")) around.open = true;
        error.input.focus();
        return null;
      }
    },
  };
}

function structure(definition, name, path) {
  const { fields, constants } = definition.types[name];
  const parts = fields.map((field) => [field.name, editor(definition, field, constants, path ? `${path}.${field.name}` : field.name)]);
  const element = el("div", { class: "structure" }, ...parts.map(([, part]) => part.element));
  if (!parts.length) element.append(el("p", { class: "empty", text: "No fields." }));
  return { element, read: () => Object.fromEntries(parts.map(([key, part]) => [key, part.read()])) };
}

function editor(definition, field, constants, path) {
  const nested = field.base in definition.types;
  if (field.shape === "single") return nested ? branch(definition, field, path) : one(field, constants, path);
  return nested ? several(definition, field, path) : values(field, path);
}

const typeOf = ({ base, shape, length }) => base + (shape === "single" ? "" : shape === "array" ? `[${length}]` : length ? `[<=${length}]` : "[]");

const labeled = (field, input) => el("label", { class: "entry" },
  el("span", { class: "key", text: field.name }), input, el("span", { class: "second", text: typeOf(field) }));

function branch(definition, field, path) {
  const inner = structure(definition, field.base, path);
  const open = definition.types[field.base].fields.length <= FEW;
  return { element: el("details", { open }, el("summary", {}, el("span", { class: "key", text: field.name }), " ", el("span", { class: "second", text: field.base })), inner.element), read: inner.read };
}

/** A field of one value. */
function one(field, constants, path) {
  if (field.base === "bool") {
    const choice = el("select", {}, ...[false, true].map((value) => el("option", { value: String(value), text: String(value), selected: value === field.default })));
    return { element: labeled(field, choice), read: () => choice.value === "true" };
  }
  const text = field.base.includes("string");
  const offered = text ? null : constantList(field, constants);
  const input = el("input", { type: "text", autocomplete: "off", spellcheck: "false", value: field.default ?? (text ? "" : 0),
    inputmode: text ? null : field.base.startsWith("float") || WHOLE[field.base]?.[0] < 0 ? "text" : "numeric", list: offered?.id });
  const element = labeled(field, input);
  if (offered) element.append(offered);
  return { element, read: () => parsed(field, input.value, input, path) };
}

/** The constants for a field: those whose names contain the field's name, else all of its type. */
function constantList(field, constants) {
  const same = constants.filter(({ base }) => base === field.base);
  const named = same.filter(({ name }) => name.toLowerCase().includes(field.name.toLowerCase()));
  const shown = named.length ? named : same;
  return shown.length ? el("datalist", { id: `constants-${++lists}` }, ...shown.map(({ name, value }) => el("option", { value, label: name, text: `${value} ${name}` }))) : null;
}

/** An array of plain values, in one line. */
function values(field, path) {
  const text = field.base.includes("string");
  const begin = field.default ?? (field.shape === "array" ? Array(field.length).fill(text ? "" : field.base === "bool" ? false : 0) : []);
  const how = text ? "one per line" : "separated by commas";
  const input = text ? el("textarea", { rows: "3", spellcheck: "false", placeholder: how }) : el("input", { type: "text", autocomplete: "off", placeholder: how });
  input.value = begin.join(text ? "\n" : ", ");
  const split = () => (input.value === "" && field.shape !== "array" ? [] : input.value.split(text ? "\n" : /[\s,;]+/));
  return {
    element: labeled(field, input),
    read() {
      const items = split().map((each, i) => parsed(field, text ? each : each.trim(), input, `${path}[${i}]`));
      counted(field, items.length, input, path);
      return items;
    },
  };
}

/** An array of structures, whose elements can be added and removed. */
function several(definition, field, path) {
  const fixed = field.shape === "array";
  const items = [];
  const list = el("div", { class: "structures" });
  const add = button("Add", () => more(), { "aria-label": `Add one to ${field.name}` });
  const more = () => {
    const part = structure(definition, field.base, `${path}[${items.length}]`);
    const row = el("div", { class: "item" }, part.element);
    if (!fixed) row.append(button("×", () => {
      items.splice(items.indexOf(part), 1);
      row.remove();
    }, { class: "close", "aria-label": `Remove one from ${field.name}` }));
    items.push(part);
    list.append(row);
  };
  const element = el("details", { open: !fixed }, el("summary", {}, el("span", { class: "key", text: field.name }), " ", el("span", { class: "second", text: typeOf(field) })), list, fixed ? null : add);
  if (fixed && field.length <= MOST_FIXED) for (let i = 0; i < field.length; i++) more();
  return {
    element,
    read() {
      if (fixed && !items.length) return Array.from({ length: field.length }, () => ({})); // too many to show, so all have defaults
      counted(field, items.length, add, path);
      return items.map((each) => each.read());
    },
  };
}

function counted(field, count, input, path) {
  if (field.shape === "array" && count !== field.length) throw new FieldError(input, `${path} has ${field.length} elements, not ${count}.`);
  if (field.shape === "sequence" && field.length && count > field.length) throw new FieldError(input, `${path} has at most ${field.length} elements, not ${count}.`);
}

function parsed({ base, bound }, text, input, path) {
  if (base.includes("string")) {
    if (bound && text.length > bound) throw new FieldError(input, `${path} has at most ${bound} characters, not ${text.length}.`);
    return text;
  }
  if (base === "bool") {
    if (!/^(true|false|0|1)$/i.test(text)) throw new FieldError(input, `${path} must be true or false, not “${text}”.`);
    return /^(true|1)$/i.test(text);
  }
  const word = text.trim().toLowerCase();
  const value = word === "" ? NaN : Number(word);
  if (base.startsWith("float")) {
    if (Object.hasOwn(NOT_NUMBERS, word)) return NOT_NUMBERS[word];
    if (Math.abs(value) > Number.MAX_VALUE) throw new FieldError(input, `${path} must be between -1.8e308 and 1.8e308, not “${text}”; write inf or -inf for infinity.`);
    if (!Number.isFinite(value)) throw new FieldError(input, `${path} must be a number, not “${text}”.`);
    return value;
  }
  const [least, most] = WHOLE[base] ?? [-Infinity, Infinity];
  if (!Number.isInteger(value) || value < least || value > most) throw new FieldError(input, `${path} must be an integer from ${least} to ${most} (${base}), not “${text}”.`);
  if (!Number.isSafeInteger(value)) throw new FieldError(input, `${path}: the browser represents integers exactly only up to ${Number.MAX_SAFE_INTEGER}; send “${text}” with 'midspan topic pub'.`);
  return value;
}

/**
 * A block that sends its form's content on each press: {element, open(definition), close()}.
 * `label` names the button, `send(message)` sends and may reject with an Error.
 */
export function sendBlock(label, send) {
  const fields = el("div");
  let form = null;
  const go = el("button", { type: "submit", class: "primary", text: label });
  const outcome = el("p", { class: "outcome", role: "status" });
  const element = el("form", { class: "sending drives", hidden: true, novalidate: true, on: { submit: press } }, fields, el("div", { class: "buttons" }, go, outcome));

  async function press(event) {
    event.preventDefault();
    if (go.disabled || form === null) return;
    const message = form.read();
    if (message === null) return;
    const mine = form;
    go.disabled = true;
    write(outcome, "Sending …");
    mark(outcome, "data-mood", null);
    let [words, mood] = ["", null];
    try {
      words = await send(message);
    } catch (error) {
      [words, mood] = [error.message, "bad"];
    }
    go.disabled = false;
    if (mine !== form) return;
    write(outcome, words);
    mark(outcome, "data-mood", mood);
  }

  return {
    element,
    open(definition) {
      form = messageForm(definition);
      fields.replaceChildren(form.element);
      write(outcome, "");
      element.hidden = false;
    },
    close() {
      form = null;
      fields.replaceChildren();
      element.hidden = true;
    },
  };
}

/** A button that opens and closes a form, after requesting its definition: {element, close()}. */
export function opener(label, socket, block, ask, failed) {
  let wanted = 0;
  const element = button(undefined, async () => {
    if (element.getAttribute("aria-expanded") === "true") return close();
    const mine = ++wanted;
    mark(element, "aria-expanded", "true");
    try {
      const definition = await socket.call("definition", ask());
      if (mine === wanted) block.open(definition);
    } catch (error) {
      if (mine !== wanted) return;
      close();
      failed(error.message);
    }
  }, { "aria-expanded": "false", class: "opens" });
  element.append(icon("M9 6l6 6-6 6"), label);
  const close = () => {
    wanted++;
    mark(element, "aria-expanded", "false");
    block.close();
  };
  return { element, close };
}

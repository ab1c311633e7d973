// Creates elements. Text from robots is inserted only as text, never as markup.

const SVG = "http://www.w3.org/2000/svg";

/** An element: `text`, `on` (listeners by event) and attributes; true sets an attribute without a value. */
export function el(tag, { text, on = {}, ...attributes } = {}, ...children) {
  return filled(document.createElement(tag), text, on, attributes, children);
}

/** An SVG element, with the same arguments as `el`. */
export function svg(tag, { text, on = {}, ...attributes } = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), text, on, attributes, children);
}

function filled(element, text, on, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(name, value === true ? "" : value);
    }
  }
  for (const [event, listener] of Object.entries(on)) element.addEventListener(event, listener);
  if (text !== undefined) element.textContent = text;
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** A button with a text. */
export function button(text, pressed, attributes = {}) {
  return el("button", { type: "button", text, on: { click: pressed }, ...attributes });
}

/** An icon of one path, 24 x 24, for a button with a separate label. */
export function icon(d) {
  return svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true", class: "icon" }, svg("path", { d }));
}

/** Write a text only if it has changed, so that constant values cost nothing. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Set or remove an attribute, only if it has changed. */
export function mark(element, name, value) {
  const old = element.getAttribute(name);
  if (value === null || value === undefined || value === false) {
    if (old !== null) element.removeAttribute(name);
  } else if (old !== String(value)) {
    element.setAttribute(name, value);
  }
}

/**
 * Update the children of `parent` so that there is one for each of `items`; a row stays as long as its key exists.
 * `key` names an item, `make` creates its row (an element), `fill` writes an item's values into a row.
 */
export function rows(parent, items, key, make, fill) {
  const old = new Map();
  for (const row of [...parent.children]) {
    old.get(row.dataset.key)?.remove(); // two items with one key: their rows are created again
    old.set(row.dataset.key, row);
  }
  let next = parent.firstElementChild;
  for (const item of items) {
    const name = key(item);
    let row = old.get(name);
    if (row === undefined) {
      row = make(item);
      row.dataset.key = name;
    } else {
      old.delete(name);
    }
    if (row === next) next = next.nextElementSibling;
    else parent.insertBefore(row, next);
    fill(row, item);
  }
  for (const row of old.values()) row.remove();
}

/** Whether key presses are text input now. */
export function types(target) {
  return target instanceof Element
    && (target.isContentEditable || target.matches("textarea, select, input:not([type=range]):not([type=checkbox])"));
}

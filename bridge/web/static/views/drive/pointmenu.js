// The small menu at a point of the map.

import { button, el } from "../../lib/dom.js";

/** A menu inside `parent`; `closed` is called when it closes. */
export class PointMenu {
  constructor(parent, closed) {
    this.parent = parent;
    this.closed = closed;
    this.element = null;
    addEventListener("pointerdown", (event) => this.element?.contains(event.target) || this.close());
  }

  /** Open the menu at a pixel; `choices`: [[text, action, attributes], ...]. */
  open(title, [x, y], choices) {
    this.close(false);
    const items = choices.map(([words, action, attributes]) =>
      button(words, () => {
        this.close();
        action();
      }, { role: "menuitem", ...attributes }));
    this.element = el("div", { class: "pointmenu", role: "menu", "aria-label": title, on: { keydown: (event) => this.key(event) } },
      el("p", { text: title }), ...items);
    this.parent.append(this.element);
    const { clientWidth: wide, clientHeight: high } = this.parent;
    const { offsetWidth: width, offsetHeight: height } = this.element;
    const left = x + 16 + width > wide ? x - 16 - width : x + 16;
    this.element.style.setProperty("left", `${Math.max(8, Math.min(left, wide - width - 8))}px`);
    this.element.style.setProperty("top", `${Math.max(8, Math.min(y - 20, high - height - 8))}px`);
    items.find((item) => !item.disabled)?.focus({ preventScroll: true });
  }

  close(notify = true) {
    if (this.element === null) return;
    this.element.remove();
    this.element = null;
    if (notify) this.closed();
  }

  key(event) {
    const items = [...this.element.querySelectorAll("button:enabled")];
    const at = items.indexOf(document.activeElement);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: -1 }[event.key];
    if (event.key === "Escape") {
      event.stopPropagation();
      this.close();
      this.parent.querySelector("canvas").focus();
    } else if (to !== undefined) {
      event.preventDefault();
      items.at(to % items.length).focus();
    }
  }
}

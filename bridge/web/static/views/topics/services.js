// One service: its type, a form to call it, the reply.

import { el, write } from "../../lib/dom.js";
import { opener, sendBlock } from "./form.js";
import { notify } from "../../lib/messages.js";
import { Tree } from "./tree.js";

/** The block of one service: {element, choose(name@type)}; the empty name closes it. */
export function serviceBlock(socket) {
  const title = el("h2");
  const type = el("p", { class: "second" });
  const reply = el("div", { class: "message" });
  let [name, kind] = ["", ""];
  const block = sendBlock("Call", async (request) => {
    reply.replaceChildren();
    const mine = name;
    const found = await socket.call("call_service", { name, type: kind, request });
    if (mine !== name) return "";
    const tree = new Tree(new Map(), () => false, () => {});
    tree.fill(found);
    reply.append(tree.element);
    return Object.keys(found).length ? "Reply:" : "Done; the reply has no fields.";
  });
  const form = opener("Call …", socket, block, () => ({ type: kind, kind: "service" }), (why) => notify(why, { bad: true }));
  const element = el("section", { class: "block topic", "aria-label": "Service", hidden: true },
    el("div", { class: "heading" }, el("a", { href: "#topics/services", class: "back", text: "All services" }), title, form.element),
    type, block.element, reply);

  /** Choose a service to call; its form opens once there is a connection. */
  function begin() {
    if (socket.open) form.element.click();
    else socket.addEventListener("state", () => name && form.element.getAttribute("aria-expanded") === "false" && begin(), { once: true });
  }

  return {
    element,
    choose(chosen) {
      const [next, of = ""] = chosen.split("@");
      if (next === name && of === kind) return;
      [name, kind] = [next, of];
      form.close();
      reply.replaceChildren();
      element.hidden = !name;
      write(title, name);
      write(type, kind);
      if (name) begin();
    },
  };
}

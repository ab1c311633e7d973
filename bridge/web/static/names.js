// Names in the store: asked for, changed, deleted. `kind`: `location`, `area` or `path`.

import { ask, question } from "./say.js";

export const LONGEST_NAME = 64;

const WORDS = { location: "place", area: "area", path: "path" };
const FEED = { location: "locations", area: "areas", path: "paths" };
const AFTER = {
  location: "Nobody can be sent there by name any more.",
  area: "What it asks of robots no longer holds.",
  path: "Nobody can follow it by name any more.",
};

/** Whether `places` (the feed's value, if it is known) has a name. */
const has = (places, kind, name) => Object.hasOwn(places?.[FEED[kind]] ?? {}, name);

/**
 * Keep something under a name; `places` tells which names are taken: the operator decides whether it takes the place of one.
 * Resolves to whether it is kept.
 */
export async function keep(socket, places, kind, verb, args, done) {
  const { name } = args;
  let replace = false;
  if (has(places, kind, name)) {
    replace = Boolean(await question(`Replace ${name}?`, {}, "Replace", { text: `There is a ${WORDS[kind]} of this name.`, danger: true }));
    if (!replace) return false;
  }
  return ask(socket, `Keep ${name}`, verb, replace ? { ...args, replace } : args, done);
}

/** Give it another name. */
export async function rename(socket, kind, name) {
  const answer = await question(`Rename ${name}`, { to: { label: "New name", value: name, maxlength: LONGEST_NAME } }, "Rename");
  if (answer && answer.to !== name) {
    await ask(socket, `Rename ${name}`, "rename_place", { name, to: answer.to, kind }, `${name} is called ${answer.to} now.`);
  }
}

/** Delete it, once the operator is sure. */
export async function remove(socket, kind, name) {
  const sure = await question(`Delete ${name}?`, {}, "Delete", { text: AFTER[kind], danger: true });
  if (sure) await ask(socket, `Delete ${name}`, "delete_place", { name, kind }, `Deleted ${name}.`);
}

// Names in the store: save, rename, delete. `kind`: `location`, `area` or `path`.

import { ask, question } from "./messages.js";

export const LONGEST_NAME = 64;

const WORDS = { location: "place", area: "area", path: "path" };
const FEED = { location: "locations", area: "areas", path: "paths" };
const AFTER = {
  location: "It can no longer be a goal by name.",
  area: "Its rules for robots are deleted too.",
  path: "It can no longer be followed by name.",
};

/** Whether `places` (the feed's value, if known) contains this name. */
const has = (places, kind, name) => Object.hasOwn(places?.[FEED[kind]] ?? {}, name);

/**
 * Whether a named object is on the current map (its name, "" if none is chosen), as the gateway decides: without a
 * current map, every object is; the name of the frame stands for the current map.
 */
export const isHere = (socket, current, { map }) => !current || !map || map === current || map === socket.hello?.frame;

/**
 * Save something under a name; if `places` already has the name, the operator decides whether to replace its owner.
 * Resolves to whether it was saved.
 */
export async function keep(socket, places, kind, verb, args, done) {
  const { name } = args;
  let replace = false;
  if (has(places, kind, name)) {
    replace = Boolean(await question(`Replace ${name}?`, {}, "Replace", { text: `Another ${WORDS[kind]} has this name.`, danger: true }));
    if (!replace) return false;
  }
  return ask(socket, `Save ${name}`, verb, replace ? { ...args, replace } : args, done);
}

/** Rename it. */
export async function rename(socket, kind, name) {
  const answer = await question(`Rename ${name}`, { to: { label: "New name", value: name, maxlength: LONGEST_NAME } }, "Rename");
  if (answer && answer.to !== name) {
    await ask(socket, `Rename ${name}`, "rename_place", { name, to: answer.to, kind }, `Renamed ${name} to ${answer.to}.`);
  }
}

/** Delete it, after confirmation. */
export async function remove(socket, kind, name) {
  const sure = await question(`Delete ${name}?`, {}, "Delete", { text: AFTER[kind], danger: true });
  if (sure) await ask(socket, `Delete ${name}`, "delete_place", { name, kind }, `Deleted ${name}.`);
}

// Commands for a pose on the map: drive there, set the robot's pose, save it as a place.

import { degrees, position } from "./format.js";
import { keep, LONGEST_NAME } from "./names.js";
import { ask, question, notify } from "./messages.js";

const inDegrees = (theta) => String(Math.round((theta * 180) / Math.PI));

/** Parse a typed number with decimal point or comma; NaN if invalid. */
const typed = (text) => (text === "" ? NaN : Number(text.replace(",", ".").replace("°", "")));

function poseFields({ x, y, theta }, headingNeeded) {
  const numeric = { inputmode: "text", pattern: "\\s*[\\-+]?[0-9]*[.,]?[0-9]+\\s*°?\\s*", title: "a number" };
  return {
    x: { label: "x, meters", value: x.toFixed(2), ...numeric },
    y: { label: "y, meters", value: y.toFixed(2), ...numeric },
    theta: {
      label: headingNeeded ? "Heading, degrees" : "Heading, degrees (empty: any)",
      value: theta === undefined ? "" : inDegrees(theta), ...numeric, required: headingNeeded,
    },
  };
}

function poseOf(answer) {
  const pose = { x: typed(answer.x), y: typed(answer.y) };
  if (answer.theta !== "") pose.theta = (typed(answer.theta) * Math.PI) / 180;
  if (Object.values(pose).every(Number.isFinite)) return pose;
  notify("Invalid position: enter numbers.", { bad: true });
  return null;
}

const words = ({ x, y, theta }) => position(x, y) + (theta === undefined ? "" : `, heading ${degrees(theta)}`);

/** Drive to a pose. */
export const goTo = (socket, pose) => ask(socket, `Go to ${words(pose)}`, "goto", pose, `Driving to ${words(pose)}.`);

/** Drive to a named place. */
export const goToPlace = (socket, name) => ask(socket, `Go to ${name}`, "goto_place", { name }, `Driving to ${name}.`);

/** Drive to a typed pose. */
export async function goToTyped(socket, pose) {
  const answer = await question("Go here", poseFields(pose, false), "Go");
  const wanted = answer && poseOf(answer);
  if (wanted) await goTo(socket, wanted);
}

/** Set the robot's pose; asks for the heading if `pose` has none. */
export async function robotIsAt(socket, pose, heading = 0) {
  let known = pose;
  if (pose.theta === undefined) {
    const answer = await question("Robot is here", poseFields({ ...pose, theta: heading }, true), "Set");
    known = answer && poseOf(answer);
  }
  if (known) await ask(socket, `Robot is at ${words(known)}`, "set_pose", known);
}

/** Save a pose under a name that the operator enters; `places` as in `keep`. */
export async function keepPlace(socket, places, pose, heading = 0) {
  const fields = {
    name: { label: "Name", value: "", maxlength: LONGEST_NAME },
    ...poseFields({ ...pose, theta: pose.theta ?? heading }, true),
  };
  const answer = await question("Save this place", fields, "Save");
  const kept = answer && poseOf(answer);
  if (!kept) return;
  await keep(socket, places, "location", "keep_place", { name: answer.name, ...kept }, `Saved ${answer.name} at ${words(kept)}.`);
}

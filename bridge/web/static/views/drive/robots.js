// Other robots on the map, each in a different color.

import { drawPath, drawRobot } from "./scene.js";

const COLORS = 6; // --robot-0 to --robot-5

/** The robots of the feed `robots` with a known pose: [{name, pose, footprint, path, ink}]. */
export const seen = (robots, color) =>
  (robots ?? []).map((robot, i) => ({ ...robot, ink: color[`robot-${i % COLORS}`] })).filter(({ pose }) => pose);

/** Draw the robots. `paths`: whether to draw their paths; `old`: the connection is lost, so they may be elsewhere. */
export function drawRobots(context, view, robots, color, paths, old) {
  for (const { ink, path, pose } of robots) if (paths) drawPath(context, view, path, pose, { ...color, path: ink });
  for (const robot of robots) drawRobot(context, view, robot, { ...color, accent: robot.ink }, old);
}

export function drawRobotNames(labels, view, robots) {
  for (const { name, pose, ink } of robots) {
    const [x, y] = view.to(pose.x, pose.y);
    labels.put(name, [[x + 14, y + 5], [x - 14, y + 5, "right"], [x + 14, y - 12]], ink);
  }
}

// The robot's state as text.

const STATES = {
  idle: "Standing",
  preparing_before_move: "Preparing",
  moving: "Driving",
  waiting_obstacle: "Waiting for an obstacle",
  goal_reached: "Arrived",
  aborted: "Goal aborted",
  failing: "Failing",
  paused: "Paused",
  thinking: "Planning",
  error: "Error",
};

const BUSY = new Set(["preparing_before_move", "moving", "waiting_obstacle", "thinking"]);
const BAD = new Set(["aborted", "failing", "error"]);

/** The state of `driving` as text. */
export const stateWords = (driving) => STATES[driving.state] ?? String(driving.state).replaceAll("_", " ");

/** Whether the robot is driving. */
export const isBusy = (driving) => BUSY.has(driving?.state);

/** The state's style: `busy`, `bad`, `held` or `calm`. */
export function mood(driving) {
  if (BAD.has(driving?.state)) return "bad";
  if (driving?.state === "paused" || driving?.state === "waiting_obstacle") return "held";
  return isBusy(driving) ? "busy" : "calm";
}

// What the robot does, in words.

const STATES = {
  idle: "Standing",
  preparing_before_move: "Getting ready",
  moving: "Driving",
  waiting_obstacle: "Waiting: something is in the way",
  goal_reached: "Arrived",
  aborted: "Gave up the goal",
  failing: "In trouble",
  paused: "Paused",
  thinking: "Planning",
  error: "Error",
};

const BUSY = new Set(["preparing_before_move", "moving", "waiting_obstacle", "thinking"]);
const BAD = new Set(["aborted", "failing", "error"]);

/** The state of `driving`, in words. */
export const stateWords = (driving) => STATES[driving.state] ?? String(driving.state).replaceAll("_", " ");

/** Whether it is on its way. */
export const isBusy = (driving) => BUSY.has(driving?.state);

/** How the state looks: `busy`, `bad`, `held` or `calm`. */
export function mood(driving) {
  if (BAD.has(driving?.state)) return "bad";
  if (driving?.state === "paused" || driving?.state === "waiting_obstacle") return "held";
  return isBusy(driving) ? "busy" : "calm";
}

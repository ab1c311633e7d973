// The way that the robot has come since its drive began, as far as this page saw it.

const STEP = 0.1; // metres between two points
const MOST = 1000; // points; of a longer way every second is kept

/** Takes what the feeds say; `points` is x, y, x, y ... */
export class Trail {
  constructor() {
    this.points = [];
    this.goal = "";
  }

  /** A new goal begins a new trail; one that ended stays in sight until the next. */
  driving(value) {
    const goal = value?.goal ? `${value.goal.x} ${value.goal.y}` : "";
    if (goal && goal !== this.goal) this.points = [];
    this.goal = goal;
  }

  robot(pose) {
    if (!this.goal || !pose) return;
    const [x, y] = this.points.slice(-2);
    if (x !== undefined && Math.hypot(pose.x - x, pose.y - y) < STEP) return;
    this.points.push(pose.x, pose.y);
    if (this.points.length > 2 * MOST) this.points = this.points.filter((_, i) => i % 4 < 2);
  }
}

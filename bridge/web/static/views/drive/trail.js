// The robot's trail since the start of its current drive, as far as this page has received it.

const STEP = 0.1; // meters between two points
const MOST = 1000; // maximum number of points; a trail that exceeds it keeps only every second point

/** Receives the feeds' values; `points` is x, y, x, y ... */
export class Trail {
  constructor() {
    this.points = [];
    this.goal = "";
  }

  /** Start a new trail if there is a new goal; until then, the trail of the last goal stays visible. */
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

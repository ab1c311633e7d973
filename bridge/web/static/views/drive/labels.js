// Names on the map without overlaps: earlier names take precedence.

const FONT = "13px system-ui, sans-serif";
const HIGH = 16; // px, the height of a line
const LONGEST = 24; // maximum letters of a name

/** The names in one drawing of the map. */
export class Labels {
  /** `width`: the window's width in pixels; names stay within it. */
  constructor(context, width, color) {
    this.context = context;
    this.width = width;
    this.color = color;
    this.taken = []; // boxes [left, top, right, bottom]
  }

  /** Write a name at the first of `spots` ([x, y, align]) that is free, or not at all. */
  put(name, spots, ink, most = Infinity) {
    const { context, color } = this;
    const text = name.length > LONGEST ? `${name.slice(0, LONGEST)}…` : name;
    context.font = FONT;
    const wide = context.measureText(text).width;
    if (wide > most) return;
    for (const [x, y, align] of spots) {
      const left = align === "right" ? x - wide : x;
      const box = [left - 2, y - HIGH + 3, left + wide + 2, y + 3];
      if (box[0] < 0 || box[2] > this.width) continue;
      if (this.taken.some((other) => overlap(box, other))) continue;
      this.taken.push(box);
      context.textAlign = "left";
      context.textBaseline = "alphabetic";
      context.lineJoin = "round";
      context.lineWidth = 4;
      context.strokeStyle = color.halo;
      context.strokeText(text, left, y);
      context.fillStyle = ink;
      context.fillText(text, left, y);
      return;
    }
  }
}

const overlap = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];

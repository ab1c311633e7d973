// The image of a map in several sizes, so that panning a large one costs what the window shows and no more.

const SMALLEST = 512; // an image is halved until no side is longer

/** An image of a map; `dark`: light walls on a dark floor. */
export class MapImage {
  constructor(url, dark) {
    this.url = url;
    this.dark = dark;
    this.levels = []; // each half the one before
  }

  /** Fetch it; rejects with an Error in words. */
  async load() {
    const reply = await fetch(this.dark ? `${this.url}&dark` : this.url);
    if (!reply.ok) throw new Error(`the image of the map did not come (${reply.status})`);
    const whole = await createImageBitmap(await reply.blob());
    const levels = [whole];
    for (let last = whole; Math.max(last.width, last.height) > SMALLEST;) {
      last = halved(levels.at(-1));
      levels.push(last);
    }
    this.levels = levels;
  }

  /** Let its memory go. */
  close() {
    for (const level of this.levels) level.close?.();
    this.levels = [];
  }

  /**
   * Draw the part that the window shows. The context's transform is that of the image: one unit is one cell, the
   * first row on top; `scale`: device pixels a cell; `part`: the cells in sight, {left, top, right, bottom}.
   */
  draw(context, scale, part) {
    if (!this.levels.length) return;
    const wanted = Math.max(0, Math.floor(Math.log2(1 / scale)));
    const level = Math.min(wanted, this.levels.length - 1);
    const image = this.levels[level];
    const [acrossX, acrossY] = [image.width / this.levels[0].width, image.height / this.levels[0].height];
    const left = Math.max(0, Math.floor(part.left * acrossX));
    const top = Math.max(0, Math.floor(part.top * acrossY));
    const right = Math.min(image.width, Math.ceil(part.right * acrossX));
    const bottom = Math.min(image.height, Math.ceil(part.bottom * acrossY));
    if (right <= left || bottom <= top) return;
    context.imageSmoothingEnabled = scale < 1;
    context.drawImage(
      image, left, top, right - left, bottom - top,
      left / acrossX, top / acrossY, (right - left) / acrossX, (bottom - top) / acrossY,
    );
  }
}

function canvas(width, height) {
  const made = document.createElement("canvas");
  made.width = width;
  made.height = height;
  return made;
}

function halved(image) {
  const half = canvas(Math.max(1, image.width >> 1), Math.max(1, image.height >> 1));
  const context = half.getContext("2d");
  context.imageSmoothingQuality = "high";
  context.drawImage(image, 0, 0, half.width, half.height);
  return half;
}

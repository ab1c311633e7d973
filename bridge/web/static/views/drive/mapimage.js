// The image of a map in several sizes, so that the cost of panning depends only on the window.

const SMALLEST = 512; // an image is halved until no side is longer

/** An image of a map, composed of tiles; `dark`: light walls on a dark floor. */
export class MapImage {
  constructor({ name, width, height }, dark) {
    Object.assign(this, { name, width, height, dark });
    this.levels = [canvas(width, height)]; // each level has half the size of the previous one
    for (let [w, h] = [width, height]; Math.max(w, h) > SMALLEST;) {
      [w, h] = [w, h].map((side) => Math.max(1, side >> 1));
      this.levels.push(canvas(w, h));
    }
    this.tiles = new Map(); // position -> the address of the tile that is drawn or being fetched; null: no tile
  }

  /** Whether this is the image of a map in these colors. */
  fits({ name, width, height }, dark) {
    return this.name === name && this.width === width && this.height === height && this.dark === dark;
  }

  /** Fetch the changed tiles; `drawn` is called after each. Rejects with an Error. */
  async update({ size, tiles }, drawn) {
    const all = tiles.flatMap((row, y) => row.map((address, x) => this.tile(address, x * size, y * size, size, drawn)));
    await Promise.all(all);
  }

  async tile(address, left, top, size, drawn) {
    const where = `${left}/${top}`;
    if ((this.tiles.get(where) ?? null) === address) return;
    this.tiles.set(where, address);
    let image = null;
    if (address !== null) {
      try {
        image = await fetched(this.dark ? `${address}&dark` : address);
      } catch (error) {
        if (this.tiles.get(where) === address) this.tiles.set(where, ""); // the feed's next value tries again
        throw error;
      }
    }
    if (this.tiles.get(where) === address && this.levels.length) {
      this.put(image, left, top, size);
      drawn();
    }
    image?.close();
  }

  put(image, left, top, size) {
    let [x, y, w, h] = [left, top, Math.min(size, this.width - left), Math.min(size, this.height - top)];
    let source = image && [image, 0, 0, image.width, image.height];
    for (const level of this.levels) {
      const context = level.getContext("2d");
      context.clearRect(x, y, w, h);
      if (source) {
        context.imageSmoothingQuality = "high";
        context.drawImage(...source, x, y, w, h);
        source = [level, x, y, w, h];
      }
      [x, y, w, h] = [x / 2, y / 2, w / 2, h / 2];
    }
  }

  /** Release the image's memory. */
  close() {
    for (const level of this.levels) level.width = level.height = 0;
    this.levels = [];
  }

  /**
   * Draw the part that the window shows. The context's transform is that of the image: one unit is one cell, the
   * first row is at the top. `scale`: device pixels per cell; `part`: the visible cells, {left, top, right, bottom}.
   */
  draw(context, scale, part) {
    if (!this.levels.length) return;
    const wanted = Math.max(0, Math.floor(Math.log2(1 / scale)));
    const level = Math.min(wanted, this.levels.length - 1);
    const image = this.levels[level];
    const [acrossX, acrossY] = [image.width / this.width, image.height / this.height];
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

async function fetched(address) {
  const reply = await fetch(address);
  if (!reply.ok) throw new Error(`cannot load a part of the map (${reply.status})`);
  return createImageBitmap(await reply.blob());
}

function canvas(width, height) {
  const made = document.createElement("canvas");
  made.width = width;
  made.height = height;
  return made;
}

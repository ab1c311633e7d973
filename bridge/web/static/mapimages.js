// The images of the map in use: its occupancy, and its flags over it.

import { MapImage } from "./mapimage.js";
import { say } from "./say.js";
import { toCells } from "./viewport.js";

/** Loads them as they change; the old ones stay in sight until the new ones are there. `loaded` is called then. */
export class MapImages {
  constructor(loaded) {
    this.loaded = loaded;
    this.wanted = {}; // layer -> {url, dark} of the newest image
    this.shown = {}; // layer -> the image that is drawn
  }

  /** Show a map (or none), with its flags or without, in the dark theme or the light one. */
  show(map, flags, dark) {
    this.want("image", map?.image, dark);
    this.want("flags", flags ? map?.flags : null, false);
  }

  want(layer, url, dark) {
    const old = this.wanted[layer];
    if (old?.url === (url ?? undefined) && (old === undefined || old.dark === dark)) return;
    if (!url) {
      delete this.wanted[layer];
      this.replace(layer, undefined);
      return;
    }
    const made = new MapImage(url, dark);
    this.wanted[layer] = made;
    made.load().then(
      () => (made === this.wanted[layer] ? this.replace(layer, made) : made.close()),
      (error) => {
        if (made !== this.wanted[layer]) return;
        delete this.wanted[layer]; // the map's next value tries again
        say(`Map: ${error.message}`, { bad: true });
      },
    );
  }

  replace(layer, image) {
    this.shown[layer]?.close();
    this.shown[layer] = image;
    this.loaded();
  }

  /** Draw them; `ratio`: device pixels a CSS pixel. */
  draw(context, view, map, ratio) {
    for (const image of [this.shown.image, this.shown.flags]) {
      if (image === undefined) continue;
      const { scale, part } = toCells(context, view, map, ratio);
      image.draw(context, scale, part);
    }
  }
}

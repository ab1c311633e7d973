// The images of the current map: its occupancy, with its flags on top.

import { MapImage } from "./mapimage.js";
import { notify } from "../../lib/messages.js";
import { toCells } from "./viewport.js";

/** Loads changed tiles; a map's image stays visible until another map's image is loaded. `loaded()` draws. */
export class MapImages {
  constructor(loaded) {
    this.loaded = loaded;
    this.wanted = {}; // layer -> the newest image
    this.shown = {}; // layer -> the image that is drawn
  }

  /** Show a map (or none), with or without its flags, in the dark or the light theme. */
  show(map, flags, dark) {
    this.want("image", map, map?.image, dark);
    this.want("flags", map, flags ? map?.flags : null, false);
  }

  want(layer, map, picture, dark) {
    if (!picture) {
      delete this.wanted[layer];
      this.replace(layer, undefined);
      return;
    }
    const known = [this.wanted[layer], this.shown[layer]].find((image) => image?.fits(map, dark));
    const image = known ?? new MapImage(map, dark);
    if (this.wanted[layer] !== image && this.wanted[layer] !== this.shown[layer]) this.wanted[layer]?.close();
    this.wanted[layer] = image;
    if (this.shown[layer] === undefined) this.replace(layer, image);
    image.update(picture, () => image === this.shown[layer] && this.loaded()).then(
      () => image === this.wanted[layer] && this.replace(layer, image),
      (error) => image === this.wanted[layer] && notify(`Map: ${error.message}`, { bad: true }),
    );
  }

  replace(layer, image) {
    if (this.shown[layer] !== image) this.shown[layer]?.close();
    this.shown[layer] = image;
    this.loaded();
  }

  /** Draw the images; `ratio`: device pixels per CSS pixel. */
  draw(context, view, map, ratio) {
    for (const image of [this.shown.image, this.shown.flags]) {
      if (image === undefined) continue;
      const { scale, part } = toCells(context, view, map, ratio);
      image.draw(context, scale, part);
    }
  }
}

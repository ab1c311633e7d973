// The newest image of a topic, as large as the space permits.

import { el, mark, write } from "../../lib/dom.js";
import { number } from "../../lib/format.js";

export const PICTURES = new Set(["sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"]);
const WIDTHS = [160, 320, 640, 1280]; // offered by the console
const PAUSE = 400; // ms between checks of the available space

/** {element, open(topic), close()}: shows one topic at a time. */
export function pictureBlock(socket) {
  const image = el("img", { alt: "" });
  const about = el("figcaption");
  const element = el("figure", { class: "picture", hidden: true }, image, about);
  let [topic, width, end, wait] = ["", 0, () => {}, 0];
  new ResizeObserver(() => {
    clearTimeout(wait);
    wait = setTimeout(follow, PAUSE);
  }).observe(element);

  /** Watch the feed whose images fit the available space. */
  function follow() {
    if (!topic) return;
    const room = Math.max(element.clientWidth, 1) * Math.min(devicePixelRatio, 2);
    const wanted = WIDTHS.find((each) => each >= room) ?? WIDTHS.at(-1);
    if (wanted === width) return;
    const before = end;
    width = wanted;
    end = socket.watch(`image:${width}:${topic}`, draw);
    before();
  }

  function draw(value, why) {
    if (!value) return write(about, why || "Waiting for an image.");
    mark(image, "src", value.image);
    mark(image, "width", value.width);
    mark(image, "height", value.height);
    image.alt = `Newest image of ${topic.split("@")[0]}`;
    const range = value.range ? `, black ${number(value.range[0])} to white ${number(value.range[1])}` : "";
    write(about, `${value.width} × ${value.height}, ${value.encoding}${range}${value.frame ? `, ${value.frame}` : ""}`);
  }

  return {
    element,
    open(name) {
      if (name === topic) return;
      this.close();
      topic = name;
      element.hidden = false;
      write(about, "Waiting for an image.");
      follow();
    },
    close() {
      end();
      [topic, width, end] = ["", 0, () => {}];
      element.hidden = true;
      image.removeAttribute("src");
    },
  };
}

// Translates touch, mouse and wheel on a canvas into gestures on the map.

const STILL = 6; // px that a pointer may move during a tap
const LINE = 33; // px per line of a mouse wheel

/**
 * Call `target`'s methods for gestures, in CSS pixels of the canvas: `pan(dx, dy)`, `zoom(factor, x, y)`, `tap(x, y)`.
 * If `aims()` returns true, a press sets a point and a drag the heading: `press(x, y)`, `aim(x, y)` during a drag, then
 * `let(x, y, far)` on release (`far`: whether the pointer was dragged), or `forget()` if the press is canceled.
 */
export function gestures(canvas, target) {
  const down = new Map(); // pointer -> its last pixel
  let start = null; // where the only pointer went down
  let aiming = false;
  let moved = false;

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    const at = place(event);
    down.set(event.pointerId, at);
    if (down.size === 1) {
      start = at;
      moved = false;
      aiming = target.aims();
      if (aiming) target.press(at.x, at.y);
    } else {
      if (aiming) target.forget(); // a second finger starts a zoom
      aiming = false;
      moved = true;
    }
  });

  canvas.addEventListener("pointermove", (event) => {
    const old = down.get(event.pointerId);
    if (old === undefined) return;
    const at = place(event);
    moved ||= Math.hypot(at.x - start.x, at.y - start.y) > STILL;
    if (down.size === 2) pinch(event.pointerId, old, at);
    down.set(event.pointerId, at);
    if (down.size !== 1 || !moved) return;
    if (aiming) target.aim(at.x, at.y);
    else target.pan(at.x - old.x, at.y - old.y);
  });

  function pinch(id, old, at) {
    const other = [...down].find(([each]) => each !== id)[1];
    const before = Math.hypot(old.x - other.x, old.y - other.y);
    const after = Math.hypot(at.x - other.x, at.y - other.y);
    target.pan((at.x - old.x) / 2, (at.y - old.y) / 2);
    if (before > 1) target.zoom(after / before, (at.x + other.x) / 2, (at.y + other.y) / 2);
  }

  canvas.addEventListener("pointerup", (event) => {
    if (!down.delete(event.pointerId) || down.size) return;
    const at = place(event);
    if (aiming) target.let(at.x, at.y, moved);
    else if (!moved) target.tap(at.x, at.y);
    aiming = false;
  });

  canvas.addEventListener("pointercancel", (event) => {
    down.delete(event.pointerId);
    if (aiming) target.forget();
    aiming = false;
    moved = true;
  });

  canvas.addEventListener("contextmenu", (event) => {
    event.preventDefault();
    const at = place(event);
    if (event.pointerType !== "touch") target.tap(at.x, at.y);
  });

  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const at = place(event);
      const scroll = event.deltaY * (event.deltaMode === 1 ? LINE : 1);
      target.zoom(Math.exp(-Math.max(-300, Math.min(300, scroll)) * 0.0015), at.x, at.y);
    },
    { passive: false },
  );
}

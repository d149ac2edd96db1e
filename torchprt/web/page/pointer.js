// Mouse, touch and keys: what turns the camera, what turns the light.

const TURN = 0.0075; // radians a pixel
const STEP = 24; // pixels that an arrow key stands for

/** `on` has camera(right, down), light(right, down) in pixels, zoom(factor), and play() for the space bar. */
export function listen(canvas, on) {
  const held = new Map();
  let moves = null;

  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus();
    held.set(event.pointerId, event);
    // Two fingers turn the light and zoom.
    moves = held.size > 1 || event.button === 2 || event.shiftKey ? "light" : "camera";
    canvas.className = moves;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const [x, y] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (held.size > 1) {
      const [other] = [...held.values()].filter((each) => each.pointerId !== event.pointerId);
      const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      on.zoom(apart(before) / Math.max(apart(event), 1));
      on.light(x / 2, y / 2);
    } else {
      on[moves](x, y);
    }
    held.set(event.pointerId, event);
  });
  const release = (event) => {
    held.delete(event.pointerId);
    if (!held.size) canvas.className = "";
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      // Lines and pages count as so many pixels; a wheel that jumps is a small step all the same.
      const pixels = event.deltaY * [1, 20, 400][event.deltaMode];
      on.zoom(Math.exp(Math.max(-120, Math.min(120, pixels)) * 0.0015));
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    const arrows = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, -STEP], ArrowDown: [0, STEP] };
    const arrow = arrows[event.key];
    if (arrow) on[event.shiftKey ? "light" : "camera"](...arrow);
    else if (event.key === "+") on.zoom(0.9);
    else if (event.key === "-") on.zoom(1 / 0.9);
    else if (event.key === " ") on.play();
    else return;
    event.preventDefault();
  });
}

export { TURN };

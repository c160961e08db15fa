// A camera that turns about the object: mouse, touch, wheel, keys.

const FIELD = 32; // degrees, vertical
const STEP = Math.PI / 36; // of a key

function home(head, aspect) {
  const across = Math.min(aspect, 1), half = (FIELD * Math.PI) / 360;
  const distance = (1.06 * head.radius) / Math.sin(Math.atan(Math.tan(half) * across));
  return { yaw: 0.55, pitch: 0.32, distance, target: [...head.centre] };
}

function cameraOf(orbit) {
  const { yaw, pitch, distance, target } = orbit, c = Math.cos(pitch);
  const back = [c * Math.sin(yaw), Math.sin(pitch), c * Math.cos(yaw)];
  return { origin: sum(target, times(back, distance)), target, up: [0, 1, 0], fov: FIELD };
}

function turned(orbit, dx, dy) {
  const limit = Math.PI / 2 - 0.01;
  orbit.yaw -= dx;
  orbit.pitch = Math.min(Math.max(orbit.pitch + dy, -limit), limit);
}

function zoomed(orbit, factor, radius) {
  orbit.distance = Math.min(Math.max(orbit.distance * factor, 0.02 * radius), 60 * radius);
}

// Pixels across the canvas to a shift of the target in the picture's plane.
function shifted(orbit, dx, dy, height) {
  const { right, down } = frameOf(cameraOf(orbit), height);
  orbit.target = sum(orbit.target, times(right, -dx * orbit.distance), times(down, -dy * orbit.distance));
}

function byKey(event, orbit, head, reset) {
  const arrows = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
  if (event.key in arrows) turned(orbit, ...arrows[event.key]);
  else if (event.key === "+" || event.key === "=") zoomed(orbit, 1 / 1.1, head.radius);
  else if (event.key === "-") zoomed(orbit, 1.1, head.radius);
  else if (event.key === "0" || event.key === "Home") reset();
  else return false;
  return true;
}

function steer(canvas, orbit, head, reset, changed) {
  const pointers = new Map();
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const was = pointers.get(event.pointerId), now = { x: event.clientX, y: event.clientY };
    if (!was) return;
    const before = pointers.size > 1 && spread();
    pointers.set(event.pointerId, now);
    const dx = now.x - was.x, dy = now.y - was.y, height = canvas.clientHeight;
    if (before) {
      const after = spread();
      zoomed(orbit, before.apart / Math.max(after.apart, 1), head.radius);
      shifted(orbit, after.x - before.x, after.y - before.y, height);
    } else if (event.shiftKey || event.buttons & 6) shifted(orbit, dx, dy, height);
    else turned(orbit, (dx / height) * 4, (dy / height) * 4);
    changed();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomed(orbit, Math.exp(Math.max(-1, Math.min(1, event.deltaY * (event.deltaMode ? 0.05 : 0.0015)))), head.radius);
    changed();
  }, { passive: false });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => { reset(); changed(); });
  canvas.addEventListener("keydown", (event) => {
    if (!byKey(event, orbit, head, reset)) return;
    event.preventDefault();
    changed();
  });
}

// The page: what is asked for, when to draw, what is said about it.

const SAMPLES = 16; // per pixel of a picture at rest
const REST = 160; // ms after the last movement
const SLICE = 40; // ms of work for the card at a time, so that the page stays responsive
const $ = (id) => document.getElementById(id);

function say(sentence) {
  $("message").textContent = sentence;
  $("message").hidden = false;
}

// Squares with names, tinted by place, so that a texture's direction can be seen.
function checker() {
  const canvas = document.createElement("canvas"), count = 16, side = 64;
  canvas.width = canvas.height = count * side;
  const pen = canvas.getContext("2d");
  pen.font = `600 ${side * 0.34}px system-ui, sans-serif`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (let i = 0; i < count; i++)
    for (let j = 0; j < count; j++) {
      const dark = (i + j) % 2, hue = 205 + 150 * (i / count) - 40 * (j / count);
      pen.fillStyle = `hsl(${hue} ${dark ? 34 : 42}% ${dark ? 46 : 86}%)`;
      pen.fillRect(i * side, j * side, side, side);
      pen.fillStyle = `hsl(${hue} 35% ${dark ? 72 : 62}%)`;
      pen.fillText(String.fromCharCode(65 + i) + (count - j), (i + 0.5) * side, (j + 0.54) * side);
    }
  return canvas;
}

async function picture(gl) {
  const given = $("image");
  if (!given) return checker();
  const bytes = Uint8Array.from(atob(given.textContent.trim()), (c) => c.charCodeAt(0));
  const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  const image = await createImageBitmap(new Blob([bytes], { type: given.dataset.type }), options);
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE), share = most / Math.max(image.width, image.height);
  if (share >= 1) return image;
  const [resizeWidth, resizeHeight] = [image.width, image.height].map((n) => Math.floor(n * share));
  return createImageBitmap(image, { ...options, resizeWidth, resizeHeight });
}

// Points spread evenly over a pixel, the first in its middle (Roberts' R2 sequence).
const jitter = (n) => [0.7548776662466927, 0.5698402909980532].map((a) => ((0.5 + n * a) % 1) - 0.5);

function paperColour() {
  return getComputedStyle(document.body).getPropertyValue("--wash").trim();
}

function asked() {
  const chosen = (name) => document.querySelector(`input[name="${name}"]:checked`).value;
  const mipmaps = $("mipmaps").checked;
  return { kernel: chosen("kernel"), shading: chosen("shading"), mipmaps, anisotropy: mipmaps ? 16 : 1 };
}

function legend() {
  const stops = RAMP.map((colour, i) => `${colour} ${(100 * i) / (RAMP.length - 1)}%`);
  $("ramp").style.background = `linear-gradient(90deg, ${stops.join(", ")})`;
}

// Draws whenever something changed: coarsely while it moves, then as a mean of samples, in slices.
function painter(gl, canvas, draw, present, orbit, report) {
  let version = 0, moved = -Infinity, scale = 0.5, drawn = -1, wake = () => {};
  let draft = null, full = null, rows = 64, held = null;
  const screen = { frame: null, width: 0, height: 0 };
  const show = (from) => present(from, screen, channels(paperColour()).map(toLinear));
  const fresh = (old, width, height) => {
    if (old && old.width === width && old.height === height) return old;
    if (old) freed(gl, old);
    return target(gl, UNITS.spare, width, height, gl.RGBA16F);
  };
  const fit = () => {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    screen.width = canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    screen.height = canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  };

  async function move() {
    const begin = performance.now();
    draft = fresh(draft, Math.ceil(screen.width * scale), Math.ceil(screen.height * scale));
    draw(cameraOf(orbit), { ...asked(), jitter: [0, 0] }, draft);
    show(draft);
    await finished(gl);
    const ms = performance.now() - begin;
    report(ms, draft);
    scale = Math.min(1, Math.max(0.2, scale * Math.min(1.25, Math.max(0.6, Math.sqrt(24 / ms)))));
  }

  async function sample(n, mine) {
    const begin = performance.now();
    full = fresh(full, screen.width, screen.height);
    for (let y = 0; y < full.height; ) {
      const start = performance.now(), height = Math.min(rows, full.height - y);
      if (n > 0) gl.enable(gl.BLEND);
      gl.blendColor(0, 0, 0, 1 / (n + 1));
      gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
      draw(cameraOf(orbit), { ...asked(), jitter: jitter(n) }, full, [0, y, full.width, height]);
      gl.disable(gl.BLEND);
      await finished(gl);
      if (version !== mine) return false;
      const share = SLICE / (performance.now() - start + 1);
      rows = Math.max(8, Math.min(full.height, Math.round(rows * Math.min(2, Math.max(0.5, share)))));
      y += height;
    }
    show(full);
    report(performance.now() - begin, full);
    return true;
  }

  async function run() {
    for (;;) {
      await new Promise(requestAnimationFrame);
      if (held) await held;
      const mine = version;
      if (performance.now() - moved < REST) {
        if (drawn !== mine) await move();
        drawn = mine;
        continue;
      }
      let n = 0;
      while (n < SAMPLES && version === mine && (await sample(n, mine))) n++;
      document.documentElement.dataset.samples = version === mine ? n : 0;
      if (version === mine) await new Promise((resolve) => (wake = resolve));
    }
  }

  const changed = (moving) => {
    version++;
    if (moving) moved = performance.now();
    document.documentElement.dataset.samples = 0;
    wake();
  };
  new ResizeObserver(() => { fit(); changed(true); }).observe(canvas);
  fit();
  // While a promise is pending, nothing is drawn.
  const hold = (until) => {
    version++;
    held = until.then(() => (held = null), () => (held = null));
    wake();
    return until;
  };
  return { run, changed, hold };
}

function figures(head, bytes) {
  const number = (x) => x.toLocaleString("en", { maximumSignificantDigits: 3 });
  $("samples").textContent = head.shape.join(" × ");
  $("voxel").textContent = `${number(head.spacing)} ${head.units}`;
  $("bricks").textContent = head.bricks.toLocaleString("en");
  $("weight").textContent = `${number(bytes / 1e6)} MB`;
}

function controls(head, changed) {
  for (const input of document.querySelectorAll("#panel input")) input.addEventListener("change", () => {
    $("scale").hidden = asked().shading !== "footprint";
    changed(false);
  });
  if (!head.offset) for (const input of document.querySelectorAll("[data-textured]")) input.disabled = true;
  const keys = { 1: "shaded", 2: "normals", 3: "uv", 4: "footprint" };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const kernels = [...document.querySelectorAll("input[name=kernel]")];
    const next = kernels[(kernels.findIndex((input) => input.checked) + 1) % kernels.length];
    const chosen = event.key in keys ? $(keys[event.key]) : event.key === "m" ? $("mipmaps") : event.key === "k" ? next : null;
    if (chosen && !chosen.disabled) chosen.click();
  });
}

async function start() {
  const canvas = $("canvas"), head = JSON.parse($("head").textContent);
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
  if (!gl) throw new Error("this browser shows no WebGL2: take a current one, or allow hardware acceleration in its settings");
  if (!("DecompressionStream" in window)) throw new Error("this browser is too old to unpack the page: take a current one");
  if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float"))
    throw new Error("this graphics card draws into no half-float pictures, which this page needs");
  canvas.addEventListener("webglcontextlost", () => say("The graphics card stopped: load the page again."));
  legend();
  figures(head, document.documentElement.outerHTML.length);
  const draw = await scene(gl, head, await picture(gl)), present = presenter(gl);
  const orbit = home(head, canvas.clientWidth / canvas.clientHeight);
  const reset = () => Object.assign(orbit, home(head, canvas.clientWidth / canvas.clientHeight));
  const report = (ms, drawn) => {
    $("milliseconds").textContent = ms < 1000 ? `${Math.max(1, Math.round(ms))} ms` : `${(ms / 1000).toFixed(1)} s`;
    $("pixels").textContent = `${drawn.width} × ${drawn.height}`;
  };
  const { run, changed, hold } = painter(gl, canvas, draw, present, orbit, report);
  steer(canvas, orbit, head, reset, () => changed(true));
  controls(head, changed);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => changed(false));
  $("message").hidden = true;
  run().catch((error) => say(error.message));
  const probe = prober(gl, draw, present);
  return { probe: (options) => hold(probe(options)), head, camera: () => cameraOf(orbit) };
}

// `ready` resolves when there is something to see; `probe` is for comparisons.
window.viewer = { ready: start() };
window.viewer.probe = (options) => window.viewer.ready.then((started) => started.probe(options));
window.viewer.ready.catch((error) => say(`${error.message[0].toUpperCase()}${error.message.slice(1)}.`));

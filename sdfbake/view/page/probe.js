// Numbers behind a picture, for comparisons: window.viewer.probe(options). docs/viewer.md describes it.

function encoded(values) {
  const bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  let text = "";
  for (let i = 0; i < bytes.length; i += 0x8000) text += String.fromCharCode(...bytes.subarray(i, i + 0x8000));
  return btoa(text);
}

// WebGL's first row is the picture's last.
function upright(pixels, width, height) {
  const out = new pixels.constructor(pixels.length), row = width * 4;
  for (let y = 0; y < height; y++) out.set(pixels.subarray(y * row, (y + 1) * row), (height - 1 - y) * row);
  return out;
}

function readBack(gl, from, type, Numbers) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, from.frame);
  const pixels = new Numbers(from.width * from.height * 4);
  gl.readPixels(0, 0, from.width, from.height, gl.RGBA, type, pixels);
  return encoded(upright(pixels, from.width, from.height));
}

// Returns probe({origin, target, up, fov, size, kernel, shading, mipmaps, anisotropy, paper}): a promise of
// {normal, uv, colour, lights, milliseconds}, base64 of (h, w, 4) arrays from the top row on; see docs/viewer.md.
function prober(gl, draw, present) {
  return async (options) => {
    const [width, height] = options.size, look = { kernel: "bspline", mipmaps: true, ...options };
    if (!gl.getExtension("EXT_color_buffer_float")) throw new Error("this browser reads no float pictures back");
    const numbers = target(gl, UNITS.spare, width, height, gl.RGBA32F), found = {};
    for (const [name, shading] of [["normal", "number-normals"], ["uv", "number-uv"]]) {
      draw(options, { ...look, shading }, numbers);
      found[name] = readBack(gl, numbers, gl.FLOAT, Float32Array);
    }
    const begin = performance.now();
    draw(options, { ...look, shading: options.shading ?? "shaded" }, numbers);
    await finished(gl);
    const milliseconds = performance.now() - begin, bytes = target(gl, UNITS.spare, width, height, gl.RGBA8);
    present(numbers, bytes, options.paper ?? [0, 0, 0]);
    found.colour = readBack(gl, bytes, gl.UNSIGNED_BYTE, Uint8Array);
    for (const made of [numbers, bytes]) freed(gl, made);
    return { ...found, lights: lightsOf(options), milliseconds, size: [width, height], kernel: look.kernel };
  };
}

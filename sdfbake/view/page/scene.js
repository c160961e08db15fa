// The grid on the graphics card, and how one picture of it is drawn.

const RAMP = ["#440154", "#443983", "#31688e", "#21918c", "#35b779", "#90d743", "#fde725"]; // levels -3, -1.5, ..., 6
const MODES = ["shaded", "normals", "uv", "footprint", "number-normals", "number-uv"];
const UNITS = { table: 0, gaps: 1, blocks: 2, coordinates: 3, image: 4, picture: 5, spare: 6 };

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (a, s) => a.map((x) => x * s);
const sum = (...vectors) => [0, 1, 2].map((i) => vectors.reduce((total, v) => total + v[i], 0));
const unit = (a) => times(a, 1 / Math.hypot(...a));

// View, and Right and Down per pixel at unit distance (Galim 2018, eq. 3).
function frameOf(camera, height) {
  const view = unit(sum(camera.target, times(camera.origin, -1))), right = unit(cross(view, camera.up));
  const pixel = (2 * Math.tan((camera.fov * Math.PI) / 360)) / height;
  return { view, right: times(right, pixel), down: times(cross(view, right), pixel) };
}

// Four lights that go with the camera: from the left above, from the right, from behind above, from below.
function lightsOf(camera) {
  const { view, right, down } = frameOf(camera, 1), r = unit(right), u = times(unit(down), -1), back = times(view, -1);
  const from = (x, y, z) => unit(sum(times(r, x), times(u, y), times(back, z)));
  return [
    { toward: from(-0.5, 0.75, 0.8), irradiance: [2.1, 2.05, 1.97] },
    { toward: from(0.95, 0.05, 0.5), irradiance: [0.7, 0.74, 0.8] },
    { toward: from(0.15, 0.8, -0.6), irradiance: [0.8, 0.82, 0.86] },
    { toward: from(-0.35, -0.85, 0.45), irradiance: [0.62, 0.62, 0.64] },
  ];
}

const toLinear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
const channels = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);

async function loaded(gl, head) {
  const [table, gap, distance] = await Promise.all(["table", "gap", "distance"].map(inflated));
  const slots = new Int32Array(table.buffer), numbers = floats(joined(distance));
  const size = (side) => across(head.bricks).map((n) => n * side).reverse();
  const most = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
  if (Math.max(...size(KEPT), ...head.table) > most)
    throw new Error(`this graphics card takes 3D textures of ${most} at most: bake the grid at a lower resolution`);
  const int32 = [gl.R32I, gl.RED_INTEGER, gl.INT], byte = [gl.R8UI, gl.RED_INTEGER, gl.UNSIGNED_BYTE];
  const quad = [gl.RGBA16UI, gl.RGBA_INTEGER, gl.UNSIGNED_SHORT], float = [gl.R32F, gl.RED, gl.FLOAT];
  volume(gl, UNITS.table, int32, [...head.table].reverse(), slots);
  volume(gl, UNITS.gaps, byte, size(8), gapAtlas(head.bricks, gap));
  if (head.offset) {
    const [uv, chart] = (await Promise.all(["uv", "chart"].map(inflated))).map(joined);
    volume(gl, UNITS.coordinates, quad, size(8), coordinateAtlas(head.bricks, uv, chart));
  } else volume(gl, UNITS.coordinates, quad, [1, 1, 1], new Uint16Array(4));
  const made = {};
  // What a kernel reads is made when it is first asked for.
  return (kernel) => {
    const filtered = kernel === "bspline";
    gl.activeTexture(gl.TEXTURE0 + UNITS.blocks);
    if (made[filtered]) gl.bindTexture(gl.TEXTURE_3D, made[filtered]);
    else made[filtered] = volume(gl, UNITS.blocks, float, size(KEPT), blockAtlas(head, slots, numbers, filtered));
  };
}

// Returns draw(camera, look, target, region): look has kernel, shading, mipmaps, jitter.
async function scene(gl, head, image) {
  const blocks = await loaded(gl, head), tracers = {}, aniso = gl.getExtension("EXT_texture_filter_anisotropic");
  const within = head.offset && head.offset.every((low, i) => low > -1e-6 && low + head.scale[i] < 1 + 1e-6);
  const texture = pictureTexture(gl, UNITS.image, image, within ? "CLAMP_TO_EDGE" : "REPEAT");
  gl.bindVertexArray(gl.createVertexArray());

  const prepared = (kernel) => {
    tracers[kernel] ??= tracer(gl, kernel);
    const { made, uniforms } = tracers[kernel];
    gl.useProgram(made);
    blocks(kernel);
    for (const name of ["table", "gaps", "blocks", "coordinates", "image"]) gl.uniform1i(uniforms[name], UNITS[name]);
    gl.uniform3iv(uniforms.samples, head.shape);
    gl.uniform2iv(uniforms.across, across(head.bricks).slice(0, 2));
    gl.uniform2fv(uniforms.offset, head.offset ?? [0, 0]);
    gl.uniform2fv(uniforms.scale, head.scale ?? [1, 1]);
    gl.uniform1f(uniforms.jump, head.jump ?? 1);
    gl.uniform1i(uniforms.hasTexture, head.offset ? 1 : 0);
    gl.uniform3fv(uniforms.albedo, [0.78, 0.76, 0.72]);
    gl.uniform3fv(uniforms.ramp, RAMP.flatMap(channels));
    return uniforms;
  };

  return (camera, look, to, region) => {
    const uniforms = prepared(look.kernel), { view, right, down } = frameOf(camera, to.height), lights = lightsOf(camera);
    gl.uniform3fv(uniforms.origin, camera.origin.map((x, i) => (x - head.origin[i]) / head.spacing));
    gl.uniform3fv(uniforms.view, view);
    gl.uniform3fv(uniforms.right, right);
    gl.uniform3fv(uniforms.down, down);
    gl.uniform2f(uniforms.size, to.width, to.height);
    gl.uniform2fv(uniforms.jitter, look.jitter ?? [0, 0]);
    gl.uniform1i(uniforms.shading, MODES.indexOf(look.shading));
    gl.uniform1i(uniforms.mipmaps, look.mipmaps ? 1 : 0);
    gl.uniform3fv(uniforms.toward, lights.flatMap((light) => light.toward));
    gl.uniform3fv(uniforms.irradiance, lights.flatMap((light) => light.irradiance));
    gl.activeTexture(gl.TEXTURE0 + UNITS.image);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    if (aniso) gl.texParameterf(gl.TEXTURE_2D, aniso.TEXTURE_MAX_ANISOTROPY_EXT, look.anisotropy ?? 1);
    gl.bindFramebuffer(gl.FRAMEBUFFER, to.frame);
    gl.viewport(0, 0, to.width, to.height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(...(region ?? [0, 0, to.width, to.height]));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.SCISSOR_TEST);
  };
}

// Returns present(from, width, height, paper): a picture over the page's colour, onto the canvas.
function presenter(gl) {
  const { made, uniforms } = program(gl, source("glsl-present"));
  return (from, to, paper) => {
    gl.useProgram(made);
    gl.activeTexture(gl.TEXTURE0 + UNITS.picture);
    gl.bindTexture(gl.TEXTURE_2D, from.texture);
    gl.bindFramebuffer(gl.FRAMEBUFFER, to.frame);
    gl.viewport(0, 0, to.width, to.height);
    gl.uniform1i(uniforms.picture, UNITS.picture);
    gl.uniform2f(uniforms.size, to.width, to.height);
    gl.uniform3fv(uniforms.paper, paper);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  };
}

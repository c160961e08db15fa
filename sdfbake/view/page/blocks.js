// From the page's arrays to tables for the graphics card.

const PRESENT = 1 << 24; // in the table of bricks: the rest is a slot
const BLOCK = 13, KEPT = 11; // samples of a brick's cells with the widest stencil, and the coefficients that are kept

async function inflated(name) {
  const text = atob(document.getElementById(`array-${name}`).textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  const inflate = new DecompressionStream("deflate"), writer = inflate.writable.getWriter();
  const written = writer.write(bytes).then(() => writer.close());
  const parts = [], reader = inflate.readable.getReader();
  for (let part = await reader.read(); !part.done; part = await reader.read()) parts.push(part.value);
  await written;
  const whole = new Uint8Array(parts.reduce((total, part) => total + part.length, 0));
  parts.reduce((at, part) => (whole.set(part, at), at + part.length), 0);
  return whole;
}

// All low bytes, then all high ones, to 16-bit numbers.
function joined(bytes) {
  const numbers = new Uint16Array(bytes.length / 2);
  for (let i = 0; i < numbers.length; i++) numbers[i] = bytes[i] | (bytes[i + numbers.length] << 8);
  return numbers;
}

function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1, exponent = (bits >> 10) & 31, fraction = (bits & 1023) / 1024;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction) : 2 ** -14 * fraction);
}

function floats(halves) {
  const known = Float32Array.from({ length: 65536 }, (_, bits) => half(bits));
  const numbers = new Float32Array(halves.length);
  for (let i = 0; i < numbers.length; i++) numbers[i] = known[halves[i]];
  return numbers;
}

// How many bricks an atlas has along each axis: as near to a cube as whole numbers allow.
function across(count) {
  const side = Math.ceil(Math.cbrt(count));
  return [side, side, Math.ceil(count / (side * side))];
}

// Lay cubes of side^3 out in a 3D atlas; fill(slot, out, at, row, plane) writes one, `at` being its first number.
function atlas(count, side, channels, out, fill) {
  const [nx, ny, nz] = across(count), row = nz * side * channels, plane = ny * side * row;
  for (let slot = 0; slot < count; slot++) {
    const x = slot % nx, y = Math.floor(slot / nx) % ny, z = Math.floor(slot / (nx * ny));
    fill(slot, out, x * side * plane + y * side * row + z * side * channels, row, plane);
  }
  return out;
}

function atlasLength(count, side, channels) {
  return across(count).reduce((a, b) => a * b) * side ** 3 * channels;
}

function gapAtlas(count, gap) {
  return atlas(count, 8, 1, new Uint8Array(atlasLength(count, 8, 1)), (slot, out, at, row, plane) => {
    for (let k = 0; k < 64; k++) {
      const first = slot * 512 + k * 8;
      out.set(gap.subarray(first, first + 8), at + (k >> 3) * plane + (k & 7) * row);
    }
  });
}

function coordinateAtlas(count, uv, chart) {
  const total = count * 512;
  return atlas(count, 8, 4, new Uint16Array(atlasLength(count, 8, 4)), (slot, out, at, row, plane) => {
    for (let k = 0; k < 512; k++) {
      const to = at + (k >> 6) * plane + ((k >> 3) & 7) * row + (k & 7) * 4, from = slot * 512 + k;
      out[to] = uv[from];
      out[to + 1] = uv[total + from];
      out[to + 2] = chart[from];
    }
  });
}

// Continue one axis of a block linearly past the lattice: `first` and `last` are its ends, counted in the block.
function continued(block, stride, others, first, last) {
  for (const start of others) {
    const at = (i) => start + i * stride;
    for (let i = first - 1; i >= 0; i--) block[at(i)] = 2 * block[at(i + 1)] - block[at(i + 2)];
    for (let i = last + 1; i < BLOCK; i++) block[at(i)] = 2 * block[at(i - 1)] - block[at(i - 2)];
  }
}

const STRIDES = [BLOCK * BLOCK, BLOCK, 1];
const STARTS = STRIDES.map((stride, axis) => {
  const [a, b] = STRIDES.filter((_, other) => other !== axis);
  return Array.from({ length: BLOCK * BLOCK }, (_, n) => Math.floor(n / BLOCK) * a + (n % BLOCK) * b);
});

// (-1, 8, -1) / 6 along an axis; the block's two ends are left as they are, and are not kept.
function prefiltered(block, stride, starts) {
  for (const start of starts) {
    let before = block[start];
    for (let i = 1; i < BLOCK - 1; i++) {
      const at = start + i * stride, here = block[at];
      block[at] = (8 * here - before - block[at + stride]) / 6;
      before = here;
    }
  }
}

// Samples -2 to 10 of a brick; 0 where a brick is absent: no cell with surface reads those.
function gathered(block, head, slots, distance, brick) {
  const [, my, mz] = head.table, near = new Int32Array(3);
  block.fill(0);
  for (let i = 0; i < BLOCK; i++)
    for (let j = 0; j < BLOCK; j++) {
      const x = brick[0] * 8 + i - 2, y = brick[1] * 8 + j - 2;
      if (x < 0 || y < 0 || x >= head.shape[0] || y >= head.shape[1]) continue;
      const column = ((x >> 3) * my + (y >> 3)) * mz, inner = ((x & 7) << 6) | ((y & 7) << 3);
      for (let k = 0; k < 3; k++) {
        const z = brick[2] + k - 1;
        near[k] = z < 0 || z >= mz ? -1 : slots[column + z] - PRESENT;
      }
      for (let k = 0; k < BLOCK; k++) {
        const z = brick[2] * 8 + k - 2, slot = near[(k + 6) >> 3];
        if (slot >= 0 && z < head.shape[2]) block[(i * BLOCK + j) * BLOCK + k] = distance[slot * 512 + inner + (z & 7)];
      }
    }
}

// Per brick the samples, or the B-spline's coefficients, of all stencils: computed in float64, kept in float32.
function blockAtlas(head, slots, distance, filtered) {
  const [, my, mz] = head.table, block = new Float64Array(BLOCK ** 3), brickOf = [];
  for (let n = 0; n < slots.length; n++)
    if (slots[n] >= PRESENT) brickOf[slots[n] - PRESENT] = [Math.floor(n / (my * mz)), Math.floor(n / mz) % my, n % mz];
  const fill = (slot, out, at, row, plane) => {
    const brick = brickOf[slot];
    gathered(block, head, slots, distance, brick);
    for (let axis = 0; axis < 3; axis++) {
      const first = 2 - brick[axis] * 8, last = head.shape[axis] - 1 + first;
      if (first > 0 || last < BLOCK - 1) continued(block, STRIDES[axis], STARTS[axis], first, last);
    }
    if (filtered) for (let axis = 0; axis < 3; axis++) prefiltered(block, STRIDES[axis], STARTS[axis]);
    for (let i = 0; i < KEPT; i++)
      for (let j = 0; j < KEPT; j++)
        for (let k = 0; k < KEPT; k++)
          out[at + i * plane + j * row + k] = block[((i + 1) * BLOCK + j + 1) * BLOCK + k + 1];
  };
  return atlas(head.bricks, KEPT, 1, new Float32Array(atlasLength(head.bricks, KEPT, 1)), fill);
}

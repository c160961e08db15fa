// The interpolant: samples or coefficients of a brick's cells with all that their stencils need, 11^3 to a brick.
// Arrays are [x, y, z] with z fastest, so that a texture's x is z: hence all the .zyx.

const int PRESENT = 1 << 24;

uniform isampler3D table;   // per brick: PRESENT + slot, or how many bricks around are absent
uniform usampler3D gaps;    // per cell: 0 where there may be surface, or how many cells around have none
uniform sampler3D blocks;   // per brick 11^3 coefficients, from the sample before its first on
uniform usampler3D coordinates; // per sample: u, v in 16 bits over their range, chart + 1
uniform ivec3 samples;      // of the lattice
uniform ivec2 across;       // bricks of the atlases along x and y

#if KERNEL == 0
#define TAPS 2
#define ROW vec2
#else
#define TAPS 4
#define ROW vec4
#endif

ROW taps[TAPS * TAPS]; // of the cell that was read last, by x and y

ivec3 place(int slot) {
  return ivec3(slot % across.x, slot / across.x % across.y, slot / (across.x * across.y));
}

void read(int slot, ivec3 local) {
  ivec3 first = place(slot) * 11 + local + (TAPS == 2 ? 1 : 0);
  for (int i = 0; i < TAPS; i++)
    for (int j = 0; j < TAPS; j++)
      for (int k = 0; k < TAPS; k++)
        taps[TAPS * i + j][k] = texelFetch(blocks, (first + ivec3(i, j, k)).zyx, 0).r;
}

ROW weights(float t) {
#if KERNEL == 0
  return vec2(1.0 - t, t);
#elif KERNEL == 1
  return 0.5 * vec4(t * (-1.0 + t * (2.0 - t)), 2.0 + t * t * (3.0 * t - 5.0), t * (1.0 + t * (4.0 - 3.0 * t)), t * t * (t - 1.0));
#else
  float s = 1.0 - t;
  return vec4(s * s * s, 4.0 + t * t * (3.0 * t - 6.0), 4.0 + s * s * (3.0 * s - 6.0), t * t * t) / 6.0;
#endif
}

ROW slopes(float t) {
#if KERNEL == 0
  return vec2(-1.0, 1.0);
#elif KERNEL == 1
  return 0.5 * vec4(-1.0 + t * (4.0 - 3.0 * t), t * (9.0 * t - 10.0), 1.0 + t * (8.0 - 9.0 * t), t * (3.0 * t - 2.0));
#else
  float s = 1.0 - t;
  return 0.5 * vec4(-s * s, t * (3.0 * t - 4.0), s * (4.0 - 3.0 * s), t * t);
#endif
}

float value(vec3 u) {
  ROW a = weights(u.x), b = weights(u.y), c = weights(u.z);
  float total = 0.0;
  for (int i = 0; i < TAPS; i++) {
    float row = 0.0;
    for (int j = 0; j < TAPS; j++) row += b[j] * dot(taps[TAPS * i + j], c);
    total += a[i] * row;
  }
  return total;
}

// The gradient, per voxel.
vec3 slope(vec3 u) {
  ROW a = weights(u.x), b = weights(u.y), c = weights(u.z);
  ROW da = slopes(u.x), db = slopes(u.y), dc = slopes(u.z);
  vec3 total = vec3(0.0);
  for (int i = 0; i < TAPS; i++) {
    vec3 row = vec3(0.0); // along x, y, z
    for (int j = 0; j < TAPS; j++) {
      float along = dot(taps[TAPS * i + j], c);
      row += vec3(b[j] * along, db[j] * along, b[j] * dot(taps[TAPS * i + j], dc));
    }
    total += vec3(da[i], a[i], a[i]) * row;
  }
  return total;
}

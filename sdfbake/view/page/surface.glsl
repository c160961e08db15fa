// Texture coordinates at a hit. Only samples of one chart are interpolated: the one whose corners have the most weight.
// Where all eight corners are of it, trilinearly; else the affine map that fits the chart's samples around best, and
// that is constant along the normal, as those of closest points are.

uniform vec2 offset, scale; // of the 16 bits
uniform float jump;         // samples whose coordinates differ by more, of the range, lie across a cut

struct Mapped {
  vec2 uv;
  vec3 du, dv; // per voxel
  int chart;   // -1 for none
};

// u and v from 0 to 1 over their range; chart + 1, 0 where nothing is known.
vec3 sampled(ivec3 at) {
  if (any(lessThan(at, ivec3(0))) || any(greaterThanEqual(at, samples))) return vec3(0.0);
  int slot = texelFetch(table, (at >> 3).zyx, 0).r - PRESENT;
  if (slot < 0) return vec3(0.0);
  return vec3(texelFetch(coordinates, (place(slot) * 8 + (at & 7)).zyx, 0).xyz) / vec3(65535.0, 65535.0, 1.0);
}

float weight(int corner, vec3 u) {
  vec3 w = mix(1.0 - u, u, vec3(corner >> 2, corner >> 1 & 1, corner & 1));
  return w.x * w.y * w.z;
}

Mapped scaled(vec2 uv, vec3 du, vec3 dv, int chart) {
  return Mapped(offset + scale * uv, scale.x * du, scale.y * dv, chart);
}

Mapped fitted(ivec3 cell, vec3 u, vec3 n, vec3 like) {
  float total = 0.0;
  vec3 middle = vec3(0.0), bu = vec3(0.0), bv = vec3(0.0);
  vec2 mean = vec2(0.0);
  mat3 square = mat3(0.0);
  for (int k = 0; k < 64; k++) {
    ivec3 step = ivec3(k >> 4, k >> 2 & 3, k & 3) - 1;
    vec3 s = sampled(cell + step), p = vec3(step) - u;
    if (s.z != like.z || any(greaterThan(abs(s.xy - like.xy), vec2(2.0 * jump)))) continue;
    vec3 hat = max(1.0 - 0.5 * abs(p), 0.0);
    float w = hat.x * hat.y * hat.z;
    total += w;
    middle += w * p;
    mean += w * (s.xy - like.xy);
    square += w * outerProduct(p, p);
    bu += w * (s.x - like.x) * p;
    bv += w * (s.y - like.y) * p;
  }
  if (total <= 0.0) return scaled(like.xy, vec3(0.0), vec3(0.0), int(like.z) - 1);
  middle /= total;
  mean /= total;
  mat3 spread = square / total - outerProduct(middle, middle) + outerProduct(n, n) + 1e-4 * mat3(1.0);
  mat3 solve = inverse(spread);
  vec3 du = solve * (bu / total - mean.x * middle), dv = solve * (bv / total - mean.y * middle);
  vec2 uv = like.xy + mean - vec2(dot(du, middle), dot(dv, middle));
  return scaled(uv, du, dv, int(like.z) - 1);
}

Mapped textured(ivec3 cell, vec3 u, vec3 n) {
  vec3 corner[8];
  for (int k = 0; k < 8; k++) corner[k] = sampled(cell + ivec3(k >> 2, k >> 1 & 1, k & 1));
  int best = -1, count = 0;
  float most = 0.0;
  for (int k = 0; k < 8; k++) {
    if (corner[k].z == 0.0) continue;
    float votes = 0.0;
    int same = 0;
    for (int l = 0; l < 8; l++)
      if (corner[l].z == corner[k].z && all(lessThan(abs(corner[l].xy - corner[k].xy), vec2(jump)))) {
        votes += weight(l, u);
        same++;
      }
    if (votes > most + 1e-6) {
      most = votes;
      best = k;
      count = same;
    }
  }
  if (best < 0) return Mapped(vec2(0.0), vec3(0.0), vec3(0.0), -1);
  if (count < 8) return fitted(cell, u, n, corner[best]);
  vec2 uv = vec2(0.0);
  vec3 du = vec3(0.0), dv = vec3(0.0);
  for (int k = 0; k < 8; k++) {
    vec3 side = vec3(k >> 2, k >> 1 & 1, k & 1), w = mix(1.0 - u, u, side), turn = 2.0 * side - 1.0;
    vec3 slope = turn * w.yzx * w.zxy;
    uv += w.x * w.y * w.z * corner[k].xy;
    du += slope * corner[k].x;
    dv += slope * corner[k].y;
  }
  return scaled(uv, du, dv, int(corner[best].z) - 1);
}

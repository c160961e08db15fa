// The first hit of a ray. Cells without surface are skipped by cubes that are known to be empty; in the others the
// interpolant is looked at in a few places; the sign is carried from cell to cell, so that no root is lost between two.
// Two crossings in one cell may be missed, at silhouettes.

struct Hit {
  bool found;
  float t;      // voxels from where the march began
  ivec3 cell;
  vec3 u;       // place in the cell
  vec3 gradient;
};

float along(vec3 o, vec3 d, float t) {
  return value(clamp(o + t * d, 0.0, 1.0));
}

// A root on the way from a to e through the cell whose taps were read; o is relative to the cell. The interpolant is
// asked for at a, half way, at e and where a parabola through the three comes nearest to zero: in and out again within
// the cell. Then false position with halved ends (Illinois), bisection every fourth time. All in one loop: compilers
// copy functions to where they are called.
bool crosses(vec3 o, vec3 d, float a, float e, inout float before, out float t) {
  float m = 0.5 * (a + e), first = 0.0, middle = 0.0, side = 0.0, was = a;
  float low = a, high = e, f = 0.0, g = 0.0; // the bracket and its values
  int phase = 0;                             // places looked at; 4 when there is a bracket
  t = a;
  for (int i = 0; i < 28; i++) {
    float h = along(o, d, t);
    if (before == 0.0) before = sign(h);
    bool crossed = h * before < 0.0;
    if (phase < 4 && !crossed) {
      if (phase == 3) return false;
      if (phase == 2) {
        float bend = first - 2.0 * middle + h, turn = 0.5 * (first - h) / bend;
        if (bend * before <= 0.0 || abs(turn) >= 1.0) return false;
        low = a;
        f = first;
        t = m + 0.5 * turn * (e - a);
      } else {
        if (phase == 0) first = h; else middle = h;
        low = t;
        f = h;
        t = phase == 0 ? m : e;
      }
      phase++;
      continue;
    }
    if (phase == 0) return true; // between the cell before and this one
    if (phase == 4 && (h == 0.0 || abs(t - was) < 2e-6)) return true;
    if (crossed) {
      high = t;
      g = h;
      if (side < 0.0) f *= 0.5;
      side = -1.0;
    } else {
      low = t;
      f = h;
      if (side > 0.0) g *= 0.5;
      side = 1.0;
    }
    if (high - low < 2e-6) return true;
    phase = 4;
    was = t;
    t = (i & 3) == 3 ? 0.5 * (low + high) : clamp(low + (high - low) * f / (f - g), low, high);
  }
  return true;
}

// o in grid coordinates, d of unit length, from t to the end of the lattice's box.
Hit march(vec3 o, vec3 d, float t) {
  d = mix(d, vec3(1e-12), lessThan(abs(d), vec3(1e-12)));
  ivec3 most = samples - 2;
  ivec3 cell = clamp(ivec3(floor(o + t * d)), ivec3(0), most);
  bvec3 ahead = greaterThan(d, vec3(0.0));
  float before = 0.0;
  bool found = false;
  for (int step = 0; step < 8192; step++) {
    ivec3 brick = cell >> 3, low = cell, high = cell + 1;
    int word = texelFetch(table, brick.zyx, 0).r, slot = word - PRESENT;
    bool some = false;
    if (slot < 0) {
      low = (brick - (word - 1)) << 3;
      high = (brick + word) << 3;
    } else {
      int gap = int(texelFetch(gaps, (place(slot) * 8 + (cell & 7)).zyx, 0).r);
      low = cell - max(gap - 1, 0);
      high = cell + max(gap, 1);
      some = gap == 0;
    }
    high = min(high, samples - 1);
    vec3 ends = (mix(vec3(low), vec3(high), ahead) - o) / d;
    float e = max(min(ends.x, min(ends.y, ends.z)), t);
    if (some) {
      float root;
      read(slot, cell & 7);
      if (crosses(o - vec3(cell), d, t, e, before, root)) {
        t = root;
        found = true;
        break;
      }
    }
    ivec3 next = clamp(ivec3(floor(o + e * d)), low, high - 1);
    // The axis that is left: by number, since rounding may say otherwise.
    if (ends.x <= ends.y && ends.x <= ends.z) next.x = ahead.x ? high.x : low.x - 1;
    else if (ends.y <= ends.z) next.y = ahead.y ? high.y : low.y - 1;
    else next.z = ahead.z ? high.z : low.z - 1;
    if (any(lessThan(next, ivec3(0))) || any(greaterThan(next, most))) break;
    cell = next;
    t = e;
  }
  vec3 u = clamp(o + t * d - vec3(cell), 0.0, 1.0);
  return Hit(found, t, cell, u, slope(u));
}

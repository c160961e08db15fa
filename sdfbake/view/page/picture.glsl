// A pixel: its ray with differentials (Igehy 1999; Galim 2018, eq. 3, 4), the hit, the footprint (eq. 23 to 25), and
// what of it is shown.

uniform vec3 origin;            // of the camera, grid coordinates
uniform vec3 view, right, down; // per pixel at unit distance
uniform vec2 size;              // of the picture, pixels
uniform vec2 jitter;            // of the ray in the pixel
uniform int shading;            // 0 shaded, 1 normals, 2 uv, 3 footprint; numbers: 4 normal and distance, 5 uv, lod, chart
uniform bool hasTexture, mipmaps;
uniform sampler2D image;
uniform vec3 toward[4], irradiance[4]; // lights
uniform vec3 albedo;
uniform vec3 ramp[7];           // colours of levels -3, -1.5, ..., 6

out vec4 result;

const float PI = 3.14159265358979;

vec3 linear(vec3 c) {
  return mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, lessThanEqual(c, vec3(0.04045)));
}

vec3 lit(vec3 n) {
  vec3 total = vec3(0.0);
  for (int i = 0; i < 4; i++) total += irradiance[i] * max(dot(n, toward[i]), 0.0);
  return total / PI;
}

vec3 level(float lod) {
  float place = clamp((lod + 3.0) / 1.5, 0.0, 5.9999);
  int low = int(place);
  return mix(ramp[low], ramp[low + 1], place - float(low));
}

void main() {
  vec2 at = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y) + jitter - 0.5 * size;
  vec3 ray = view + at.x * right + at.y * down;
  float square = dot(ray, ray), len = sqrt(square);
  vec3 d = ray / len;

  // Where the ray meets the box; positions count from there, or a distant camera's would lose digits.
  vec3 s = mix(d, vec3(1e-12), lessThan(abs(d), vec3(1e-12)));
  vec3 a = -origin / s, b = (vec3(samples - 1) - origin) / s;
  vec3 near = min(a, b), far = max(a, b);
  float enter = max(max(near.x, max(near.y, near.z)), 0.0), leave = min(far.x, min(far.y, far.z));
  result = vec4(0.0, 0.0, 0.0, shading == 5 ? -1.0 : 0.0);
  if (!(enter < leave)) return;
  vec3 o = clamp(origin + enter * d, vec3(0.0), vec3(samples - 1));
  Hit hit = march(o, d, 0.0);
  if (!hit.found) return;

  float t = enter + hit.t;
  vec3 g = hit.gradient, n = normalize(g);
  if (shading == 4) { result = vec4(n, t); return; }
  if (shading == 1) { result = vec4(0.5 * n + 0.5, 1.0); return; }
  vec3 side = dot(n, d) > 0.0 ? -n : n;
  if (!hasTexture && shading == 0) { result = vec4(albedo * lit(side), 1.0); return; }

  // Transfer to the surface: dp = t dd + dt d, with dt such that dp lies in the tangent plane.
  Mapped map = textured(hit.cell, hit.u, n);
  vec3 dx = t * (right * square - ray * dot(ray, right)) / (square * len);
  vec3 dy = t * (down * square - ray * dot(ray, down)) / (square * len);
  float facing = dot(n, d);
  facing = abs(facing) < 1e-6 ? 1e-6 : facing;
  vec3 dp_dx = dx - d * (dot(n, dx) / facing), dp_dy = dy - d * (dot(n, dy) / facing);
  vec2 duv_dx = vec2(dot(map.du, dp_dx), dot(map.dv, dp_dx));
  vec2 duv_dy = vec2(dot(map.du, dp_dy), dot(map.dv, dp_dy));
  vec2 texels = vec2(textureSize(image, 0)), tx = duv_dx * texels, ty = duv_dy * texels;
  float lod = 0.5 * log2(max(max(dot(tx, tx), dot(ty, ty)), 1e-36));

  if (shading == 5) { result = vec4(map.uv, lod, float(map.chart)); return; }
  if (shading == 2) { result = vec4(linear(vec3(fract(map.uv), 0.45)), 1.0); return; }
  if (shading == 3) {
    result = vec4(linear(map.chart < 0 ? vec3(0.5) : level(lod)) * (0.45 + 0.55 * abs(facing)), 1.0);
    return;
  }
  // The file's first row is the texture's top; it was uploaded first, so v runs down.
  vec2 st = vec2(map.uv.x, 1.0 - map.uv.y), flip = vec2(1.0, -1.0);
  vec3 colour = mipmaps ? textureGrad(image, st, duv_dx * flip, duv_dy * flip).rgb : textureLod(image, st, 0.0).rgb;
  result = vec4(colour * lit(side), 1.0);
}

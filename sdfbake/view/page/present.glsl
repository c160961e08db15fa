#version 300 es
// The mean of all samples so far over the page's colour, to sRGB.
precision highp float;
uniform sampler2D picture;
uniform vec2 size;   // of the canvas
uniform vec3 paper; // linear light
out vec4 result;

void main() {
  vec4 c = texture(picture, gl_FragCoord.xy / size);
  vec3 light = clamp(c.rgb + (1.0 - c.a) * paper, 0.0, 1.0);
  result = vec4(mix(1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, 12.92 * light, lessThanEqual(light, vec3(0.0031308))), 1.0);
}

// From linear radiance to what a screen shows, as torchprt/shade/display.py: exposure, tone map, sRGB.
// three.js is told to convert nothing: these values go to the canvas as they are.

export const DISPLAY = /* glsl */ `
vec3 neutral(vec3 radiance) {
  vec3 x = max(radiance, 0.0);
  float low = min(min(x.r, min(x.g, x.b)), 0.08);
  x -= low - low * low / 0.16;
  float peak = max(x.r, max(x.g, x.b));
  if (peak < 0.76) return x;
  float pressed = 1.0 - 0.0576 / (peak - 0.52);
  return mix(x * (pressed / peak), vec3(pressed), 1.0 - 1.0 / (0.15 * (peak - pressed) + 1.0));
}

vec3 srgb(vec3 radiance) {
  vec3 x = clamp(radiance, 0.0, 1.0);
  return mix(12.92 * x, 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, vec3(greaterThan(x, vec3(0.0031308))));
}

// The colours of torchprt/preview/error_colours.py: blue, cyan, green, yellow, red.
vec3 ramp(float value) {
  vec3 stops[5] = vec3[5](
    vec3(0.0, 0.0, 1.0), vec3(0.0, 1.0, 1.0), vec3(0.0, 1.0, 0.0), vec3(1.0, 1.0, 0.0), vec3(1.0, 0.0, 0.0)
  );
  float place = 4.0 * clamp(value, 0.0, 1.0);
  int low = int(min(floor(place), 3.0));
  return mix(stops[low], stops[low + 1], place - float(low));
}
`;

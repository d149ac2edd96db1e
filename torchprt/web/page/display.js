// From linear radiance to what a screen shows, as torchprt/shade/display.py: exposure, filmic tone map, sRGB.
// three.js is told to convert nothing: these values go to the canvas as they are.

export const DISPLAY = /* glsl */ `
vec3 filmic(vec3 radiance) {
  vec3 x = max(radiance, 0.0);
  vec3 small = min(x, 1.0);
  vec3 large = 1.0 / max(x, 1.0);
  vec3 below = small * (2.51 * small + 0.03) / (small * (2.43 * small + 0.59) + 0.14);
  vec3 above = (2.51 + 0.03 * large) / (2.43 + large * (0.59 + 0.14 * large));
  return min(mix(below, above, vec3(greaterThan(x, vec3(1.0)))), 1.0);
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

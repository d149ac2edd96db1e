// From linear radiance to what a screen shows, as torchprt/shade/display.py: exposure, tone map, sRGB. In GLSL for what
// is drawn and in JavaScript for pictures that are opened; the tests compare both with Python.
// three.js is told to convert nothing: these values go to the canvas as they are.

/** Names of tone maps, with the number that GLSL knows them by as their place. */
export const TONES = ["neutral", "agx", "filmic", "none"];

// Of AgX: linear sRGB to the drawn-in primaries in Rec. 2020 (the product of both), these drawn out again, and back.
const IN = [
  [0.5448120800524265, 0.37379744360262573, 0.08138096422089394],
  [0.14041934536489306, 0.7541077833540266, 0.10539674708202018],
  [0.08881713750335757, 0.1788597553654406, 0.7323154271891407],
];
const OUT = [
  [1.1271005818144368, -0.11060664309660323, -0.016493938717834573],
  [-0.1413297634984383, 1.157823702216272, -0.016493938717834257],
  [-0.14132976349843826, -0.11060664309660294, 1.2519364065950405],
];
const BACK = [
  [1.6605, -0.5876, -0.0728],
  [-0.1246, 1.1329, -0.0083],
  [-0.0182, -0.1006, 1.1187],
];
const [LEAST_STOP, MOST_STOP] = [-12.47393, 4.026069];
const SIGMOID = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232];

const float = (value) => (Number.isInteger(value) ? `${value}.0` : `${value}`);
// GLSL takes columns.
const matrix = (rows) => `mat3(${[0, 1, 2].flatMap((column) => rows.map((row) => float(row[column]))).join(", ")})`;

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

vec3 agx(vec3 radiance) {
  vec3 stops = log2(max(${matrix(IN)} * max(radiance, 0.0), 1e-10));
  vec3 x = clamp((stops - ${float(LEAST_STOP)}) / ${float(MOST_STOP - LEAST_STOP)}, 0.0, 1.0);
  vec3 curve = ${SIGMOID.slice(1).reduce((sum, each) => `((${sum}) * x + ${float(each)})`, `vec3(${float(SIGMOID[0])})`)};
  return clamp(${matrix(BACK)} * pow(max(${matrix(OUT)} * curve, 0.0), vec3(2.2)), 0.0, 1.0);
}

vec3 filmic(vec3 radiance) {
  vec3 x = max(radiance, 0.0);
  vec3 small = min(x, 1.0);
  vec3 large = 1.0 / max(x, 1.0);
  vec3 below = small * (2.51 * small + 0.03) / (small * (2.43 * small + 0.59) + 0.14);
  vec3 above = (2.51 + 0.03 * large) / (2.43 + large * (0.59 + 0.14 * large));
  return min(mix(below, above, vec3(greaterThan(x, vec3(1.0)))), 1.0);
}

vec3 toned(vec3 radiance, int tone) {
  if (tone == 0) return neutral(radiance);
  if (tone == 1) return agx(radiance);
  return tone == 2 ? filmic(radiance) : clamp(radiance, 0.0, 1.0);
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

const clip = (x) => Math.min(Math.max(x, 0), 1);
const times = (rows, v) => rows.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);

const curves = {
  neutral(radiance) {
    const low = Math.min(...radiance, 0.08);
    const x = radiance.map((each) => each - (low - (low * low) / 0.16));
    const peak = Math.max(...x);
    if (peak < 0.76) return x;
    const pressed = 1 - 0.0576 / (peak - 0.52);
    const faded = 1 - 1 / (0.15 * (peak - pressed) + 1);
    return x.map((each) => each * (pressed / peak) * (1 - faded) + pressed * faded);
  },
  agx(radiance) {
    const curve = times(IN, radiance).map((each) => {
      const x = clip((Math.log2(Math.max(each, 1e-10)) - LEAST_STOP) / (MOST_STOP - LEAST_STOP));
      return SIGMOID.reduce((sum, coefficient) => sum * x + coefficient, 0);
    });
    const out = times(OUT, curve).map((each) => Math.max(each, 0) ** 2.2);
    return times(BACK, out).map(clip);
  },
  filmic: (radiance) => radiance.map((x) => Math.min((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14), 1)),
  none: (radiance) => radiance.map(clip),
};

/** sRGB in [0, 1] of linear radiance `[r, g, b]`, exposed by `stops`, under one of `TONES`. */
export function display(radiance, stops, tone) {
  const exposed = radiance.map((each) => Math.max(each, 0) * 2 ** stops);
  return curves[tone](exposed).map((each) => {
    const x = clip(each);
    return x > 0.0031308 ? 1.055 * x ** (1 / 2.4) - 0.055 : 12.92 * x;
  });
}

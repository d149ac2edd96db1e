// Windows against ringing, as torchprt.sh: a factor a band, and the weakest one that leaves no negative radiance.
import { basis } from "./sh.js";

export const WINDOWS = ["none", "hann", "lanczos", "gauss", "least", "auto"];

// The search for the lowest value: directions a coefficient, valleys followed, and how each is closed in on.
const [DENSITY, VALLEYS, STEPS, SHRINK, BISECTIONS] = [64, 8, 12, 0.4, 30];
const FLOAT32 = 2 ** -23;

const factor = {
  none: () => 1,
  hann: (l, order) => (1 + Math.cos((Math.PI * l) / order)) / 2,
  lanczos: (l, order) => (l ? Math.sin((Math.PI * l) / order) / ((Math.PI * l) / order) : 1),
  gauss: (l, order) => Math.exp(-0.5 * (Math.PI / order) ** 2 * l * (l + 1)),
};

/** `light`, N x 3 of which `order` bands are left, under one of `WINDOWS` made for these bands. */
export function windowed(light, order, name) {
  if (name === "least") return scaled(light, leastWindow(light, order));
  // What is gathered in the narrowest lobe that shadowed receivers have.
  if (name === "auto") return scaled(light, leastWindow(light, order, phong(order ** 2 / 3, order)));
  return scaled(light, bands(order, (l) => factor[name](l, order)));
}

/** The band coefficients of the lobe cos^k, 1 in band 0. */
function phong(k, order) {
  const factors = [1, (k + 1) / (k + 2)];
  for (let l = 0; l < order - 2; l++) factors.push((factors[l] * (k - l)) / (k + l + 3));
  return factors.slice(0, order);
}

const bands = (order, of) => Array.from({ length: order }, (_, l) => of(l));

function scaled(light, factors) {
  const out = light.slice();
  factors.forEach((each, l) => {
    for (let i = 3 * l * l; i < 3 * (l + 1) * (l + 1); i++) out[i] = each * light[i];
  });
  return out;
}

/**
 * The factors of the weakest Gaussian that leaves the light, convolved with `kernel` if there is one, nowhere negative:
 * one window for all channels; ones if it is so already. Throws if the mean of a channel is negative, which no window mends.
 */
export function leastWindow(light, order, kernel = bands(order, () => 1)) {
  if (light.slice(0, 3).some((mean) => mean < 0)) {
    throw new Error("this light has a channel whose mean is negative, which no window mends");
  }
  const exact = scaled(Float64Array.from(light.slice(0, 3 * order * order)), kernel);
  const set = searchSet(order);
  const gauss = (base) => bands(order, (l) => base ** ((l * (l + 1)) / 2));
  const nonNegative = (factors, tolerance) => {
    const { least, largest } = extremes(scaled(exact, factors), order, set);
    return least >= -tolerance * largest;
  };
  if (nonNegative(bands(order, () => 1), 4 * order * FLOAT32)) return bands(order, () => 1);
  let [weak, strong] = [1, 0];
  for (let step = 0; step < BISECTIONS; step++) {
    const middle = (weak + strong) / 2;
    if (nonNegative(gauss(middle), 0)) strong = middle;
    else weak = middle;
  }
  return gauss(strong);
}

/** The least value over directions and channels, and the largest magnitude. */
export function extremes(light, order, { directions, table, neighbours } = searchSet(order)) {
  const count = order * order;
  const places = directions.length / 3;
  let [least, largest] = [Infinity, 0];
  const valleys = [];
  const values = new Float64Array(places);
  for (let channel = 0; channel < 3; channel++) {
    for (let d = 0; d < places; d++) {
      let sum = 0;
      for (let i = 0; i < count; i++) sum += table[d * count + i] * light[3 * i + channel];
      values[d] = sum;
      least = Math.min(least, sum);
      largest = Math.max(largest, Math.abs(sum));
    }
    for (let d = 0; d < places; d++) {
      if (neighbours[d].every((other) => values[d] <= values[other])) valleys.push([values[d], channel, d]);
    }
  }
  valleys.sort((a, b) => a[0] - b[0]);
  for (const [, channel, d] of valleys.slice(0, VALLEYS)) {
    const start = Array.from(directions.subarray(3 * d, 3 * d + 3));
    least = Math.min(least, descend(light, order, channel, start));
  }
  return { least, largest };
}

/** The lowest value near `start`, by a pattern of 25 directions that closes in on it. */
function descend(light, order, channel, start) {
  const values = new Float64Array(order * order);
  let reach = 2 / (order * Math.sqrt(DENSITY));
  let best = Infinity;
  for (let step = 0; step < STEPS; step++) {
    // Any axis far from the direction gives a tangent frame.
    const size = start.map(Math.abs);
    const away = [0, 0, 0];
    away[size.indexOf(Math.min(...size))] = 1;
    const tangent = unit(cross(start, away));
    const other = cross(start, tangent);
    let [lowest, place] = [Infinity, start];
    for (let a = -2; a <= 2; a++) {
      for (let b = -2; b <= 2; b++) {
        const at = unit(start.map((x, k) => x + (reach / 2) * (a * tangent[k] + b * other[k])));
        basis(...at, order, values);
        let sum = 0;
        for (let i = 0; i < values.length; i++) sum += values[i] * light[3 * i + channel];
        if (sum < lowest) [lowest, place] = [sum, at];
      }
    }
    start = place;
    best = Math.min(best, lowest);
    reach *= SHRINK;
  }
  return best;
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));

const sets = new Map();

/** A Fibonacci spiral, the basis on it, and of each direction the eight next to it. */
function searchSet(order) {
  if (sets.has(order)) return sets.get(order);
  const count = order * order;
  const places = DENSITY * count;
  const directions = new Float64Array(3 * places);
  const table = new Float64Array(places * count);
  for (let d = 0; d < places; d++) {
    const z = 1 - (2 * d + 1) / places;
    const turn = 2 * Math.PI * ((d * (2 / (1 + Math.sqrt(5)))) % 1);
    const radius = Math.sqrt((1 - z) * (1 + z));
    const at = [radius * Math.cos(turn), radius * Math.sin(turn), z];
    directions.set(at, 3 * d);
    basis(...at, order, table.subarray(d * count, (d + 1) * count));
  }
  const made = { directions, table, neighbours: nearest(directions) };
  sets.set(order, made);
  return made;
}

/** Of every direction the eight nearest; z falls along the list, so that far in it is far in z. */
function nearest(directions) {
  const places = directions.length / 3;
  return Array.from({ length: places }, (_, d) => {
    const found = [];
    for (const sense of [-1, 1]) {
      for (let e = d + sense; e >= 0 && e < places; e += sense) {
        const apart = [0, 1, 2].reduce((sum, k) => sum + (directions[3 * d + k] - directions[3 * e + k]) ** 2, 0);
        const farthest = found.length < 8 ? Infinity : found[7][0];
        if ((directions[3 * d + 2] - directions[3 * e + 2]) ** 2 > farthest) break;
        if (apart >= farthest) continue;
        found.push([apart, e]);
        found.sort((a, b) => a[0] - b[0]);
        found.length = Math.min(found.length, 8);
      }
    }
    return found.map(([, e]) => e);
  });
}

// Irradiance from spherical harmonics. Order, index and sign are those of torchprt: l(l+1) + m, Condon-Shortley.

/** Of the clamped cosine, over pi: what reflects from a white diffuse surface, for each of `order` bands. */
export function readings(order) {
  const half = (l) => (l === 0 ? 1 : (half(l - 2) * (l - 1)) / l); // l! / (2^l (l/2)!^2)
  return Array.from({ length: order }, (_, l) => {
    if (l < 2) return l ? 2 / 3 : 1;
    return l % 2 ? 0 : ((l % 4 ? 2 : -2) * half(l)) / ((l + 2) * (l - 1));
  });
}

/** The real orthonormal basis at the unit direction (x, y, z), written into `out`, of `order` bands. */
export function basis(x, y, z, order, out) {
  let sectoral = Math.sqrt(1 / (4 * Math.PI));
  let real = 1;
  let imaginary = 0;
  for (let m = 0; m < order; m++) {
    if (m > 0) {
      // (x + iy)^m, and Q_m^m with the sign (-1)^m.
      [real, imaginary] = [real * x - imaginary * y, real * y + imaginary * x];
      sectoral *= -Math.sqrt((2 * m + 1) / (2 * m));
    }
    const scale = m > 0 ? Math.SQRT2 : 1;
    let below = 0;
    let here = sectoral;
    for (let l = m; l < order; l++) {
      if (l > m) {
        const a = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
        const b = Math.sqrt(((l - 1) * (l - 1) - m * m) / (4 * (l - 1) * (l - 1) - 1));
        [below, here] = [here, a * (z * here - b * below)];
      }
      out[l * (l + 1) + m] = scale * here * real;
      if (m > 0) out[l * (l + 1) - m] = scale * here * imaginary;
    }
  }
  return out;
}

/**
 * What unshadowed white diffuse surfaces reflect, irradiance / pi, as a function `(x, y, z, out)` of their normals.
 * `light`: N x 3 coefficients.
 */
export function irradiance(light) {
  const order = Math.round(Math.sqrt(light.length / 3));
  const reflected = readings(order);
  const count = order * order;
  const values = new Float64Array(count);
  const filtered = new Float64Array(3 * count);
  for (let l = 0; l < order; l++) {
    for (let i = 3 * l * l; i < 3 * (l + 1) * (l + 1); i++) filtered[i] = reflected[l] * light[i];
  }
  return (x, y, z, out) => {
    basis(x, y, z, order, values);
    let [red, green, blue] = [0, 0, 0];
    for (let i = 0; i < count; i++) {
      red += values[i] * filtered[3 * i];
      green += values[i] * filtered[3 * i + 1];
      blue += values[i] * filtered[3 * i + 2];
    }
    out[0] = red;
    out[1] = green;
    out[2] = blue;
  };
}

/** `light` without the bands from `order` on. */
export function lowBands(light, order) {
  const low = Float32Array.from(light);
  low.fill(0, 3 * order * order);
  return low;
}

const rules = new Map();

/** Points and weights of a rule that is exact for products of two functions of `order` bands, and the basis at them. */
function rule(order) {
  if (rules.has(order)) return rules.get(order);
  const [count, around] = [order * order, 2 * order - 1];
  const points = [];
  for (let i = 0; i < order; i++) {
    // Gauss and Legendre: a root of the polynomial of degree `order`, by Newton.
    let z = Math.cos((Math.PI * (i + 0.75)) / (order + 0.5));
    let slope = 1;
    for (let step = 0; step < 16; step++) {
      let [below, here] = [1, z];
      for (let l = 2; l <= order; l++) [below, here] = [here, ((2 * l - 1) * z * here - (l - 1) * below) / l];
      slope = (order * (below - z * here)) / (1 - z * z);
      z -= here / slope;
    }
    const weight = ((2 / ((1 - z * z) * slope * slope)) * 2 * Math.PI) / around;
    const across = Math.sqrt(1 - z * z);
    for (let k = 0; k < around; k++) {
      const phi = (2 * Math.PI * k) / around;
      points.push({ at: [across * Math.cos(phi), across * Math.sin(phi), z], weight });
    }
  }
  for (const point of points) {
    point.values = basis(...point.at, order, new Float64Array(count)).map((each) => each * point.weight);
  }
  rules.set(order, points);
  return points;
}

/**
 * `light`, N x 3, turned by the row-major rotation R: where it was f(s), it is f(R^T s). Exact up to rounding, for any
 * rotation: the turned light is read at the points of a rule and projected again.
 */
export function rotate(light, rotation) {
  const order = Math.round(Math.sqrt(light.length / 3));
  const count = order * order;
  const turned = new Float64Array(3 * count);
  const values = new Float64Array(count);
  for (const { at, values: weighed } of rule(order)) {
    const [x, y, z] = [0, 1, 2].map((i) => rotation[i] * at[0] + rotation[3 + i] * at[1] + rotation[6 + i] * at[2]);
    basis(x, y, z, order, values);
    let [red, green, blue] = [0, 0, 0];
    for (let i = 0; i < count; i++) {
      red += values[i] * light[3 * i];
      green += values[i] * light[3 * i + 1];
      blue += values[i] * light[3 * i + 2];
    }
    for (let i = 0; i < count; i++) {
      turned[3 * i] += weighed[i] * red;
      turned[3 * i + 1] += weighed[i] * green;
      turned[3 * i + 2] += weighed[i] * blue;
    }
  }
  return turned;
}

// Ways to shade that need no transfer, and the difference between two of any.
import { irradiance } from "./sh.js";

/** Row-major `R^T (x, y, z)`: a light turned by R is looked up where the direction comes from. */
function back(rotation, x, y, z, out) {
  for (let i = 0; i < 3; i++) out[i] = rotation[i] * x + rotation[3 + i] * y + rotation[6 + i] * z;
}

/** albedo * irradiance / pi of every vertex under `light` turned by `rotation`, no shadows. */
export function unshadowed(mesh, light, rotation) {
  const { normals, albedo } = mesh;
  const radiance = new Float32Array(normals.length);
  const reflect = irradiance(light);
  const [normal, reading] = [[0, 0, 0], [0, 0, 0]];
  for (let i = 0; i < normals.length; i += 3) {
    back(rotation, normals[i], normals[i + 1], normals[i + 2], normal);
    reflect(...normal, reading);
    for (let c = 0; c < 3; c++) radiance[i + c] = albedo[i + c] * reading[c];
  }
  return radiance;
}

/** albedo * colour * max(N.L, 0): the one lamp `{direction, colour}` that stands best for the light. */
export function lambert(mesh, lamp, rotation) {
  const { normals, albedo } = mesh;
  const radiance = new Float32Array(normals.length);
  const normal = [0, 0, 0];
  for (let i = 0; i < normals.length; i += 3) {
    back(rotation, normals[i], normals[i + 1], normals[i + 2], normal);
    const cosine = Math.max(0, normal[0] * lamp.direction[0] + normal[1] * lamp.direction[1] + normal[2] * lamp.direction[2]);
    for (let c = 0; c < 3; c++) radiance[i + c] = albedo[i + c] * lamp.colour[c] * cosine;
  }
  return radiance;
}

/**
 * `|a - b|` of every vertex over `full` times the root mean square of `b`, the same in each channel (RMS over the
 * channels), and the relative RMS of all.
 */
export function difference(a, b, full) {
  let [square, error] = [0, 0];
  for (let i = 0; i < b.length; i++) {
    square += b[i] * b[i];
    error += (a[i] - b[i]) * (a[i] - b[i]);
  }
  const unit = full * Math.sqrt(square / b.length) || 1;
  const shown = new Float32Array(b.length);
  for (let i = 0; i < b.length; i += 3) {
    const apart = Math.hypot(a[i] - b[i], a[i + 1] - b[i + 1], a[i + 2] - b[i + 2]) / Math.sqrt(3);
    shown.fill(apart / unit, i, i + 3);
  }
  return { shown, relative: square > 0 ? Math.sqrt(error / square) : 0 };
}

// From a latitude-longitude map to spherical harmonics, as torchprt.light.project.
import { basis } from "./sh.js";

/**
 * Coefficients, N x 3, of the radiance in `data`: `height` rows of `2 height` pixels of 3 numbers, row 0 up, the middle
 * column along -z, columns to the right of it toward +x; with the exact solid angles of the texels.
 *
 * Along a row the basis is a trigonometric polynomial of degree below `order`, so that a row is summed once against as
 * many sines and cosines, and then stands for 2 order - 1 points: few operations a pixel, in float64.
 */
export function project({ data, width, height }, order) {
  const count = order * order;
  const light = new Float64Array(3 * count);
  const points = 2 * order - 1;
  const cosine = waves(order, width, Math.cos);
  const sine = waves(order, width, Math.sin);
  const values = new Float64Array(count);
  const sums = new Float64Array(6);
  const weighed = new Float64Array(3 * points);
  for (let row = 0; row < height; row++) {
    const theta = (Math.PI * (row + 0.5)) / height;
    const area = 2 * Math.sin(theta) * Math.sin(Math.PI / (2 * height)) * ((2 * Math.PI) / width);
    weighed.fill(0);
    for (let m = 0; m < order; m++) {
      fourier(data, 3 * width * row, width, cosine[m], sine[m], sums);
      const scale = ((m ? 2 : 1) * area) / points;
      for (let k = 0; k < points; k++) {
        const turn = (2 * Math.PI * m * k) / points;
        const [c, s] = [scale * Math.cos(turn), scale * Math.sin(turn)];
        for (let channel = 0; channel < 3; channel++) {
          weighed[3 * k + channel] += c * sums[channel] + s * sums[3 + channel];
        }
      }
    }
    const [around, up] = [Math.sin(theta), Math.cos(theta)];
    for (let k = 0; k < points; k++) {
      const phi = (2 * Math.PI * k) / points;
      basis(around * Math.sin(phi), up, -around * Math.cos(phi), order, values);
      for (let i = 0; i < count; i++) {
        for (let channel = 0; channel < 3; channel++) light[3 * i + channel] += values[i] * weighed[3 * k + channel];
      }
    }
  }
  return light;
}

/** `wave(m phi)` at the middle of every column, for every m below `order`. */
function waves(order, width, wave) {
  return Array.from({ length: order }, (_, m) =>
    Float64Array.from({ length: width }, (_, column) => wave(m * Math.PI * ((2 * column + 1) / width - 1))),
  );
}

/** Sums of three channels from `start` on times `cosine`, then times `sine`. */
function fourier(data, start, width, cosine, sine, sums) {
  let [red, green, blue, r, g, b] = [0, 0, 0, 0, 0, 0];
  for (let column = 0, at = start; column < width; column++, at += 3) {
    const [c, s] = [cosine[column], sine[column]];
    red += c * data[at];
    green += c * data[at + 1];
    blue += c * data[at + 2];
    r += s * data[at];
    g += s * data[at + 1];
    b += s * data[at + 2];
  }
  sums.set([red, green, blue, r, g, b]);
}

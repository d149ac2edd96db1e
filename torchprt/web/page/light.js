// A light of the page from an image: what torchprt/web/environment.py makes of one.
import { display } from "./display.js";
import { project } from "./project.js";
import { basis, irradiance, readings } from "./sh.js";

// Rows of the picture that stands behind the model, and of the map of directions that the exposure is measured in.
const [ROWS, METER] = [256, 24];
const LUMINANCE = [0.2126, 0.7152, 0.0722];
const luminance = (data, at) => LUMINANCE[0] * data[at] + LUMINANCE[1] * data[at + 1] + LUMINANCE[2] * data[at + 2];

/** `{name, coefficients, exposure, lamp, picture}` of `image` (`{data, width, height}`) at `order`. */
export function lightOf(name, image, order) {
  const coefficients = project(image, order);
  return {
    name,
    coefficients: Float32Array.from(coefficients),
    exposure: exposure(coefficients),
    lamp: dominant(coefficients, order),
    picture: photograph(image),
  };
}

/** Stops at which a white surface that faces most of the light is just white; 0 for a black light. */
export function exposure(light) {
  // Bands from the fifth on hardly reach a diffuse surface.
  const reflect = irradiance(light.slice(0, 75));
  const reading = [0, 0, 0];
  let most = 0;
  for (let row = 0; row < METER; row++) {
    const theta = (Math.PI * (row + 0.5)) / METER;
    for (let column = 0; column < 2 * METER; column++) {
      const phi = Math.PI * ((2 * column + 1) / (2 * METER) - 1);
      reflect(Math.sin(theta) * Math.sin(phi), Math.cos(theta), -Math.sin(theta) * Math.cos(phi), reading);
      most = Math.max(most, luminance(reading, 0));
    }
  }
  return most > 0 ? -Math.log2(most) : 0;
}

/** The lamp `{direction, colour}` that stands best for the light: torchprt.light.dominant. */
export function dominant(light, order) {
  const vector = order > 1 ? [-luminance(light, 9), -luminance(light, 3), luminance(light, 6)] : [0, 0, 0];
  const length = Math.hypot(...vector);
  const direction = length > 0 ? vector.map((each) => each / length) : [0, 1, 0];
  const lamp = basis(...direction, order, new Float64Array(order * order));
  // So that a surface that faces it reads 1.
  const facing = readings(order).reduce((sum, each, l) => sum + (each * (2 * l + 1)) / (4 * Math.PI), 0);
  for (let i = 0; i < lamp.length; i++) lamp[i] /= facing;
  const norm = lamp.reduce((sum, each) => sum + each * each, 0);
  const colour = [0, 1, 2].map((c) => Math.max(0, lamp.reduce((sum, each, i) => sum + each * light[3 * i + c], 0) / norm));
  return { direction, colour };
}

/** A small canvas of the image, exposed so that its mean without the lamps is a middle grey. */
function photograph(image) {
  const { data, width, height } = image.height > ROWS ? shrunk(image) : image;
  const bright = Float32Array.from({ length: width * height }, (_, i) => luminance(data, 3 * i));
  const cut = 4 * bright.slice().sort()[(bright.length - 1) >> 1];
  const middle = bright.reduce((sum, each) => sum + Math.min(each, cut), 0) / bright.length;
  const stops = middle > 0 ? Math.log2(0.3 / middle) : 0;
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(width, height);
  for (let i = 0; i < width * height; i++) {
    const shown = display([data[3 * i], data[3 * i + 1], data[3 * i + 2]], stops, "neutral");
    for (let c = 0; c < 3; c++) pixels.data[4 * i + c] = Math.round(255 * shown[c]);
    pixels.data[4 * i + 3] = 255;
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

/** The means over the texels that each of `ROWS` rows and twice as many columns covers. */
function shrunk({ data, width, height }) {
  const [rows, columns] = [ROWS, 2 * ROWS];
  const out = new Float32Array(3 * rows * columns);
  const bounds = (index, size, of) => [Math.floor((index * of) / size), Math.ceil(((index + 1) * of) / size)];
  for (let row = 0; row < rows; row++) {
    const [top, bottom] = bounds(row, rows, height);
    for (let column = 0; column < columns; column++) {
      const [left, right] = bounds(column, columns, width);
      const sum = [0, 0, 0];
      for (let y = top; y < bottom; y++) {
        for (let at = 3 * (y * width + left); at < 3 * (y * width + right); at += 3) {
          for (let c = 0; c < 3; c++) sum[c] += data[at + c];
        }
      }
      for (let c = 0; c < 3; c++) out[3 * (row * columns + column) + c] = sum[c] / ((bottom - top) * (right - left));
    }
  }
  return { data: out, width: columns, height: rows };
}

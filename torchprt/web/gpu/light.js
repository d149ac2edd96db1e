// Lights as SH coefficients, turned on the CPU.
import { DataUtils, HalfFloatType, Matrix4, Quaternion, UnsignedByteType } from "three";
import { project } from "../page/project.js";
import { rotate } from "../page/sh.js";

const QUARTER = [0, 0, -1, 0, 1, 0, 1, 0, 0];

/** Row-major, of a Quaternion. */
export function rowsOf(quaternion) {
  const e = new Matrix4().makeRotationFromQuaternion(quaternion).elements;
  return [e[0], e[4], e[8], e[1], e[5], e[9], e[2], e[6], e[10]];
}

/**
 * A light: `coefficients`, N x 3 numbers, N = order^2, of linear radiance, in rows or flat, as torchprt has them;
 * `quaternion` turns it, `intensity` scales it. `exposure` is what suits it, in stops, and changes nothing by itself.
 */
export class PRTLight {
  constructor(coefficients, name = "") {
    this.coefficients = Float64Array.from(Array.isArray(coefficients[0]) ? coefficients.flat() : coefficients);
    const order = Math.round(Math.sqrt(this.coefficients.length / 3));
    if (!order || 3 * order * order !== this.coefficients.length) {
      throw new Error(`A light has ${this.coefficients.length} numbers: give 3 for each of order^2 coefficients.`);
    }
    this.order = order;
    this.name = name;
    this.quaternion = new Quaternion();
    this.intensity = 1;
    this.exposure = 0;
  }

  /**
   * What an equirectangular DataTexture of RGBELoader, HDRLoader or EXRLoader sends, at `order`. It comes from where
   * three.js shows the texture as `scene.background`; torchprt itself has the middle of a picture at -z, three.js at +x.
   */
  static fromEquirect(texture, order) {
    const { data, width, height } = texture.image;
    const channels = data.length / (width * height);
    if (texture.type === UnsignedByteType || channels < 3) {
      throw new Error("A light is an equirectangular texture of float or half-float RGB: load an .hdr or .exr.");
    }
    const read = texture.type === HalfFloatType ? DataUtils.fromHalfFloat : (each) => each;
    const pixels = new Float32Array(3 * width * height);
    for (let row = 0; row < height; row++) {
      // Without flipY the first row of a texture is the lowest of the picture.
      const from = channels * width * (texture.flipY ? row : height - 1 - row);
      for (let column = 0; column < width; column++) {
        for (let c = 0; c < 3; c++) pixels[3 * (row * width + column) + c] = read(data[from + channels * column + c]);
      }
    }
    return new PRTLight(rotate(project({ data: pixels, width, height }, order), QUARTER), texture.name);
  }

  /** The numbers at `order`, turned by its quaternion and then by another. */
  turned(order, quaternion = new Quaternion()) {
    const wanted = new Float64Array(3 * order * order);
    wanted.set(this.coefficients.subarray(0, wanted.length));
    for (let i = 0; i < wanted.length; i++) wanted[i] *= this.intensity;
    return Float32Array.from(rotate(wanted, rowsOf(quaternion.clone().multiply(this.quaternion))));
  }
}

/** Lights of a file that torchprt wrote: the .npy of `torchprt light`, or the lights.json or scene.json of a folder. */
export async function loadLights(url) {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url} could not be read (${answer.status} ${answer.statusText}).`);
  const buffer = await answer.arrayBuffer();
  const bytes = new Uint8Array(buffer);
  if (bytes[0] === 0x93) return [new PRTLight(readArray(buffer, url), String(url))];
  const { environments } = JSON.parse(new TextDecoder().decode(bytes));
  return environments.map(({ name, coefficients, exposure = 0 }) =>
    Object.assign(new PRTLight(coefficients, name), { exposure }),
  );
}

/** The numbers of an .npy of float32 or float64, little-endian, as numpy writes it. */
function readArray(buffer, url) {
  const view = new DataView(buffer);
  const long = view.getUint8(6) > 1;
  const start = (long ? 12 : 10) + (long ? view.getUint32(8, true) : view.getUint16(8, true));
  const header = new TextDecoder().decode(new Uint8Array(buffer, 0, start));
  const [, type] = /'descr': '<f([48])'/.exec(header) ?? [];
  if (!type || !/'fortran_order': False/.test(header)) {
    throw new Error(`${url} is no array of float32 or float64 in rows: write it with torchprt light.`);
  }
  return new (type === "8" ? Float64Array : Float32Array)(buffer.slice(start));
}

// torchprt 0.1.0: baked light transfer in scenes of three.js. Copy this file; it imports three alone.
// Made by docs/make/gpu.py from torchprt/web/page and torchprt/web/gpu: change it there. MIT licence.
// docs/gpu.md of torchprt shows how it is used.
import {
  DataArrayTexture,
  DataTexture,
  DataUtils,
  FileLoader,
  FloatType,
  FrontSide,
  GLSL3,
  HalfFloatType,
  LinearFilter,
  Matrix3,
  Matrix4,
  Mesh,
  NearestFilter,
  NoBlending,
  OrthographicCamera,
  PlaneGeometry,
  Quaternion,
  RGBAFormat,
  RawShaderMaterial,
  RedIntegerFormat,
  Scene,
  ShaderMaterial,
  UnsignedByteType,
  UnsignedIntType,
  UnsignedShortType,
  Vector3,
  WebGLRenderTarget,
} from "three";

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

// From a latitude-longitude map to spherical harmonics, as torchprt.light.project.

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

// The functions of prt.glsl; the text is put here when the module is made.
export const PRT = /* glsl */ `// Precomputed radiance transfer: what a shader does with transfer that torchprt baked. GLSL ES 3.00 and GLSL 3.30 on.
//
// Numbers are those of torchprt, nothing is converted:
// - SH basis real, orthonormal, with the Condon-Shortley sign, index l(l + 1) + m: y_00 = .282095, y_1-1 = -.488603 y,
//   y_10 = .488603 z, y_11 = -.488603 x. The world is right-handed; whatever axis is up.
// - Light: coefficients of linear RGB radiance that arrives from s, turned into the frame that the transfer was baked in.
//   A light of radiance 1 from everywhere is (3.544908, 0, 0, ...).
// - Transfer has 1/pi and shadows in it. What comes out times the albedo is linear exit radiance: expose it, tone map it
//   and encode it as sRGB yourself. A black corner may come out a little below 0: clamp it there.
// PRT_ORDER is the number of bands, 1 to 8 or so; define it before this text.
#ifndef PRT_ORDER
#define PRT_ORDER 3
#endif
#define PRT_COUNT (PRT_ORDER * PRT_ORDER)

// The basis at a unit direction.
void prtBasis(vec3 s, out float y[PRT_COUNT]) {
  float sectoral = 0.28209479177387814;
  float real = 1.0;
  float imaginary = 0.0;
  for (int m = 0; m < PRT_ORDER; m++) {
    if (m > 0) {
      // (x + iy)^m.
      float before = real;
      real = before * s.x - imaginary * s.y;
      imaginary = before * s.y + imaginary * s.x;
      sectoral *= -sqrt(float(2 * m + 1) / float(2 * m));
    }
    float scale = m > 0 ? 1.4142135623730951 : 1.0;
    float below = 0.0;
    float here = sectoral;
    for (int l = m; l < PRT_ORDER; l++) {
      if (l > m) {
        float a = sqrt(float(4 * l * l - 1) / float(l * l - m * m));
        float b = sqrt(float((l - 1) * (l - 1) - m * m) / float(4 * (l - 1) * (l - 1) - 1));
        float above = a * (s.z * here - b * below);
        below = here;
        here = above;
      }
      y[l * (l + 1) + m] = scale * here * real;
      if (m > 0) y[l * (l + 1) - m] = scale * here * imaginary;
    }
  }
}

// Radiance over albedo of a diffuse receiver: its transfer vector times the light. One channel for all colours.
vec3 prtDiffuse(float transfer[PRT_COUNT], vec3 light[PRT_COUNT]) {
  vec3 sum = vec3(0.0);
  for (int i = 0; i < PRT_COUNT; i++) sum += transfer[i] * light[i];
  return sum;
}

// The same where light bounced off coloured surfaces: three channels.
vec3 prtDiffuseColour(vec3 transfer[PRT_COUNT], vec3 light[PRT_COUNT]) {
  vec3 sum = vec3(0.0);
  for (int i = 0; i < PRT_COUNT; i++) sum += transfer[i] * light[i];
  return sum;
}

// One zonal lobe: the light that it gathers about \`axis\`, a unit vector in the frame of the light. \`bands\`: g*_l of a
// colour each, SH coefficients over y_lm(axis). Where bands 0 and 1 are stored apart, their entries are 0 here.
// A surface that deformation turns by R has the axes R a, and the same bands.
vec3 prtLobe(vec3 axis, vec3 bands[PRT_ORDER], vec3 light[PRT_COUNT]) {
  float y[PRT_COUNT];
  prtBasis(axis, y);
  vec3 sum = vec3(0.0);
  for (int l = 0; l < PRT_ORDER; l++) {
    vec3 band = vec3(0.0);
    for (int i = l * l; i < (l + 1) * (l + 1); i++) band += y[i] * light[i];
    sum += bands[l] * band;
  }
  return sum;
}

// Bands 0 and 1 that are stored apart, \`low\` = t_00, t_1-1, t_10, t_11, on a surface that is turned: band 1 is the vector
// (-t_11, -t_1-1, t_10).
vec4 prtTurnedLinear(vec4 low, mat3 turn) {
  vec3 turned = turn * vec3(-low.w, -low.y, low.z);
  return vec4(low.x, -turned.y, turned.z, -turned.x);
}

// The rotation nearest to a matrix that blends those of bones: its polar factor, by Newton's iteration.
mat3 prtNearestRotation(mat3 m) {
  mat3 q = m / pow(max(abs(determinant(m)), 1e-30), 1.0 / 3.0);
  for (int i = 0; i < 6; i++) q = 0.5 * (q + transpose(inverse(q)));
  return q;
}

// Compression in clusters, as D3DX: the mean of the cluster and each of its PCA vectors are put under the light once,
// on the CPU; what a receiver adds are its weights. \`PRT_VECTORS\` PCA vectors a cluster, defined before this text.
#ifdef PRT_VECTORS
vec3 prtClustered(vec3 meanUnderLight, vec3 vectorsUnderLight[PRT_VECTORS], float weights[PRT_VECTORS]) {
  vec3 sum = meanUnderLight;
  for (int i = 0; i < PRT_VECTORS; i++) sum += weights[i] * vectorsUnderLight[i];
  return sum;
}
#endif

// Where the eye is, \`toward\` it, in the local frame of a receiver; an eye below the horizon is brought up to it.
vec3 prtLocalView(vec3 toward, vec3 tangent, vec3 normal) {
  vec3 local = vec3(dot(tangent, toward), dot(cross(normal, tangent), toward), max(dot(normal, toward), 0.0));
  float largest = max(max(abs(local.x), abs(local.y)), local.z);
  return largest > 1e-18 ? normalize(local / largest) : vec3(0.0, 0.0, 1.0);
}

// The exit functions of a glossy layer at a local direction. \`table\`: slope, level and across, and \`sectoral\`, of the
// header of transfer.bin. PRT_ORDER is here that of the exit functions. Radiance is the specular colour times the sum
// over i of e[i] times row i of the matrix of the receiver under the light.
void prtExitFunctions(vec3 v, vec3 table[PRT_COUNT], float sectoral[PRT_ORDER], out float e[PRT_COUNT]) {
  e[0] = sectoral[0];
  for (int l = 1; l < PRT_ORDER; l++) {
    int start = l * l;
    int last = (l - 1) * (l - 1);
    float cosine = e[start - 1];
    float sine = l > 1 ? e[last] : 0.0;
    e[start] = sectoral[l] * (v.x * sine + v.y * cosine);
    e[start + 2 * l] = sectoral[l] * (v.x * cosine - v.y * sine);
    for (int i = 1; i < 2 * l; i++) {
      float risen = e[last + i - 1] * (table[start + i].x * v.z + table[start + i].y);
      if (i > 1 && i < 2 * l - 1) risen -= table[start + i].z * e[last - 2 * l + 3 + i - 2];
      e[start + i] = risen;
    }
  }
}
`;

// Lights as SH coefficients, turned on the CPU.

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

// transfer.bin: a safetensors file, whose header says what each part of the transfer is.

const ARRAYS = { F16: Uint16Array, F32: Float32Array, U16: Uint16Array, U32: Uint32Array };

/** `{about, tensors}` of what `torchprt export --three` wrote; a tensor is `{type, shape, data}`. */
export function parseTransfer(buffer) {
  const length = buffer.byteLength > 8 ? Number(new DataView(buffer).getBigUint64(0, true)) : Infinity;
  if (!(length <= buffer.byteLength - 8)) throw new Error("This is no transfer, or half of one: export it again.");
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const about = JSON.parse(header.__metadata__?.torchprt_gpu ?? "null");
  if (about?.format !== 1) {
    throw new Error("This is no transfer for shaders, or a newer one: write it with torchprt export --three.");
  }
  const tensors = {};
  delete header.__metadata__;
  for (const [name, { dtype, shape, data_offsets: [first, end] }] of Object.entries(header)) {
    if (8 + length + end > buffer.byteLength) throw new Error("This is half of a transfer: copy the file again.");
    tensors[name] = { type: dtype, shape, data: new ARRAYS[dtype](buffer.slice(8 + length + first, 8 + length + end)) };
  }
  return { about, tensors };
}

// Arrays as textures, which shaders read by number.

/** What a shader says before it reads such textures. */
export const FETCH = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
vec4 prtFetch(sampler2D numbers, int i) {
  int width = textureSize(numbers, 0).x;
  return texelFetch(numbers, ivec2(i % width, i / width), 0);
}
int prtFetchWhole(usampler2D numbers, int i) {
  int width = textureSize(numbers, 0).x;
  return int(texelFetch(numbers, ivec2(i % width, i / width), 0).r);
}`;

/** Columns and rows for so many texels: about a square. */
export function sizeFor(count) {
  const width = Math.max(1, 2 ** Math.ceil(Math.log2(Math.sqrt(Math.max(1, count)))));
  return [width, Math.max(1, Math.ceil(count / width))];
}

/** Throws a sentence if the graphics card lacks what textures and targets of these sizes take. */
export function checkCard(renderer, images) {
  if (!renderer.extensions.has("EXT_color_buffer_float")) {
    throw new Error("This graphics card does not draw into textures of floating point: use transfer in attributes.");
  }
  const most = renderer.capabilities.maxTextureSize;
  const size = Math.max(...images.flatMap(({ width, height }) => [width, height]));
  if (size > most) {
    throw new Error(`This transfer takes a texture of ${size} texels along a side, and the graphics card ${most}: compress it.`);
  }
}

/** Rows of four numbers, F16 or F32, or single whole ones, U16 or U32. */
export function textureOf({ type, data }) {
  const whole = type[0] === "U";
  const numbers = whole ? 1 : 4;
  const [width, height] = sizeFor(data.length / numbers);
  const padded = new data.constructor(numbers * width * height);
  padded.set(data);
  const kind = { F16: HalfFloatType, F32: FloatType, U16: UnsignedShortType, U32: UnsignedIntType }[type];
  const texture = new DataTexture(padded, width, height, whole ? RedIntegerFormat : RGBAFormat, kind);
  texture.minFilter = texture.magFilter = NearestFilter;
  if (whole) texture.internalFormat = type === "U16" ? "R16UI" : "R32UI";
  texture.unpackAlignment = 1;
  texture.needsUpdate = true;
  return texture;
}

/** What shaders write one result into for each of `count` numbers. */
export function targetFor(count, type = FloatType) {
  const [width, height] = sizeFor(count);
  return new WebGLRenderTarget(width, height, {
    type, minFilter: NearestFilter, magFilter: NearestFilter, depthBuffer: false, generateMipmaps: false,
  });
}

// Transfer under a light on the graphics card: rows under the light, then toward the eye, then onto the map.

const EVERYWHERE = /* glsl */ `
in vec3 position;
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`;

const NUMBER = /* glsl */ `
uniform ivec2 size; // columns, and results in all
int prtNumber() {
  int i = int(gl_FragCoord.y) * size.x + int(gl_FragCoord.x);
  if (i >= size.y) discard;
  return i;
}
out vec4 result;`;

// Row m of receiver g is number g M + m; `table` is the light, three channels one after the other, four coefficients a
// texel.
const DENSE = /* glsl */ `
uniform sampler2D values, table;
void main() {
  int start = prtNumber() * CHANNELS * BLOCK;
  vec3 sum = vec3(0.0);
  for (int k = 0; k < BLOCK; k++) {
    vec4 t = prtFetch(values, start + k);
    vec4 u = CHANNELS == 1 ? t : prtFetch(values, start + BLOCK + k);
    vec4 v = CHANNELS == 1 ? t : prtFetch(values, start + 2 * BLOCK + k);
    sum.r += dot(t, prtFetch(table, k));
    sum.g += dot(u, prtFetch(table, BLOCK + k));
    sum.b += dot(v, prtFetch(table, 2 * BLOCK + k));
  }
  result = vec4(sum, 1.0);
}`;

// `table`: what the light makes of the mean of a cluster and of its vectors, VECTORS + 1 times M of a cluster.
const CLUSTERED = /* glsl */ `
uniform sampler2D weights, table;
uniform usampler2D label;
void main() {
  int i = prtNumber();
  int g = i / ROWS;
  int row = prtFetchWhole(label, g) * (VECTORS + 1) * ROWS + i % ROWS;
  vec3 sum = prtFetch(table, row).rgb;
  for (int k = 0; k < VECTORS; k++) {
    sum += prtFetch(weights, g * ((VECTORS + 3) / 4) + k / 4)[k % 4] * prtFetch(table, row + (k + 1) * ROWS).rgb;
  }
  result = vec4(sum, 1.0);
}`;

// A texel of the map shows a receiver, nothing, or, as gutter, a blend of four.
const MAP = /* glsl */ `
uniform sampler2D shaded, sources, shares;
uniform usampler2D place;
void main() {
  int shown = prtFetchWhole(place, prtNumber());
  result = vec4(0.0);
  if (shown == 0) return;
  if (shown <= RECEIVERS) {
    result = vec4(prtFetch(shaded, shown - 1).rgb, 1.0);
    return;
  }
  vec4 from = prtFetch(sources, shown - RECEIVERS - 1);
  vec4 share = prtFetch(shares, shown - RECEIVERS - 1);
  for (int k = 0; k < 4; k++) result.rgb += share[k] * prtFetch(shaded, int(from[k] + 0.5)).rgb;
  result.a = 1.0;
}`;

/** The sum of all layers at receiver v. */
function towardEye(layers) {
  const parts = layers.map((layer, i) => {
    const row = layer.some ? `prtFetchWhole(rows${i}, v) - 1` : "v";
    const weight = layer.uniform ? `weight${i}` : `prtFetch(weight${i}, g).rgb`;
    const diffuse = `sum += ${weight} * prtFetch(lit${i}, g).rgb;`;
    const glossy = /* glsl */ `
      vec3 local = prtLocalView(eye - prtFetch(places${i}, g).xyz, prtFetch(frames${i}, 2 * g).xyz, prtFetch(frames${i}, 2 * g + 1).xyz);
      float e[PRT_COUNT];
      prtExitFunctions(local, functions, sectoral, e);
      vec3 seen = vec3(0.0);
      for (int k = 0; k < PRT_COUNT; k++) seen += e[k] * prtFetch(lit${i}, g * PRT_COUNT + k).rgb;
      sum += ${weight} * seen;`;
    return /* glsl */ `{
      int g = ${row};
      if (g >= 0) { ${layer.kind === "exit" ? glossy : diffuse} }
    }`;
  });
  const uniforms = layers.map((layer, i) => [
    `uniform sampler2D lit${i};`,
    layer.uniform ? `uniform vec3 weight${i};` : `uniform sampler2D weight${i};`,
    layer.some ? `uniform usampler2D rows${i};` : "",
    layer.kind === "exit" ? `uniform sampler2D places${i}, frames${i};` : "",
  ]);
  const glossy = layers.find((layer) => layer.kind === "exit");
  return /* glsl */ `
    #define PRT_ORDER ${glossy?.output_order ?? 1}
    ${PRT}
    ${uniforms.flat().join("\n")}
    uniform vec3 eye;
    uniform vec3 functions[PRT_COUNT];
    uniform float sectoral[PRT_ORDER];
    void main() {
      int v = prtNumber();
      vec3 sum = vec3(0.0);
      ${parts.join("\n")}
      result = vec4(sum, 1.0);
    }`;
}

class Pass {
  constructor(code, uniforms, width, count, defines = {}) {
    this.material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: EVERYWHERE,
      fragmentShader: FETCH + NUMBER + code,
      uniforms: Object.fromEntries(Object.entries(uniforms).map(([name, value]) => [name, { value }])),
      defines,
      depthTest: false,
      depthWrite: false,
      blending: NoBlending,
    });
    this.material.uniforms.size = { value: [width, count] };
    this.scene = new Scene();
    const mesh = new Mesh(new PlaneGeometry(2, 2), this.material);
    mesh.frustumCulled = false;
    this.scene.add(mesh);
  }

  draw(renderer, target) {
    renderer.setRenderTarget(target);
    renderer.render(this.scene, CAMERA);
  }

  dispose() {
    this.material.dispose();
    this.scene.children[0].geometry.dispose();
    for (const { value } of Object.values(this.material.uniforms)) if (value?.isTexture) value.dispose();
  }
}

const CAMERA = new OrthographicCamera(-1, 1, 1, -1, 0, 1);

/**
 * The radiance of every receiver: `shaded`, a texture with that of receiver v at texel (v % width, floor(v / width)), and
 * of a transfer of texels `map`, which meshes show through their texture coordinates.
 */
export class Shading {
  constructor({ about, tensors }, { mipmaps = false } = {}) {
    this.about = about;
    const { count, layers } = about;
    this.layers = layers.map((layer, i) => this.#layer(layer, (name) => tensors[`${i}.${name}`]));
    const made = targetFor(count);
    this.target = made;
    const uniforms = { eye: new Vector3(), functions: [0, 0, 0], sectoral: [0] };
    for (const [i, layer] of this.layers.entries()) {
      uniforms[`lit${i}`] = layer.target.texture;
      for (const name of ["weight", "rows", "places", "frames"]) if (layer[name]) uniforms[`${name}${i}`] = layer[name];
      if (layer.kind === "exit") [uniforms.functions, uniforms.sectoral] = [layer.table, layer.sectoral];
    }
    this.glossy = layers.some((layer) => layer.kind === "exit");
    this.sum = new Pass(towardEye(this.layers), uniforms, made.width, count);
    this.map = null;
    if (about.receivers === "atlas") this.#mapped(about, tensors, mipmaps);
  }

  get shaded() {
    return this.target.texture;
  }

  #layer(layer, tensor) {
    const { rows, channels, signal } = layer;
    const results = layer.count * rows;
    const target = targetFor(results);
    const block = Math.ceil(this.about.order ** 2 / 4);
    const made = { ...layer, target, block };
    made.weight = layer.uniform ? new Vector3(...layer.uniform) : textureOf(tensor("weight"));
    if (layer.some) made.rows = textureOf(tensor("rows"));
    if (layer.kind === "exit") {
      made.places = textureOf(tensor("places"));
      made.frames = textureOf(tensor("frames"));
      made.table = layer.table.map((each) => new Vector3(...each));
    }
    const defines = { ROWS: rows, CHANNELS: channels, BLOCK: block, VECTORS: layer.vectors ?? 0 };
    const entries = signal === "clustered" ? layer.clusters * (layer.vectors + 1) * rows : 3 * block;
    const [width, height] = sizeFor(entries);
    made.table_texture = textureOf({ type: "F32", data: new Float32Array(4 * width * height) });
    const uniforms = { table: made.table_texture };
    if (signal === "clustered") {
      uniforms.label = textureOf(tensor("label"));
      uniforms.weights = textureOf(tensor("weights"));
      made.representatives = tensor("representatives").data;
    } else {
      uniforms.values = textureOf(tensor("values"));
    }
    made.pass = new Pass(signal === "clustered" ? CLUSTERED : DENSE, uniforms, target.width, results, defines);
    return made;
  }

  #mapped(about, tensors, mipmaps) {
    const { rows, columns, count } = about;
    this.map = new WebGLRenderTarget(columns, rows, {
      type: HalfFloatType, magFilter: LinearFilter, minFilter: mipmaps ? 1008 : LinearFilter, depthBuffer: false,
      generateMipmaps: mipmaps,
    });
    const uniforms = { shaded: this.shaded };
    for (const name of ["place", "sources", "shares"]) uniforms[name] = textureOf(tensors[name]);
    this.resolve = new Pass(MAP, uniforms, columns, rows * columns, { RECEIVERS: count });
  }

  /** `light`: N x 3 in the frame of the bake; `eye`: a Vector3 there, for what is glossy. False if nothing changed. */
  render(renderer, light, eye) {
    if (!this.checked) this.#check(renderer);
    const lit = !this.light || light.some((each, i) => each !== this.light[i]);
    const seen = this.glossy && !(this.eye && eye.equals(this.eye));
    if (!lit && !seen) return false;
    const { autoClear, xr } = renderer;
    const [before, presenting] = [renderer.getRenderTarget(), xr.enabled];
    renderer.autoClear = false;
    xr.enabled = false;
    if (lit) {
      for (const layer of this.layers) {
        this.#put(layer, light);
        layer.pass.draw(renderer, layer.target);
      }
      this.light = Float32Array.from(light);
    }
    if (this.glossy) this.eye = this.sum.material.uniforms.eye.value.copy(eye).clone();
    this.sum.draw(renderer, this.target);
    if (this.map) this.resolve.draw(renderer, this.map);
    renderer.setRenderTarget(before);
    renderer.autoClear = autoClear;
    xr.enabled = presenting;
    return true;
  }

  #check(renderer) {
    const passes = [...this.layers.map(({ pass }) => pass), this.sum, this.resolve].filter(Boolean);
    const values = passes.flatMap(({ material }) => Object.values(material.uniforms).map(({ value }) => value));
    checkCard(renderer, values.filter((value) => value?.isTexture).map(({ image }) => image));
    // What was drawn into textures is lost with the card.
    renderer.domElement.addEventListener("webglcontextrestored", () => (this.light = null));
    this.checked = true;
  }

  /** The light, or what it makes of the representatives of clusters, as the texture that the pass reads. */
  #put(layer, light) {
    const { data } = layer.table_texture.image;
    const count = light.length / 3;
    if (layer.signal === "clustered") {
      underLight(layer.representatives, light, layer.channels, data);
    } else {
      for (let c = 0; c < 3; c++) for (let i = 0; i < count; i++) data[4 * layer.block * c + i] = light[3 * i + c];
    }
    layer.table_texture.needsUpdate = true;
  }

  /** Radiance of all receivers, V x 3, read back: a page that must know numbers; slow on a graphics card. */
  read(renderer) {
    const { width, height } = this.target;
    const four = new Float32Array(4 * width * height);
    renderer.readRenderTargetPixels(this.target, 0, 0, width, height, four);
    const three = new Float32Array(3 * this.about.count);
    for (let i = 0; i < this.about.count; i++) for (let c = 0; c < 3; c++) three[3 * i + c] = four[4 * i + c];
    return three;
  }

  dispose() {
    for (const each of [...this.layers.map((layer) => layer.pass), this.sum, this.resolve]) each?.dispose();
    for (const each of [...this.layers.map((layer) => layer.target), this.target, this.map]) each?.dispose();
  }
}

/** Rows of `channels` times N numbers under a light, into texels of four. */
export function underLight(rows, light, channels, out) {
  const count = light.length / 3;
  for (let row = 0, at = 0; at < rows.length; row++, at += channels * count) {
    let [red, green, blue] = [0, 0, 0];
    const [second, third] = channels === 1 ? [at, at] : [at + count, at + 2 * count];
    for (let i = 0; i < count; i++) {
      red += rows[at + i] * light[3 * i];
      green += rows[second + i] * light[3 * i + 1];
      blue += rows[third + i] * light[3 * i + 2];
    }
    out.set([red, green, blue, 1], 4 * row);
  }
}

// What meshes are drawn with: linear radiance, which three.js then exposes, tone maps and encodes.

const DRAWN = /* glsl */ `
  #include <begin_vertex>
  #include <morphtarget_vertex>
  #include <skinbase_vertex>
  #include <skinning_vertex>
  #include <project_vertex>`;

const vertex = (declared, shade) => /* glsl */ `
  #include <common>
  #include <morphtarget_pars_vertex>
  #include <skinning_pars_vertex>
  ${declared}
  void main() {
    ${DRAWN}
    ${shade}
  }`;

const fragment = (declared, radiance) => /* glsl */ `
  #include <common>
  ${declared}
  void main() {
    gl_FragColor = vec4(max(${radiance}, 0.0), 1.0);
    #include <tonemapping_fragment>
    #include <colorspace_fragment>
  }`;

function material(uniforms, vertexShader, fragmentShader, side) {
  const named = Object.fromEntries(Object.entries(uniforms).map(([name, value]) => [name, { value }]));
  return new ShaderMaterial({ uniforms: named, vertexShader, fragmentShader, side });
}

/**
 * A material of radiance at vertices. `shade(prefix, target)`: the code that puts that of the sides of `prefix`, "_prt_" or
 * "_prt_back_", into `target`. Where the mesh has a picture of its base colour, and in `_prt_albedo` what transfer took
 * for it, the picture is what shows: transfer has its mean around each vertex.
 */
function materialAtVertices(mesh, uniforms, declared, shade) {
  const { geometry, material: former } = mesh;
  const { attributes } = geometry;
  const back = Boolean(attributes._prt_back_id ?? attributes._prt_back_0);
  const picture = former.map && attributes._prt_albedo && attributes[placed(former.map.channel)] ? former.map : null;
  // Not extrapolated at the edges of triangles.
  const between = /* glsl */ `
    centroid varying vec3 prtShown;
    ${back ? "centroid varying vec3 prtBehind;" : ""}
    ${picture ? "centroid varying vec3 prtMean;\nvarying vec2 prtPlace;" : ""}`;
  const added = picture && {
    prtPicture: picture, prtPictureTurn: picture.matrix, prtTint: new Vector3().setFromColor(former.color),
  };
  if (picture) picture.updateMatrix();
  return material(
    { ...uniforms, ...added },
    vertex(
      `${declared}
      ${attributes._prt_albedo ? "attribute vec3 _prt_albedo;" : ""}
      ${picture ? "uniform mat3 prtPictureTurn;" : ""}
      ${picture?.channel ? `attribute vec2 ${placed(picture.channel)};` : ""}
      ${between}`,
      `${shade("_prt_", "prtShown")}
      ${back ? shade("_prt_back_", "prtBehind") : ""}
      ${picture ? `prtMean = _prt_albedo;\nprtPlace = (prtPictureTurn * vec3(${placed(picture.channel)}, 1.0)).xy;` : ""}`,
    ),
    fragment(
      `${between}
      ${picture ? "uniform sampler2D prtPicture;\nuniform vec3 prtTint;" : ""}`,
      `${back ? "(gl_FrontFacing ? prtShown : prtBehind)" : "prtShown"}
      ${picture ? " * prtTint * texture2D(prtPicture, prtPlace).rgb / max(prtMean, vec3(0.02))" : ""}`,
    ),
    former.side,
  );
}

const vectors = (count) => Array.from({ length: count }, () => new Vector3());

/** Of a mesh whose vertices have their transfer as attributes `_prt_0`, ...; `prtLight` are the coefficients. */
export function attributeMaterial({ order, channels }, mesh) {
  const { geometry } = mesh;
  const names = Object.keys(geometry.attributes).filter((name) => /^_prt_(back_)?(\d+|albedo)$/.test(name));
  const count = order * order;
  const colour = geometry.attributes._prt_albedo ? null : geometry.attributes.color;
  if (colour) geometry.setAttribute("prt_colour", colour);
  const declared = /* glsl */ `
    ${names.map((name) => (name === "_prt_albedo" ? "" : `attribute ${/albedo/.test(name) ? "vec3" : "vec4"} ${name};`)).join("\n")}
    ${colour ? "attribute vec3 prt_colour;" : ""}
    uniform vec3 prtLight[${count}];`;
  return materialAtVertices(mesh, { prtLight: vectors(count) }, declared, (prefix, target) => {
    const number = (k) => `${prefix}${k >> 2}.${"xyzw"[k & 3]}`;
    const terms = Array.from({ length: count }, (_, i) =>
      channels === 1
        ? `${number(i)} * prtLight[${i}]`
        : `vec3(${number(i)}, ${number(count + i)}, ${number(2 * count + i)}) * prtLight[${i}]`,
    );
    return `${target} = ${colour ? "prt_colour" : `${prefix}albedo`} * (${terms.join("\n + ")});`;
  });
}

/** Of a mesh whose vertices say in `_prt_id` which receiver they are, of what a `Shading` gives. */
export function vertexMaterial(shading, mesh) {
  const declared = /* glsl */ `
    ${FETCH}
    attribute float _prt_id;
    ${mesh.geometry.attributes._prt_back_id ? "attribute float _prt_back_id;" : ""}
    uniform sampler2D prtShaded;`;
  const shade = (prefix, target) => `${target} = prtFetch(prtShaded, int(${prefix}id + 0.5)).rgb;`;
  return materialAtVertices(mesh, { prtShaded: shading.shaded }, declared, shade);
}

const placed = (channel) => (channel ? `uv${channel}` : "uv");
const coordinates = (channel) => /* glsl */ `
  ${channel ? `attribute vec2 ${placed(channel)};` : ""}
  varying vec2 prtPlace;`;

/** Of a mesh that shows the map of a `Shading` through its texture coordinates, set `channel`. */
export function mapMaterial(shading, channel = 0, side = FrontSide) {
  return material(
    { prtMap: shading.map.texture },
    vertex(coordinates(channel), `prtPlace = ${placed(channel)};`),
    fragment("uniform sampler2D prtMap;\nvarying vec2 prtPlace;", "texture2D(prtMap, prtPlace).rgb"),
    side,
  );
}

/**
 * A set of lightmaps of one atlas, added up: of each of several lights, or of each SH coefficient. `maps`: textures of
 * one size with data (as EXRLoader loads them), of linear radiance; `uniforms.prtWeights` are vectors, one a map: how
 * bright each light is, or the coefficients of the light. `lowestFirst`: their first row is the lowest of the picture, as
 * EXRLoader has it; texture coordinates of glTF begin at the uppermost.
 */
export function lightmapMaterial(maps, { channel = 0, lowestFirst = false } = {}) {
  const { width, height } = maps[0].image;
  const half = maps.every(({ type }) => type === HalfFloatType);
  if (maps.some(({ image, type }) => image.width !== width || image.height !== height || type !== maps[0].type)) {
    throw new Error("Lightmaps of a set are of one size and one type: bake them together.");
  }
  const numbers = 4 * width * height;
  const data = new (half ? Uint16Array : Float32Array)(numbers * maps.length);
  for (const [i, { image }] of maps.entries()) data.set(image.data, i * numbers);
  const texture = new DataArrayTexture(data, width, height, maps.length);
  Object.assign(texture, { format: RGBAFormat, type: half ? HalfFloatType : FloatType, needsUpdate: true });
  texture.minFilter = texture.magFilter = LinearFilter;
  const declared = /* glsl */ `
    precision highp sampler2DArray;
    uniform sampler2DArray prtMaps;
    uniform vec3 prtWeights[${maps.length}];
    varying vec2 prtPlace;
    vec3 prtSum() {
      vec3 sum = vec3(0.0);
      for (int i = 0; i < ${maps.length}; i++) sum += prtWeights[i] * texture(prtMaps, vec3(prtPlace, float(i))).rgb;
      return sum;
    }`;
  return material(
    { prtMaps: texture, prtWeights: vectors(maps.length) },
    vertex(
      coordinates(channel),
      lowestFirst ? `prtPlace = vec2(${placed(channel)}.x, 1.0 - ${placed(channel)}.y);` : `prtPlace = ${placed(channel)};`,
    ),
    fragment(declared, "prtSum()"),
  );
}

/**
 * Of a mesh in zonal lobes, which its node or its bones may move: axes turn with the rotation nearest to the matrix that
 * these blend to. `prtFrame`: from the world to the frame of the bake; `prtRest`: back from how they were in the bake.
 */
export function lobeMaterial(about, layer, textures, mesh) {
  const { order } = about;
  const { channels, lobes, exact } = layer;
  const first = exact ? 2 : 0;
  const size = Math.ceil((channels * 4 * (exact ? 1 : 0) + lobes * (3 + channels * (order - first))) / 4);
  const declared = /* glsl */ `
    #define PRT_ORDER ${order}
    ${FETCH}
    ${PRT}
    attribute float _prt_id;
    ${mesh.geometry.attributes._prt_back_id ? "attribute float _prt_back_id;" : ""}
    uniform sampler2D prtLobes;
    ${layer.uniform ? "uniform vec3 prtWeight;" : "uniform sampler2D prtWeight;"}
    uniform vec3 prtLight[PRT_COUNT];
    uniform mat3 prtFrame, prtRest;
    float prtOf(vec4 numbers[${size}], int i) { return numbers[i / 4][i % 4]; }
    vec3 prtColour(vec4 numbers[${size}], int i, int step) {
      return vec3(prtOf(numbers, i), prtOf(numbers, i + ${channels > 1 ? "step" : "0"}), prtOf(numbers, i + ${channels > 1 ? "2 * step" : "0"}));
    }
    vec3 prtFrom(int number, mat3 turn) {
      vec4 numbers[${size}];
      for (int i = 0; i < ${size}; i++) numbers[i] = prtFetch(prtLobes, number * ${size} + i);
      vec3 sum = vec3(0.0);
      int at = 0;
      ${exact ? /* glsl */ `
        vec4 low[3];
        for (int c = 0; c < ${channels}; c++) low[c] = prtTurnedLinear(numbers[c], turn);
        for (int i = 0; i < 4; i++) sum += vec3(low[0][i], low[${channels > 1 ? 1 : 0}][i], low[${channels > 1 ? 2 : 0}][i]) * prtLight[i];
        at = ${4 * channels};` : ""}
      for (int k = 0; k < ${lobes}; k++) {
        vec3 axis = vec3(prtOf(numbers, at), prtOf(numbers, at + 1), prtOf(numbers, at + 2));
        vec3 bands[PRT_ORDER];
        for (int l = 0; l < PRT_ORDER; l++) bands[l] = l < ${first} ? vec3(0.0) : prtColour(numbers, at + 3 + l - ${first}, ${order - first});
        sum += prtLobe(normalize(turn * axis), bands, prtLight);
        at += ${3 + channels * (order - first)};
      }
      return sum * ${layer.uniform ? "prtWeight" : "prtFetch(prtWeight, number).rgb"};
    }`;
  const shade = (prefix, target) => /* glsl */ `
    ${prefix === "_prt_" ? TURN : ""}
    ${target} = prtFrom(int(${prefix}id + 0.5), prtTurn);`;
  const uniforms = { ...textures, prtLight: vectors(order * order), prtFrame: new Matrix3(), prtRest: new Matrix3() };
  return materialAtVertices(mesh, uniforms, declared, shade);
}

const TURN = /* glsl */ `
    mat4 prtPlaced = modelMatrix;
    #ifdef USE_SKINNING
      mat4 prtBones = skinWeight.x * boneMatX + skinWeight.y * boneMatY + skinWeight.z * boneMatZ + skinWeight.w * boneMatW;
      prtPlaced = modelMatrix * bindMatrixInverse * prtBones * bindMatrix;
    #endif
    mat3 prtTurn = prtNearestRotation(prtFrame * mat3(prtPlaced)) * prtRest;`;

// What a scene of three.js holds: meshes with baked transfer, under one light.

/**
 * The model in a folder that `torchprt export --three` wrote. `loader`: a GLTFLoader, which reads its meshes. Put
 * `object` into a scene, set `light`, and call `update(renderer, camera)` before every frame.
 */
export async function loadPRT(folder, loader, options = {}) {
  const at = new URL(folder.endsWith("/") ? folder : `${folder}/`, document.baseURI);
  const [{ scene, animations }, buffer] = await Promise.all([
    loader.loadAsync(new URL("model.glb", at).href),
    new FileLoader().setResponseType("arraybuffer").loadAsync(new URL("transfer.bin", at).href),
  ]);
  const model = new PRTModel(scene, parseTransfer(buffer), options);
  model.animations = animations;
  return model;
}

/** The model of a .glb whose vertices have transfer as attributes, `torchprt export -o transfer.glb`. */
export async function loadPRTAttributes(url, loader) {
  const { scene, animations } = await loader.loadAsync(url);
  const model = new PRTModel(scene, null);
  model.animations = animations;
  return model;
}

export class PRTModel {
  /** `object`: an Object3D whose frame is that of the bake; its meshes have `_prt_id` or texture coordinates. */
  constructor(object, transfer, { channel = 0, mipmaps = false } = {}) {
    this.object = object;
    this.transfer = transfer;
    this.light = null;
    this.animations = [];
    this.shading = null;
    this.lit = [];
    const meshes = [];
    object.updateWorldMatrix(true, true);
    object.traverse((each) => each.isMesh && meshes.push(each));
    const { about, tensors } = transfer ?? {};
    const [zonal] = about?.layers.filter(({ signal }) => signal === "zonal") ?? [];
    if (zonal) {
      const textures = {
        prtLobes: textureOf(tensors["0.lobes"]),
        prtWeight: zonal.uniform ? new Vector3(...zonal.uniform) : textureOf(tensors["0.weight"]),
      };
      for (const mesh of meshes.filter(({ geometry }) => geometry.attributes._prt_id)) {
        this.#give(mesh, lobeMaterial(about, zonal, textures, mesh));
        mesh.material.uniforms.prtRest.value = restOf(mesh, object);
        this.lit.push(mesh.material.uniforms);
      }
    } else if (about) {
      this.shading = new Shading(transfer, { mipmaps });
      const map = this.shading.map;
      const name = map ? (channel ? `uv${channel}` : "uv") : "_prt_id";
      for (const mesh of meshes.filter(({ geometry }) => geometry.attributes[name])) {
        this.#give(mesh, map ? mapMaterial(this.shading, channel, mesh.material.side) : vertexMaterial(this.shading, mesh));
      }
    } else {
      for (const mesh of meshes.filter(({ geometry }) => geometry.attributes._prt_0)) {
        const said = mesh.userData.torchprt ?? mesh.geometry.userData.torchprt ?? mesh.parent?.userData.torchprt;
        if (!said) throw new Error("The mesh does not say of which order its transfer is: export it with torchprt.");
        this.#give(mesh, attributeMaterial(said, mesh));
        this.lit.push(mesh.material.uniforms);
      }
    }
    this.meshes = meshes.filter(({ material }) => material.userData.torchprt);
    if (!this.meshes.length) {
      throw new Error("No mesh of this object has what its transfer needs: load the model.glb of the same folder.");
    }
  }

  #give(mesh, made) {
    made.userData.torchprt = true;
    mesh.material = made;
  }

  /** Bands of the light that it answers to. */
  get order() {
    return this.transfer ? this.transfer.about.order : Math.sqrt(this.lit[0].prtLight.value.length);
  }

  /** Before every frame: whatever changed of the light, of the place of the model and, for gloss, of the camera. */
  update(renderer, camera) {
    if (!(this.light instanceof PRTLight)) throw new Error("The model has no light: set its `light` to a PRTLight.");
    this.object.updateWorldMatrix(true, true);
    const turn = new Quaternion();
    this.object.matrixWorld.decompose(new Vector3(), turn, new Vector3());
    turn.invert();
    const light = this.light.turned(this.order, turn);
    if (this.shading) {
      camera.updateWorldMatrix(true, false);
      const eye = new Vector3().setFromMatrixPosition(camera.matrixWorld);
      this.shading.render(renderer, light, eye.applyMatrix4(new Matrix4().copy(this.object.matrixWorld).invert()));
    }
    const frame = new Matrix3().setFromMatrix4(new Matrix4().makeRotationFromQuaternion(turn));
    for (const { prtLight, prtFrame } of this.lit) {
      for (const [i, each] of prtLight.value.entries()) each.fromArray(light, 3 * i);
      prtFrame?.value.copy(frame);
    }
  }

  dispose() {
    this.shading?.dispose();
    for (const { material } of this.meshes) {
      for (const { value } of Object.values(material.uniforms)) if (value?.isTexture) value.dispose();
      material.dispose();
    }
  }
}

/** The inverse of how its node, or its bones, turn a mesh as it was baked; bones must do it as one. */
function restOf(mesh, object) {
  const turnOf = (matrix) => {
    const turn = new Quaternion();
    matrix.decompose(new Vector3(), turn, new Vector3());
    return turn;
  };
  const world = new Matrix4().copy(object.matrixWorld).invert().multiply(mesh.matrixWorld);
  let rest = turnOf(world);
  if (mesh.isSkinnedMesh) {
    mesh.skeleton.update();
    const turns = mesh.skeleton.bones.map((_, i) => {
      const bone = new Matrix4().fromArray(mesh.skeleton.boneMatrices, 16 * i);
      return turnOf(bone.premultiply(mesh.bindMatrixInverse).premultiply(world).multiply(mesh.bindMatrix));
    });
    [rest] = turns;
    if (turns.some((turn) => rest.angleTo(turn) > 0.01)) {
      throw new Error("The bones of the model were bent when it was baked: bake it in the pose that it is bound in.");
    }
  }
  return new Matrix3().setFromMatrix4(new Matrix4().makeRotationFromQuaternion(rest.invert()));
}

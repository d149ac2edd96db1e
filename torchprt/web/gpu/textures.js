// Arrays as textures, which shaders read by number.
import {
  DataTexture, FloatType, HalfFloatType, NearestFilter, RedIntegerFormat, RGBAFormat, UnsignedIntType, UnsignedShortType,
  WebGLRenderTarget,
} from "three";

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

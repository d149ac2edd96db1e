// What meshes are drawn with: linear radiance, which three.js then exposes, tone maps and encodes.
import { DataArrayTexture, FloatType, HalfFloatType, LinearFilter, Matrix3, RGBAFormat, ShaderMaterial, Vector3 } from "three";
import { PRT } from "./prt.js";
import { FETCH } from "./textures.js";

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

// Not extrapolated at the edges of triangles.
const AT_VERTICES = fragment("centroid varying vec3 prtShown;", "prtShown");

function material(uniforms, vertexShader, fragmentShader, defines = {}) {
  const named = Object.fromEntries(Object.entries(uniforms).map(([name, value]) => [name, { value }]));
  return new ShaderMaterial({ uniforms: named, vertexShader, fragmentShader, defines });
}

const vectors = (count) => Array.from({ length: count }, () => new Vector3());

/** Of a mesh whose vertices have their transfer as attributes `_prt_0`, ...; `prtLight` are the coefficients. */
export function attributeMaterial({ order, channels }, geometry) {
  const names = Object.keys(geometry.attributes).filter((name) => /^_prt_\d+$/.test(name));
  const count = order * order;
  const number = (k) => `_prt_${k >> 2}.${"xyzw"[k & 3]}`;
  const terms = Array.from({ length: count }, (_, i) =>
    channels === 1
      ? `${number(i)} * prtLight[${i}]`
      : `vec3(${number(i)}, ${number(count + i)}, ${number(2 * count + i)}) * prtLight[${i}]`,
  );
  const albedo = geometry.attributes._prt_albedo ? "_prt_albedo" : geometry.attributes.color ? "prtColour" : "vec3(1.0)";
  const declared = /* glsl */ `
    ${names.map((name) => `attribute vec4 ${name};`).join("\n")}
    ${albedo === "_prt_albedo" ? "attribute vec3 _prt_albedo;" : ""}
    ${albedo === "prtColour" ? "attribute vec3 prtColour;" : ""}
    uniform vec3 prtLight[${count}];
    centroid varying vec3 prtShown;`;
  if (albedo === "prtColour") geometry.setAttribute("prtColour", geometry.attributes.color);
  return material(
    { prtLight: vectors(count) },
    vertex(declared, `prtShown = ${albedo} * (${terms.join("\n + ")});`),
    AT_VERTICES,
  );
}

/** Of a mesh whose vertices say in `_prt_id` which receiver they are, of what a `Shading` gives. */
export function vertexMaterial(shading) {
  const declared = /* glsl */ `
    ${FETCH}
    attribute float _prt_id;
    uniform sampler2D prtShaded;
    centroid varying vec3 prtShown;`;
  const shade = "prtShown = prtFetch(prtShaded, int(_prt_id + 0.5)).rgb;";
  return material({ prtShaded: shading.shaded }, vertex(declared, shade), AT_VERTICES);
}

const placed = (channel) => (channel ? `uv${channel}` : "uv");
const coordinates = (channel) => /* glsl */ `
  ${channel ? `attribute vec2 ${placed(channel)};` : ""}
  varying vec2 prtPlace;`;

/** Of a mesh that shows the map of a `Shading` through its texture coordinates, set `channel`. */
export function mapMaterial(shading, channel = 0) {
  return material(
    { prtMap: shading.map.texture },
    vertex(coordinates(channel), `prtPlace = ${placed(channel)};`),
    fragment("uniform sampler2D prtMap;\nvarying vec2 prtPlace;", "texture2D(prtMap, prtPlace).rgb"),
  );
}

/**
 * A set of lightmaps of one atlas, added up: of each of several lights, or of each SH coefficient. `maps`: textures of
 * one size with data (as EXRLoader loads them), of linear radiance; `uniforms.prtWeights` are vectors, one a map: how
 * bright each light is, or the coefficients of the light. Textures have the rows of `flipY` false, as glTF has them.
 */
export function lightmapMaterial(maps, { channel = 0 } = {}) {
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
    vertex(coordinates(channel), `prtPlace = ${placed(channel)};`),
    fragment(declared, "prtSum()"),
  );
}

/**
 * Of a mesh in zonal lobes, which its node or its bones may move: axes turn with the rotation nearest to the matrix that
 * these blend to. `prtFrame`: from the world to the frame of the bake; `prtRest`: back from how they were in the bake.
 */
export function lobeMaterial(about, layer, textures) {
  const { order } = about;
  const { channels, lobes, exact } = layer;
  const first = exact ? 2 : 0;
  const size = Math.ceil((channels * 4 * (exact ? 1 : 0) + lobes * (3 + channels * (order - first))) / 4);
  const declared = /* glsl */ `
    #define PRT_ORDER ${order}
    ${FETCH}
    ${PRT}
    attribute float _prt_id;
    uniform sampler2D prtLobes;
    ${layer.uniform ? "uniform vec3 prtWeight;" : "uniform sampler2D prtWeight;"}
    uniform vec3 prtLight[PRT_COUNT];
    uniform mat3 prtFrame, prtRest;
    centroid varying vec3 prtShown;
    float prtOf(vec4 numbers[${size}], int i) { return numbers[i / 4][i % 4]; }
    vec3 prtColour(vec4 numbers[${size}], int i, int step) {
      return vec3(prtOf(numbers, i), prtOf(numbers, i + ${channels > 1 ? "step" : "0"}), prtOf(numbers, i + ${channels > 1 ? "2 * step" : "0"}));
    }`;
  const shade = /* glsl */ `
    int prtNumber = int(_prt_id + 0.5);
    mat4 prtPlace = modelMatrix;
    #ifdef USE_SKINNING
      mat4 prtBones = skinWeight.x * boneMatX + skinWeight.y * boneMatY + skinWeight.z * boneMatZ + skinWeight.w * boneMatW;
      prtPlace = modelMatrix * bindMatrixInverse * prtBones * bindMatrix;
    #endif
    mat3 prtTurn = prtNearestRotation(prtFrame * mat3(prtPlace)) * prtRest;
    vec4 numbers[${size}];
    for (int i = 0; i < ${size}; i++) numbers[i] = prtFetch(prtLobes, prtNumber * ${size} + i);
    prtShown = vec3(0.0);
    int at = 0;
    ${exact ? /* glsl */ `
      vec4 low[3];
      for (int c = 0; c < ${channels}; c++) low[c] = prtTurnedLinear(numbers[c], prtTurn);
      for (int i = 0; i < 4; i++) prtShown += vec3(low[0][i], low[${channels > 1 ? 1 : 0}][i], low[${channels > 1 ? 2 : 0}][i]) * prtLight[i];
      at = ${4 * channels};` : ""}
    for (int k = 0; k < ${lobes}; k++) {
      vec3 axis = vec3(prtOf(numbers, at), prtOf(numbers, at + 1), prtOf(numbers, at + 2));
      vec3 bands[PRT_ORDER];
      for (int l = 0; l < PRT_ORDER; l++) bands[l] = l < ${first} ? vec3(0.0) : prtColour(numbers, at + 3 + l - ${first}, ${order - first});
      prtShown += prtLobe(normalize(prtTurn * axis), bands, prtLight);
      at += ${3 + channels * (order - first)};
    }
    prtShown *= ${layer.uniform ? "prtWeight" : "prtFetch(prtWeight, prtNumber).rgb"};`;
  const uniforms = { ...textures, prtLight: vectors(order * order), prtFrame: new Matrix3(), prtRest: new Matrix3() };
  return material(uniforms, vertex(declared, shade), AT_VERTICES);
}

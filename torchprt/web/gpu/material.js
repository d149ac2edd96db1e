// What meshes are drawn with: linear radiance, which three.js then exposes, tone maps and encodes.
import { DataArrayTexture, FloatType, FrontSide, HalfFloatType, LinearFilter, Matrix3, RGBAFormat, ShaderMaterial, Vector3 } from "three";
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

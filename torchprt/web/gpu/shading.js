// Transfer under a light on the graphics card: rows under the light, then toward the eye, then onto the map.
import {
  FloatType, GLSL3, HalfFloatType, LinearFilter, Mesh, NearestFilter, NoBlending, OrthographicCamera, PlaneGeometry,
  RawShaderMaterial, Scene, Vector3, WebGLRenderTarget,
} from "three";
import { PRT } from "./prt.js";
import { checkCard, FETCH, sizeFor, targetFor, textureOf } from "./textures.js";

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

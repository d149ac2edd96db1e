// A map of texels: the radiance of its receivers in a texture, which the meshes show through their coordinates.
import * as THREE from "three";
import { DISPLAY } from "./display.js";
import { damaged, unpacked } from "./faults.js";

const material = () =>
  new THREE.ShaderMaterial({
    uniforms: { exposure: { value: 0 }, tone: { value: 0 }, falseColour: { value: false }, map: { value: null } },
    vertexShader: /* glsl */ `
      varying vec2 place;
      void main() {
        place = uv;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
      }`,
    fragmentShader: /* glsl */ `
      uniform float exposure;
      uniform int tone;
      uniform bool falseColour;
      uniform sampler2D map;
      varying vec2 place;
      ${DISPLAY}
      void main() {
        vec3 shown = texture2D(map, place).rgb;
        gl_FragColor = vec4(falseColour ? ramp(shown.r) : srgb(toned(shown * exp2(exposure), tone)), 1.0);
      }`,
  });

export class LightMap {
  constructor(content, { rows, columns, count, gutter }) {
    let at = 0;
    const take = (Kind, numbers) => new Kind(content, (at += 4 * numbers) - 4 * numbers, numbers);
    Object.assign(this, { rows, columns, count });
    this.texel = take(Int32Array, count);
    this.gutter = take(Int32Array, gutter);
    this.sources = take(Int32Array, 4 * gutter);
    this.weights = take(Float32Array, 4 * gutter);
    this.normals = take(Float32Array, 3 * count);
    this.albedo = take(Float32Array, 3 * count);
    this.uv = take(Float32Array, (content.byteLength - at) / 4);
    this.material = material();
  }

  static async open(url, about) {
    const content = await unpacked(url);
    try {
      return new LightMap(content, about);
    } catch (fault) {
      throw damaged(`${url} is damaged`, fault);
    }
  }

  /** Makes the texture for this graphics card: of half precision where it does not read between single ones. */
  prepare(renderer) {
    const single = renderer.extensions.has("OES_texture_float_linear");
    const [type, Numbers] = single ? [THREE.FloatType, Float32Array] : [THREE.HalfFloatType, Uint16Array];
    this.stored = single ? (value) => value : THREE.DataUtils.toHalfFloat;
    this.data = new Numbers(4 * this.rows * this.columns);
    const texture = new THREE.DataTexture(this.data, this.columns, this.rows, THREE.RGBAFormat, type);
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    this.material.uniforms.map.value = texture;
  }

  /** What its receivers send, `[V, 3]`. */
  fill(radiance) {
    const { data, texel, gutter, sources, weights, stored } = this;
    for (let i = 0; i < texel.length; i++) {
      for (let c = 0; c < 3; c++) data[4 * texel[i] + c] = stored(radiance[3 * i + c]);
    }
    for (let i = 0; i < gutter.length; i++) {
      for (let c = 0; c < 3; c++) {
        let sum = 0;
        for (let k = 4 * i; k < 4 * i + 4; k++) sum += weights[k] * radiance[3 * sources[k] + c];
        data[4 * gutter[i] + c] = stored(sum);
      }
    }
    this.material.uniforms.map.value.needsUpdate = true;
  }
}

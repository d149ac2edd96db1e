// A volume: the source radiance of its cells in a texture, and the compositing of it along the rays of the camera.
import * as THREE from "three";
import { DISPLAY } from "./display.js";
import { notOfOnePage, unpacked } from "./faults.js";

const material = () =>
  new THREE.ShaderMaterial({
    uniforms: {
      exposure: { value: 0 },
      tone: { value: 0 },
      falseColour: { value: false },
      cells: { value: null },
      corner: { value: new THREE.Vector3() },
      extent: { value: new THREE.Vector3() },
      rim: { value: new THREE.Vector3() },
      steps: { value: 1 },
      scale: { value: 1 },
    },
    // Rays end at the far side of the box, so that the camera may be inside.
    side: THREE.BackSide,
    transparent: true,
    depthTest: false,
    depthWrite: false,
    vertexShader: /* glsl */ `
      varying vec3 place;
      void main() {
        place = position;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
      }`,
    // As shade.Composite with reading "trilinear": a texture is read between the middles of its texels.
    fragmentShader: /* glsl */ `
      precision highp sampler3D;
      uniform float exposure;
      uniform int tone;
      uniform sampler3D cells;
      uniform vec3 corner;
      uniform vec3 extent;
      uniform vec3 rim;
      uniform int steps;
      uniform float scale;
      varying vec3 place;
      ${DISPLAY}
      void main() {
        vec3 unit = normalize(place - cameraPosition);
        vec3 slope = mix(unit, vec3(1e-9), vec3(lessThan(abs(unit), vec3(1e-9))));
        vec3 one = (corner + rim - cameraPosition) / slope;
        vec3 two = (corner + extent - rim - cameraPosition) / slope;
        vec3 first = min(one, two);
        vec3 last = max(one, two);
        float near = max(max(first.x, max(first.y, first.z)), 0.0);
        float far = min(last.x, min(last.y, last.z));
        if (far <= near) discard;
        float length = (far - near) / float(steps);
        vec3 seen = vec3(0.0);
        float through = 1.0;
        for (int i = 0; i < steps; i++) {
          vec3 at = (cameraPosition + (near + (float(i) + 0.5) * length) * unit - corner) / extent;
          // z is the fastest in memory.
          vec4 read = texture(cells, at.zyx);
          float depth = read.a * length;
          float kept = exp(-depth);
          seen += through * (depth < 1e-3 ? length * (1.0 - 0.5 * depth) : (1.0 - kept) / read.a) * read.rgb;
          through *= kept;
          if (through < 1e-3) break;
        }
        float hidden = 1.0 - through;
        vec3 radiance = max(seen, 0.0) * scale / max(hidden, 1e-6);
        gl_FragColor = vec4(srgb(toned(radiance * exp2(exposure), tone)), hidden);
      }`,
  });

export class Volume {
  /** `content`: numbers and extinction of its cells; `about`: its shape and place. */
  constructor(content, { shape, corner, spacing, steps }) {
    const count = content.byteLength / 8;
    this.number = new Int32Array(content, 0, count);
    this.extinction = new Float32Array(content, 4 * count, count);
    this.shape = shape;
    this.material = material();
    const { uniforms } = this.material;
    uniforms.corner.value.set(...corner);
    uniforms.extent.value.set(...shape.map((each, axis) => each * spacing[axis]));
    uniforms.rim.value.set(...spacing).multiplyScalar(0.5);
    uniforms.steps.value = steps;
  }

  static async open(url, about) {
    const content = await unpacked(url);
    if (content.byteLength % 8) throw notOfOnePage(`${url} is no list of cells`);
    return new Volume(content, about);
  }

  get count() {
    return this.number.length;
  }

  /** Makes the texture for this graphics card: of half precision where it does not read between single ones. */
  prepare(renderer) {
    const single = renderer.extensions.has("OES_texture_float_linear");
    const size = 4 * this.shape[0] * this.shape[1] * this.shape[2];
    this.data = single ? new Float32Array(size) : new Uint16Array(size);
    this.stored = single ? (value) => value : THREE.DataUtils.toHalfFloat;
    const [depth, height, width] = this.shape;
    const texture = new THREE.Data3DTexture(this.data, width, height, depth);
    texture.format = THREE.RGBAFormat;
    texture.type = single ? THREE.FloatType : THREE.HalfFloatType;
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    texture.unpackAlignment = 1;
    this.material.uniforms.cells.value = texture;
    for (let cell = 0; cell < this.count; cell++) this.data[4 * this.number[cell] + 3] = this.stored(this.extinction[cell]);
  }

  /** What its cells send, `[V, 3]`. */
  fill(radiance) {
    const { data, number, extinction, stored } = this;
    let most = 0;
    for (let i = 0; i < radiance.length; i++) most = Math.max(most, Math.abs(radiance[i]));
    // Half precision ends at 65504.
    const scale = most || 1;
    for (let cell = 0; cell < this.count; cell++) {
      for (let c = 0; c < 3; c++) data[4 * number[cell] + c] = stored((extinction[cell] * radiance[3 * cell + c]) / scale);
    }
    this.material.uniforms.scale.value = scale;
    this.material.uniforms.cells.value.needsUpdate = true;
  }
}

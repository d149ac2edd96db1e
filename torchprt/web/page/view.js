// What is drawn: the mesh with its radiance, the environment behind it, a camera around both.
import * as THREE from "three";
import { DISPLAY } from "./display.js";

// Attributes and colours pass through as they are: radiance is linear, DISPLAY makes of it what is shown.
THREE.ColorManagement.enabled = false;

const GROUND = 0x0d0e11;
const STEEPEST = (89 / 180) * Math.PI;

const surface = () =>
  new THREE.ShaderMaterial({
    uniforms: { exposure: { value: 0 }, tone: { value: 0 }, falseColour: { value: false } },
    vertexShader: /* glsl */ `
      attribute vec3 radiance;
      centroid varying vec3 shown;
      void main() {
        shown = radiance;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
      }`,
    fragmentShader: /* glsl */ `
      uniform float exposure;
      uniform int tone;
      uniform bool falseColour;
      centroid varying vec3 shown; // not extrapolated at the edges of triangles
      ${DISPLAY}
      void main() {
        gl_FragColor = vec4(falseColour ? ramp(shown.r) : srgb(toned(shown * exp2(exposure), tone)), 1.0);
      }`,
  });

// The side that reflects nothing is black. It stands back by a pixel, behind what may lie on it and face the eye, and
// inside silhouettes, where rounding would show it.
const reverse = () =>
  new THREE.ShaderMaterial({
    uniforms: { pixel: { value: 0 } },
    side: THREE.BackSide,
    polygonOffset: true,
    polygonOffsetFactor: 2,
    polygonOffsetUnits: 4,
    vertexShader: /* glsl */ `
      uniform float pixel;
      void main() {
        vec4 place = modelViewMatrix * vec4(position, 1.0);
        place.xyz += place.z * pixel * normalize(normalMatrix * normal);
        gl_Position = projectionMatrix * place;
      }`,
    fragmentShader: "void main() { gl_FragColor = vec4(0.0, 0.0, 0.0, 1.0); }",
  });

// The direction in which a latitude-longitude map whose middle is -z and whose top row is +y is read.
const PLACE = /* glsl */ `
  const float PI = 3.141592653589793;
  vec2 placeOf(vec3 d) {
    return vec2(atan(d.x, -d.z) / (2.0 * PI) + 0.5, 1.0 - acos(clamp(d.y, -1.0, 1.0)) / PI);
  }`;

// A mirror shows the picture of the environment, which is sRGB, times its reflectance.
const mirror = () =>
  new THREE.ShaderMaterial({
    uniforms: { picture: { value: null }, turn: { value: new THREE.Matrix3() } },
    side: THREE.DoubleSide,
    vertexShader: /* glsl */ `
      attribute vec3 reflectance;
      varying vec3 share;
      varying vec3 outward;
      varying vec3 place;
      void main() {
        share = reflectance;
        outward = normal;
        place = position;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
      }`,
    fragmentShader: /* glsl */ `
      uniform sampler2D picture;
      uniform mat3 turn;
      varying vec3 share;
      varying vec3 outward;
      varying vec3 place;
      ${PLACE}
      void main() {
        vec3 away = normalize(place - cameraPosition);
        vec3 n = normalize(outward);
        vec3 shares = share + (1.0 - share) * pow(1.0 - abs(dot(away, n)), 5.0);
        vec3 seen = textureLod(picture, placeOf(normalize(reflect(away, n)) * turn), 0.0).rgb;
        gl_FragColor = vec4(pow(pow(seen, vec3(2.2)) * shares, vec3(1.0 / 2.2)), 1.0);
      }`,
  });

const surroundings = () =>
  new THREE.ShaderMaterial({
    uniforms: { picture: { value: null }, turn: { value: new THREE.Matrix3() } },
    side: THREE.BackSide,
    depthTest: false,
    depthWrite: false,
    vertexShader: /* glsl */ `
      varying vec3 direction;
      void main() {
        direction = position;
        // At the far plane, wherever that is.
        gl_Position = (projectionMatrix * vec4(mat3(viewMatrix) * position, 1.0)).xyww;
      }`,
    fragmentShader: /* glsl */ `
      uniform sampler2D picture;
      uniform mat3 turn;
      varying vec3 direction;
      ${PLACE}
      void main() {
        // R^T d.
        vec2 place = placeOf(normalize(direction) * turn);
        // Noise of one unit in 255 hides the steps of a wide gradient.
        float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
        gl_FragColor = vec4(0.45 * textureLod(picture, place, 0.0).rgb + noise / 255.0, 1.0);
      }`,
  });

function shine(geometry, values) {
  const attribute = geometry.attributes.radiance;
  if (attribute) {
    attribute.array = values;
    attribute.needsUpdate = true;
  } else {
    geometry.setAttribute("radiance", new THREE.BufferAttribute(values, 3).setUsage(THREE.DynamicDrawUsage));
  }
}

export class View {
  constructor(canvas, geometry, { camera, closed }) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.setClearColor(GROUND);
    geometry.computeBoundingSphere();
    this.ball = geometry.boundingSphere;
    this.material = surface();
    this.geometry = geometry;
    this.sky = new THREE.Mesh(new THREE.SphereGeometry(1, 64, 32), surroundings());
    this.sky.frustumCulled = false;
    this.sky.renderOrder = -1;
    this.sky.visible = false;
    this.model = new THREE.Mesh(geometry, this.material);
    this.filled = null;
    this.scene = new THREE.Scene().add(this.sky, this.model);
    this.reverse = reverse();
    // Of a closed surface no reverse is seen.
    if (!closed) this.scene.add(new THREE.Mesh(geometry, this.reverse));
    this.mirror = mirror();
    this.pictures = new Map();
    this.#place(camera);
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  #place({ eye, target, field }) {
    this.target = new THREE.Vector3(...target);
    const away = new THREE.Vector3(...eye).sub(this.target);
    this.distance = this.farthest = away.length();
    this.elevation = Math.max(-STEEPEST, Math.min(STEEPEST, Math.asin(away.y / this.distance)));
    this.azimuth = Math.atan2(away.x, away.z);
    this.camera = new THREE.PerspectiveCamera(field, 1, 1, 2);
    this.field = field;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // The field is that of the shorter side, so that a narrow window shows the whole model too.
    const reach = Math.tan((this.field * Math.PI) / 360);
    this.camera.fov = (360 / Math.PI) * Math.atan(reach / Math.min(1, this.camera.aspect));
    this.onchange?.();
  }

  /** Angles in radians. */
  orbit(right, up) {
    this.azimuth -= right;
    this.elevation = Math.max(-STEEPEST, Math.min(STEEPEST, this.elevation + up));
  }

  zoom(factor) {
    this.distance = Math.max(0.15 * this.farthest, Math.min(4 * this.farthest, this.distance * factor));
  }

  /** The point the model is seen from, in its unit. */
  get eye() {
    const across = Math.cos(this.elevation);
    return new THREE.Vector3(across * Math.sin(this.azimuth), Math.sin(this.elevation), across * Math.cos(this.azimuth))
      .multiplyScalar(this.distance)
      .add(this.target);
  }

  /** The axis of the world that points right on the screen. */
  get right() {
    return new THREE.Vector3(Math.cos(this.azimuth), 0, -Math.sin(this.azimuth));
  }

  set radiance(values) {
    if (this.filled) this.filled.fill(values);
    else shine(this.geometry, values);
  }

  /** Draws, in place of radiance at vertices, a volume in the box that the mesh is, or a map on it. */
  addFilled(filled) {
    filled.prepare(this.renderer);
    this.filled = filled;
    this.material = this.model.material = filled.material;
  }

  /** Draws an object that moves through `places` too. */
  addObject({ geometry }, places) {
    geometry.computeBoundingSphere();
    this.object = new THREE.Mesh(geometry, this.material);
    this.object.matrixAutoUpdate = false;
    this.object.frustumCulled = false;
    this.scene.add(this.object);
    const reach = geometry.boundingSphere.center.length() + geometry.boundingSphere.radius;
    this.ball = this.ball.clone();
    for (const place of places) this.ball.union(new THREE.Sphere(place, reach));
  }

  /** Whether it is drawn. */
  showObject(shown) {
    if (this.object) this.object.visible = shown;
  }

  get objectShown() {
    return this.object?.visible ?? false;
  }

  /** Puts the object in a pose, a Matrix4, with the radiance of its vertices. */
  placeObject(pose, radiance) {
    this.object.matrix.copy(pose);
    this.object.matrixWorldNeedsUpdate = true;
    shine(this.object.geometry, radiance);
  }

  /** Draws mirrors too: a mesh whose colours are what they reflect along their normals. */
  addMirrors({ geometry, albedo }) {
    geometry.setAttribute("reflectance", new THREE.BufferAttribute(albedo, 3));
    geometry.computeBoundingSphere();
    this.scene.add(new THREE.Mesh(geometry, this.mirror));
    const box = new THREE.Box3().setFromBufferAttribute(this.geometry.attributes.position);
    box.union(new THREE.Box3().setFromBufferAttribute(geometry.attributes.position)).getBoundingSphere(this.ball);
  }

  /** `image` (an element that is loaded), turned by the row-major `rotation`, in mirrors and, if `shown`, behind. */
  surround(image, rotation, shown) {
    this.sky.visible = shown;
    if (!this.pictures.has(image)) {
      const texture = new THREE.Texture(image);
      texture.generateMipmaps = false;
      texture.minFilter = THREE.LinearFilter;
      texture.wrapS = THREE.RepeatWrapping;
      texture.needsUpdate = true;
      this.pictures.set(image, texture);
    }
    for (const { uniforms } of [this.sky.material, this.mirror]) {
      uniforms.picture.value = this.pictures.get(image);
      uniforms.turn.value.set(...rotation);
    }
  }

  draw() {
    const away = this.eye.distanceTo(this.ball.center);
    this.camera.near = Math.max(away - 1.01 * this.ball.radius, away / 1000);
    this.camera.far = away + 1.01 * this.ball.radius;
    this.camera.position.copy(this.eye);
    this.camera.lookAt(this.target);
    this.camera.updateProjectionMatrix();
    const height = this.renderer.getDrawingBufferSize(new THREE.Vector2()).y;
    this.reverse.uniforms.pixel.value = (2 * Math.tan((this.camera.fov * Math.PI) / 360)) / height;
    this.renderer.render(this.scene, this.camera);
  }
}

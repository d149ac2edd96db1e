// What is shown of the model, when it is shaded again, and every change to that. No element of the panel in it.
import { Matrix4, Quaternion, Vector3 } from "three";
import { TONES } from "./display.js";
import { difference, lambert, unshadowed } from "./modes.js";
import { TURN } from "./pointer.js";
import { lowBands } from "./sh.js";
import { View } from "./view.js";
import { windowed } from "./windows.js";

const UP = new Vector3(0, 1, 0);
// Seconds in which a light goes around by itself.
const PERIOD = 20;

/** What is shown, and every change to it. */
export class Viewer {
  constructor(canvas, about, mesh, model, compressed, pictures) {
    Object.assign(this, { about, mesh, model, compressed, pictures, spare: model });
    this.view = new View(canvas, mesh.geometry, about);
    this.view.onchange = () => this.#draw();
    this.turn = new Quaternion();
    this.mode = "transfer";
    this.environment = 0;
    this.order = about.order;
    this.window = "none";
    this.tone = about.tone;
    this.stops = 0;
    this.turning = false;
    this.surrounded = true;
    this.times = [];
    this.flight = null;
    this.changed = true;
  }

  /** An object that flies over the model; at first it stands in the middle of its way. */
  let(flight) {
    this.flight = flight;
    flight.moment = 0.5;
    this.view.addObject(flight.mesh, flight.poses.map(({ place }) => place));
  }

  get light() {
    return this.about.environments[this.environment];
  }

  /** Row-major, as the graph takes it. */
  get rotation() {
    const e = new Matrix4().makeRotationFromQuaternion(this.turn).elements;
    return [e[0], e[4], e[8], e[1], e[5], e[9], e[2], e[6], e[10]];
  }

  /** What shines on the model, before it is turned: the bands that are left, under the window. */
  get shining() {
    const key = `${this.order} ${this.window}`;
    this.light.windowed ??= {};
    return (this.light.windowed[key] ??= windowed(lowBands(this.light.coefficients, this.order), this.order, this.window));
  }

  get exposure() {
    return this.light.exposure + this.stops;
  }

  /** Marks what is shown as out of date; shading follows with the next frame, one after the other. */
  change() {
    this.changed = true;
    this.running ??= this.#settle().finally(() => (this.running = null));
    return this.running;
  }

  async #settle() {
    let then = null;
    const moves = () => this.turning || this.flight?.flying;
    while (this.changed || moves()) {
      this.changed = false;
      await this.#shade();
      this.#draw();
      const now = await new Promise(requestAnimationFrame);
      // A tab that was away for a while does not make up for it.
      const passed = then === null ? 0 : Math.min(now - then, 100) / 1000;
      if (this.turning) this.#spin(passed);
      if (this.flight?.flying) this.flight.pass(passed);
      then = moves() ? now : null;
    }
  }

  #spin(seconds) {
    this.turn.premultiply(new Quaternion().setFromAxisAngle(UP, (2 * Math.PI * seconds) / PERIOD)).normalize();
  }

  /** Lets the light turn by itself about +y, or stand still. */
  letTurn(turning) {
    this.turning = turning;
    return this.change();
  }

  /** Lets the object fly, or stay where it is. */
  letFly(flying) {
    this.flight.flying = flying;
    return this.change();
  }

  /** Puts the object at a place of its way, from 0 to 1. */
  flyTo(moment) {
    this.flight.moment = moment;
    return this.change();
  }

  /** A light more, which is shown. */
  addLight({ picture, ...light }) {
    this.environment = this.about.environments.push(light) - 1;
    this.pictures.push(picture);
    return this.change();
  }

  async #timed(model, light) {
    const start = performance.now();
    const eye = this.view.eye.toArray();
    let radiance;
    try {
      radiance = await model.shade(light, this.rotation, eye);
    } catch (fault) {
      // A graphics card can be lost at any time.
      if (model.where !== "webgpu") throw fault;
      console.info(`WebGPU stopped: ${fault.message}`);
      this.model = this.spare;
      this.times = [];
      radiance = await this.spare.shade(light, this.rotation, eye);
    }
    this.times = [...this.times.slice(-30), performance.now() - start];
    return radiance;
  }

  async #shade() {
    const light = this.shining;
    const { mesh, model, compressed, rotation } = this;
    this.relative = null;
    if (this.mode === "lambert") this.radiance = lambert(mesh, this.light.lamp, rotation);
    else if (this.mode === "unshadowed") this.radiance = unshadowed(mesh, light, rotation);
    else if (this.mode === "compressed") this.radiance = await this.#timed(compressed, light);
    else this.radiance = await this.#timed(model, light);
    if (this.mode === "difference") {
      const other = compressed ? await this.#timed(compressed, light) : unshadowed(mesh, light, rotation);
      const { shown, relative } = difference(other, this.radiance, this.about.full_scale);
      this.relative = relative;
      this.view.radiance = shown;
    } else {
      this.view.radiance = this.radiance;
    }
    this.view.showObject(this.flight !== null && ["transfer", "compressed"].includes(this.mode));
    if (this.flight && this.view.objectShown) {
      const { seen, below } = await this.flight.shade(light, rotation, mesh, this.radiance);
      this.view.placeObject(this.flight.pose, seen);
      this.radiance = below;
      this.view.radiance = below;
    }
  }

  #draw() {
    if (!this.radiance) return;
    const { uniforms } = this.view.material;
    uniforms.exposure.value = this.exposure;
    uniforms.tone.value = TONES.indexOf(this.tone);
    uniforms.falseColour.value = this.mode === "difference";
    this.view.surround(this.pictures[this.environment], this.rotation, this.surrounded);
    this.view.draw();
    this.ondraw?.();
  }

  turnLight(right, down) {
    const yaw = new Quaternion().setFromAxisAngle(UP, right * TURN);
    const pitch = new Quaternion().setFromAxisAngle(this.view.right, down * TURN);
    this.turn.premultiply(yaw).premultiply(pitch).normalize();
    return this.change();
  }

  turnCamera(right, down) {
    this.view.orbit(right * TURN, down * TURN);
    return this.#seen();
  }

  zoom(factor) {
    this.view.zoom(factor);
    return this.#seen();
  }

  /** Where the eye counts everything is shaded again, elsewhere it is only drawn. */
  #seen() {
    if (this.about.glossy) return this.change();
    this.#draw();
    return null;
  }
}

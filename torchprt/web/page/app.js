// The page: what is chosen, when it is shaded again, what it says about itself.
import { Matrix4, Quaternion, Vector3 } from "three";
import { difference, lambert, unshadowed } from "./modes.js";
import { listen, TURN } from "./pointer.js";
import { Model } from "./runtime.js";
import { lowBands } from "./sh.js";
import { loadMesh, View } from "./view.js";

const at = (id) => document.getElementById(id);
const UP = new Vector3(0, 1, 0);
const AGAIN = "Write the page again with torchprt export --web, and copy the whole folder.";

class Viewer {
  constructor(about, mesh, model, compressed, pictures) {
    Object.assign(this, { about, mesh, model, compressed, pictures, spare: model });
    this.view = new View(at("canvas"), mesh.geometry, about);
    this.view.onchange = () => this.#draw();
    this.turn = new Quaternion();
    this.mode = "transfer";
    this.environment = 0;
    this.order = about.order;
    this.stops = 0;
    this.surrounded = true;
    this.times = [];
    this.changed = true;
  }

  get light() {
    return this.about.environments[this.environment];
  }

  /** Row-major, as the graph takes it. */
  get rotation() {
    const e = new Matrix4().makeRotationFromQuaternion(this.turn).elements;
    return [e[0], e[4], e[8], e[1], e[5], e[9], e[2], e[6], e[10]];
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
    while (this.changed) {
      this.changed = false;
      await this.#shade();
      this.#draw();
      await new Promise(requestAnimationFrame);
    }
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
    const light = lowBands(this.light.coefficients, this.order);
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
  }

  #draw() {
    if (!this.radiance) return;
    const { uniforms } = this.view.material;
    uniforms.exposure.value = this.exposure;
    uniforms.falseColour.value = this.mode === "difference";
    this.view.surround(this.surrounded ? this.pictures[this.environment] : null, this.rotation);
    this.view.draw();
    report(this);
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

const number = (value) => value.toLocaleString("en").replaceAll(",", "\u202f");
const megabytes = (bytes) => `${(bytes / 2 ** 20).toFixed(bytes < 2 ** 20 ? 2 : 1)} MB`;
const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

function report(viewer) {
  const { about, model, compressed } = viewer;
  const rows = [
    ["vertices", number(about.vertices)],
    ["transfer", megabytes(about.bytes)],
    ...(compressed ? [["compressed", megabytes(about.compressed.bytes)]] : []),
    ["model file", megabytes(model.bytes)],
    ["one shade", viewer.times.length ? `${median(viewer.times).toFixed(1)} ms` : "-"],
    ["runs on", model.where === "wasm" ? "WASM, 1 thread" : "WebGPU"],
    ...(viewer.relative === null ? [] : [["difference (RMS)", `${(100 * viewer.relative).toPrecision(2)} %`]]),
  ];
  at("statistics").replaceChildren(
    ...rows.flatMap(([name, value]) => {
      const [term, definition] = [document.createElement("dt"), document.createElement("dd")];
      term.textContent = name;
      definition.textContent = value;
      return [term, definition];
    }),
  );
}

/** Buttons of which one is chosen; `entries` are [value, element inside]. */
function choices(box, entries, chosen, choose) {
  const buttons = entries.map(([value, ...content]) => {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("role", "radio");
    button.setAttribute("aria-checked", String(value === chosen));
    button.dataset.value = value;
    button.append(...content);
    button.addEventListener("click", () => {
      for (const each of buttons) each.setAttribute("aria-checked", String(each === button));
      choose(value);
    });
    return button;
  });
  box.replaceChildren(...buttons);
}

function controls(viewer) {
  const { about, pictures } = viewer;
  choices(
    at("environments"),
    about.environments.map((each, index) => {
      const name = document.createElement("span");
      name.textContent = each.name;
      pictures[index].alt = "";
      return [index, pictures[index], name];
    }),
    viewer.environment,
    (index) => {
      viewer.environment = index;
      viewer.change();
    },
  );
  const modes = [
    ["lambert", "N\u00b7L", "one lamp, no shadows"],
    ["unshadowed", "Irradiance", "the whole light, no shadows"],
    ["transfer", "Transfer", about.transport],
    ...(about.compressed ? [["compressed", "Compressed", about.compressed.what]] : []),
    ["difference", "Difference", about.compressed ? "compressed from transfer" : "irradiance from transfer"],
  ];
  choices(
    at("modes"),
    modes.map(([value, name, what]) => {
      const small = document.createElement("small");
      small.textContent = what;
      return [value, name, small];
    }),
    viewer.mode,
    (mode) => {
      viewer.mode = mode;
      viewer.times = [];
      at("legend").hidden = mode !== "difference";
      viewer.change();
    },
  );
  at("legend-value").textContent = `${100 * about.full_scale} % of RMS`;
  const range = (name, value, text, set) => {
    const input = at(name);
    const say = () => (at(`${name}-value`).textContent = text(Number(input.value)));
    input.value = value;
    input.addEventListener("input", () => {
      set(Number(input.value));
      say();
      viewer.change();
    });
    say();
  };
  at("order").max = about.order;
  range("order", about.order, (value) => `${value} of ${about.order}`, (value) => (viewer.order = value));
  range("exposure", 0, (value) => `${value > 0 ? "+" : ""}${value.toFixed(1)}`, (value) => (viewer.stops = value));
  at("background").addEventListener("change", (event) => {
    viewer.surrounded = event.target.checked;
    viewer.change();
  });
  listen(viewer.view.canvas, {
    camera: (right, down) => viewer.turnCamera(right, down),
    light: (right, down) => viewer.turnLight(right, down),
    zoom: (factor) => viewer.zoom(factor),
  });
}

async function json(url) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url} could not be loaded (${response.status} ${response.statusText})`);
  return response.json();
}

function picture(url) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => reject(new Error(`${url} could not be loaded`));
    image.src = url;
  });
}

/** Milliseconds of a few shades, the first of which is not counted. */
async function time(viewer, model) {
  const spans = [];
  for (let turn = 0; turn < 8; turn++) {
    const start = performance.now();
    await model.shade(viewer.light.coefficients, viewer.rotation, viewer.view.eye.toArray());
    spans.push(performance.now() - start);
  }
  return spans.slice(1);
}

/** Times the model, and keeps the graphics card if that runs it faster on this machine. */
async function race(viewer, url) {
  viewer.times = await time(viewer, viewer.model);
  report(viewer);
  let graphics = null;
  try {
    graphics = await Model.openOnGpu(url);
  } catch (fault) {
    console.info(`WebGPU does not run this model: ${fault.message}`);
  }
  if (!graphics) return;
  const times = await time(viewer, graphics);
  if (median(times) < median(viewer.times)) {
    viewer.model = graphics;
    viewer.times = times;
    viewer.change();
  }
}

async function start() {
  if (!document.createElement("canvas").getContext("webgl2")) throw new Error("this browser shows no WebGL 2");
  if (typeof WebAssembly !== "object") throw new Error("this browser runs no WebAssembly");
  // All at once; what fails is told of where it is waited for.
  const loading = [loadMesh("mesh.glb"), Model.open("model.onnx")];
  for (const each of loading) each.catch(() => {});
  const described = await json("scene.json");
  document.title = described.title;
  at("title").textContent = described.title;
  at("subtitle").textContent = described.subtitle;
  at("loading").textContent = `loading ${megabytes(described.download)}`;
  const [mesh, model, compressed, pictures] = await Promise.all([
    ...loading,
    described.compressed ? Model.open("compressed.onnx") : null,
    Promise.all(described.environments.map((each) => picture(each.picture))),
  ]);
  if (mesh.vertices !== described.vertices) {
    throw new Error(`mesh.glb has ${mesh.vertices} vertices where the model shades ${described.vertices}`);
  }
  for (const each of described.environments) each.coefficients = Float32Array.from(each.coefficients.flat());
  const viewer = new Viewer(described, mesh, model, compressed, pictures);
  controls(viewer);
  await viewer.change();
  at("loading").hidden = true;
  document.body.dataset.ready = Math.round(performance.now());
  window.torchprt = viewer;
  viewer.raced = race(viewer, "model.onnx");
  await viewer.raced;
}

start().catch((fault) => window.complain("The model cannot be shown", `${fault.message ?? fault}. ${AGAIN}`));

// ONNX Runtime: a graph and its inputs, in WebAssembly on one thread, or on the graphics card where that is faster.

import { notRun, refused, unpacked } from "./faults.js";

/** The graphs of a page. */
export const [MODEL, COMPRESSED] = ["model.onnx.gz", "compressed.onnx.gz"];

const FOLDER = new URL("./libraries/", import.meta.url);

async function library(name) {
  const code = new URL(`${name}.bundle.min.mjs`, FOLDER);
  const [ort, wasm] = await Promise.all([
    import(code).catch((fault) => {
      throw refused(code, { statusText: fault.message });
    }),
    unpacked(new URL(`${name}.wasm.gz`, FOLDER)),
  ]);
  // Threads need headers that a plain static server does not send.
  ort.env.wasm.numThreads = 1;
  ort.env.wasm.wasmBinary = wasm;
  ort.env.logLevel = "error";
  return ort;
}

let wasm;
let webgpu;

/** A graph `torchprt export` wrote: `shade(light, rotation, eye)` gives radiance, V x 3. */
export class Model {
  constructor(ort, session, name, size) {
    this.ort = ort;
    this.session = session;
    this.where = name;
    this.bytes = size;
  }

  static async open(url) {
    wasm ??= library("ort.wasm");
    const [ort, content] = await Promise.all([wasm, unpacked(url)]);
    return Model.#create(ort, content, "wasm", url);
  }

  /** The same graph on the graphics card; null if the browser has none that can be used. */
  static async openOnGpu(url) {
    if (!("gpu" in navigator) || !("Suspending" in WebAssembly) || !(await navigator.gpu.requestAdapter())) return null;
    webgpu ??= library("ort.jspi");
    const [ort, content] = await Promise.all([webgpu, unpacked(url)]);
    return Model.#create(ort, content, "webgpu", url);
  }

  static async #create(ort, content, name, url) {
    let session;
    try {
      session = await ort.InferenceSession.create(content, { executionProviders: [name], logSeverityLevel: 3 });
    } catch (fault) {
      throw notRun(url, content.byteLength, fault);
    }
    return new Model(ort, session, name, content.byteLength);
  }

  /** One light; `more`: values and shapes of what the graph takes beside it, by name. */
  async shade(light, rotation, eye, more = {}) {
    const { ort, session } = this;
    const inputs = {
      light: new ort.Tensor("float32", light, [1, light.length / 3, 3]),
      rotation: new ort.Tensor("float32", Float32Array.from(rotation), [1, 3, 3]),
    };
    if (session.inputNames.includes("eye")) inputs.eye = new ort.Tensor("float32", Float32Array.from(eye), [1, 3]);
    for (const [name, [values, shape]] of Object.entries(more)) inputs[name] = new ort.Tensor("float32", values, shape);
    const { radiance } = await session.run(inputs);
    const values = await radiance.getData();
    // The memory of WebAssembly may move and be used again: what is kept is a copy.
    const kept = Float32Array.from(values);
    radiance.dispose();
    return kept;
  }
}

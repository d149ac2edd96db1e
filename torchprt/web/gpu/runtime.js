// The runtime of a page that shades in WebGL: in place of ONNX Runtime, with the same two classes of calls.
import { Vector3, WebGLRenderer } from "three";
import { damaged, Fault, unpacked } from "./faults.js";
import { parseTransfer, rotate, Shading } from "./torchprt.js";

export const [MODEL, COMPRESSED] = ["transfer.bin.gz", "compressed.bin.gz"];

let renderer;

/** Of its own, out of sight: what draws the page knows nothing of it. */
function graphics() {
  if (renderer) return renderer;
  const canvas = document.createElement("canvas");
  try {
    renderer = new WebGLRenderer({ canvas, powerPreference: "high-performance" });
  } catch (fault) {
    throw new Fault("This browser has no WebGL 2", `The page computes its light in it. (${fault.message})`, fault);
  }
  if (!renderer.extensions.has("EXT_color_buffer_float")) {
    throw new Fault(
      "This graphics card cannot compute",
      "It does not draw into textures of floating point. Look at the page on another machine, or write it without --gpu.",
    );
  }
  canvas.addEventListener("webglcontextlost", () =>
    window.complain("The graphics card was lost", "The system or another page took it away. Load this page again."),
  );
  return renderer;
}

/** Transfer for shaders: `shade(light, rotation, eye)` gives radiance, V x 3. */
export class Model {
  constructor(shading, size) {
    this.shading = shading;
    this.where = "webgl";
    this.bytes = size;
  }

  static async open(url) {
    const content = await unpacked(url);
    let transfer;
    try {
      transfer = parseTransfer(content);
    } catch (fault) {
      throw damaged(`${url} is damaged (${fault.message})`, fault);
    }
    graphics();
    return new Model(new Shading(transfer), content.byteLength);
  }

  /** It is there already. */
  static openOnGpu() {
    return null;
  }

  async shade(light, rotation, eye) {
    this.shading.render(graphics(), Float32Array.from(rotate(light, rotation)), new Vector3(...eye));
    return this.shading.read(graphics());
  }
}

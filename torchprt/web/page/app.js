// The page: loads everything at once, shows the model, and picks the faster of processor and graphics card.
import { BufferAttribute } from "three";
import { checkBrowser, damaged, Fault, load, notOfOnePage } from "./faults.js";
import { Flight } from "./flight.js";
import { LightMap } from "./map.js";
import { loadMesh } from "./mesh.js";
import { connect, median, megabytes, report } from "./panel.js";
import { COMPRESSED, MODEL, Model } from "./runtime.js";
import { Viewer } from "./viewer.js";
import { Volume } from "./volume.js";

const at = (id) => document.getElementById(id);

async function picture(url) {
  const image = new Image();
  image.src = URL.createObjectURL(await load(url, "blob"));
  try {
    await image.decode();
  } catch (fault) {
    throw damaged(`${url} is no picture`, fault);
  }
  return image;
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
  checkBrowser();
  // All at once; what fails is told of where it is waited for.
  const loading = [loadMesh("mesh.glb"), Model.open(MODEL)];
  for (const each of loading) each.catch(() => {});
  const described = await load("scene.json", "json");
  document.title = described.title;
  at("title").textContent = described.title;
  at("subtitle").textContent = described.subtitle;
  at("loading").textContent = `loading ${megabytes(described.download)}`;
  const [mesh, model, compressed, pictures, mirrors, flight, volume, map] = await Promise.all([
    ...loading,
    described.compressed ? Model.open(COMPRESSED) : null,
    Promise.all(described.environments.map((each) => picture(each.picture))),
    described.mirrors ? loadMesh("mirrors.glb") : null,
    described.flight
      ? Promise.all([Model.open("shadow.onnx.gz"), Model.open("object.onnx.gz"), loadMesh("object.glb")])
      : null,
    described.volume ? Volume.open("volume.bin.gz", described.volume) : null,
    described.map ? LightMap.open("map.bin.gz", described.map) : null,
  ]);
  if (map) {
    if (2 * mesh.vertices !== map.uv.length) throw notOfOnePage("mesh.glb and map.bin.gz are of two models");
    // Shading without transfer is of the receivers too.
    Object.assign(mesh, { normals: map.normals, albedo: map.albedo, vertices: map.count });
    mesh.geometry.setAttribute("uv", new BufferAttribute(map.uv, 2));
  }
  if (volume ? volume.count !== described.vertices : mesh.vertices !== described.vertices) {
    const found = volume ? `volume.bin.gz has ${volume.count} cells` : `mesh.glb has ${mesh.vertices} vertices`;
    throw notOfOnePage(`${found} where the model shades ${described.vertices}`);
  }
  for (const each of described.environments) each.coefficients = Float32Array.from(each.coefficients.flat());
  const viewer = new Viewer(at("canvas"), described, mesh, model, compressed, pictures);
  at("canvas").addEventListener("webglcontextlost", () =>
    window.complain("The graphics card was lost", "The system or another page took it away. Load this page again."),
  );
  if (volume ?? map) viewer.view.addFilled(volume ?? map);
  if (mirrors) viewer.view.addMirrors(mirrors);
  if (flight) viewer.let(new Flight(described.flight, ...flight));
  connect(viewer);
  await viewer.change();
  at("loading").hidden = true;
  document.body.dataset.ready = Math.round(performance.now());
  window.torchprt = viewer;
  viewer.raced = race(viewer, MODEL);
  await viewer.raced;
}

start().catch((fault) => {
  const { title, message } = fault instanceof Fault ? fault : { title: "The page stopped", message: `${fault.message ?? fault}. Load it again.` };
  window.complain(title, message);
});

// The mesh as flat arrays of float32, whatever the file holds them in.
import { BufferAttribute, BufferGeometry } from "three";
import { GLTFLoader } from "./libraries/loaders/GLTFLoader.js";
import { MeshoptDecoder } from "./libraries/libs/meshopt_decoder.module.js";
import { damaged, load } from "./faults.js";

/** Positions, normals and albedo of the mesh in a .glb, vertices as they are in the file. */
export async function loadMesh(url) {
  const content = await load(url, "arrayBuffer");
  let scene;
  try {
    ({ scene } = await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).parseAsync(content, ""));
  } catch (fault) {
    throw damaged(`${url} could not be read as a mesh (${fault.message ?? fault})`, fault);
  }
  let mesh;
  scene.traverse((node) => (mesh ??= node.isMesh ? node : undefined));
  if (!mesh) throw damaged(`${url} holds no mesh`);
  scene.updateMatrixWorld(true);
  const { position, normal, color } = mesh.geometry.attributes;
  const [positions, normals, albedo] = [position, normal, color].map(floats);
  // A quantised mesh has its scale, the same in all directions, and its place in the node.
  const e = mesh.matrixWorld.elements;
  for (let i = 0; i < positions.length; i += 3) {
    for (let k = 0; k < 3; k++) positions[i + k] = e[5 * k] * positions[i + k] + e[12 + k];
    const length = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[i + k] /= length;
  }
  const geometry = new BufferGeometry();
  geometry.setIndex(mesh.geometry.index);
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(normals, 3));
  return { geometry, vertices: position.count, normals, albedo };
}

/** `[V, 3]` of an attribute that may be whole numbers, and have a fourth that is only filled up. */
function floats(attribute) {
  const values = new Float32Array(3 * attribute.count);
  for (let i = 0; i < attribute.count; i++) {
    values[3 * i] = attribute.getX(i);
    values[3 * i + 1] = attribute.getY(i);
    values[3 * i + 2] = attribute.getZ(i);
  }
  return values;
}

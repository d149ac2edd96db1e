// What a scene of three.js holds: meshes with baked transfer, under one light.
import { FileLoader, Matrix3, Matrix4, Quaternion, Vector3 } from "three";
import { parseTransfer } from "./file.js";
import { PRTLight } from "./light.js";
import { attributeMaterial, lobeMaterial, mapMaterial, vertexMaterial } from "./material.js";
import { Shading } from "./shading.js";
import { textureOf } from "./textures.js";

/**
 * The model in a folder that `torchprt export --three` wrote. `loader`: a GLTFLoader, which reads its meshes. Put
 * `object` into a scene, set `light`, and call `update(renderer, camera)` before every frame.
 */
export async function loadPRT(folder, loader, options = {}) {
  const at = new URL(folder.endsWith("/") ? folder : `${folder}/`, document.baseURI);
  const [{ scene, animations }, buffer] = await Promise.all([
    loader.loadAsync(new URL("model.glb", at).href),
    new FileLoader().setResponseType("arraybuffer").loadAsync(new URL("transfer.bin", at).href),
  ]);
  const model = new PRTModel(scene, parseTransfer(buffer), options);
  model.animations = animations;
  return model;
}

/** The model of a .glb whose vertices have transfer as attributes, `torchprt export -o transfer.glb`. */
export async function loadPRTAttributes(url, loader) {
  const { scene, animations } = await loader.loadAsync(url);
  const model = new PRTModel(scene, null);
  model.animations = animations;
  return model;
}

export class PRTModel {
  /** `object`: an Object3D whose frame is that of the bake; its meshes have `_prt_id` or texture coordinates. */
  constructor(object, transfer, { channel = 0, mipmaps = false } = {}) {
    this.object = object;
    this.transfer = transfer;
    this.light = null;
    this.animations = [];
    this.shading = null;
    this.lit = [];
    const meshes = [];
    object.updateWorldMatrix(true, true);
    object.traverse((each) => each.isMesh && meshes.push(each));
    const { about, tensors } = transfer ?? {};
    const [zonal] = about?.layers.filter(({ signal }) => signal === "zonal") ?? [];
    if (zonal) {
      const textures = {
        prtLobes: textureOf(tensors["0.lobes"]),
        prtWeight: zonal.uniform ? new Vector3(...zonal.uniform) : textureOf(tensors["0.weight"]),
      };
      for (const mesh of meshes.filter(({ geometry }) => geometry.attributes._prt_id)) {
        this.#give(mesh, lobeMaterial(about, zonal, textures, mesh));
        mesh.material.uniforms.prtRest.value = restOf(mesh, object);
        this.lit.push(mesh.material.uniforms);
      }
    } else if (about) {
      this.shading = new Shading(transfer, { mipmaps });
      const map = this.shading.map;
      const name = map ? (channel ? `uv${channel}` : "uv") : "_prt_id";
      for (const mesh of meshes.filter(({ geometry }) => geometry.attributes[name])) {
        this.#give(mesh, map ? mapMaterial(this.shading, channel, mesh.material.side) : vertexMaterial(this.shading, mesh));
      }
    } else {
      for (const mesh of meshes.filter(({ geometry }) => geometry.attributes._prt_0)) {
        const said = mesh.userData.torchprt ?? mesh.geometry.userData.torchprt ?? mesh.parent?.userData.torchprt;
        if (!said) throw new Error("The mesh does not say of which order its transfer is: export it with torchprt.");
        this.#give(mesh, attributeMaterial(said, mesh));
        this.lit.push(mesh.material.uniforms);
      }
    }
    this.meshes = meshes.filter(({ material }) => material.userData.torchprt);
    if (!this.meshes.length) {
      throw new Error("No mesh of this object has what its transfer needs: load the model.glb of the same folder.");
    }
  }

  #give(mesh, made) {
    made.userData.torchprt = true;
    mesh.material = made;
  }

  /** Bands of the light that it answers to. */
  get order() {
    return this.transfer ? this.transfer.about.order : Math.sqrt(this.lit[0].prtLight.value.length);
  }

  /** Before every frame: whatever changed of the light, of the place of the model and, for gloss, of the camera. */
  update(renderer, camera) {
    if (!(this.light instanceof PRTLight)) throw new Error("The model has no light: set its `light` to a PRTLight.");
    this.object.updateWorldMatrix(true, true);
    const turn = new Quaternion();
    this.object.matrixWorld.decompose(new Vector3(), turn, new Vector3());
    turn.invert();
    const light = this.light.turned(this.order, turn);
    if (this.shading) {
      camera.updateWorldMatrix(true, false);
      const eye = new Vector3().setFromMatrixPosition(camera.matrixWorld);
      this.shading.render(renderer, light, eye.applyMatrix4(new Matrix4().copy(this.object.matrixWorld).invert()));
    }
    const frame = new Matrix3().setFromMatrix4(new Matrix4().makeRotationFromQuaternion(turn));
    for (const { prtLight, prtFrame } of this.lit) {
      for (const [i, each] of prtLight.value.entries()) each.fromArray(light, 3 * i);
      prtFrame?.value.copy(frame);
    }
  }

  dispose() {
    this.shading?.dispose();
    for (const { material } of this.meshes) {
      for (const { value } of Object.values(material.uniforms)) if (value?.isTexture) value.dispose();
      material.dispose();
    }
  }
}

/** The inverse of how its node, or its bones, turn a mesh as it was baked; bones must do it as one. */
function restOf(mesh, object) {
  const turnOf = (matrix) => {
    const turn = new Quaternion();
    matrix.decompose(new Vector3(), turn, new Vector3());
    return turn;
  };
  const world = new Matrix4().copy(object.matrixWorld).invert().multiply(mesh.matrixWorld);
  let rest = turnOf(world);
  if (mesh.isSkinnedMesh) {
    mesh.skeleton.update();
    const turns = mesh.skeleton.bones.map((_, i) => {
      const bone = new Matrix4().fromArray(mesh.skeleton.boneMatrices, 16 * i);
      return turnOf(bone.premultiply(mesh.bindMatrixInverse).premultiply(world).multiply(mesh.bindMatrix));
    });
    [rest] = turns;
    if (turns.some((turn) => rest.angleTo(turn) > 0.01)) {
      throw new Error("The bones of the model were bent when it was baked: bake it in the pose that it is bound in.");
    }
  }
  return new Matrix3().setFromMatrix4(new Matrix4().makeRotationFromQuaternion(rest.invert()));
}

"""Does a glTF that went through a bake open in three.js with everything that it had?"""

import io
import json
import shutil

import numpy as np
import pytest
import torch
from atlases import lit_cube
from gltf_files import Gltf
from PIL import Image
from web.conftest import at

from torchprt import bake, load_transfer, save_transfer
from torchprt.preview import find_asset, save_lit_glb, save_transfer_glb
from torchprt.scene import load
from torchprt.shade import srgb

PAGE = """<!doctype html><link rel="icon" href="data:,"><script type="importmap">
{"imports": {"three": "./three.module.min.js"}}</script><script type="module">
import { GLTFLoader } from "./loaders/GLTFLoader.js";
const pixels = async (texture) => {
  const canvas = new OffscreenCanvas(texture.image.width, texture.image.height);
  const context = canvas.getContext("2d");
  context.drawImage(texture.image, 0, 0);
  const { width, height, data } = context.getImageData(0, 0, canvas.width, canvas.height);
  return { width, height, data: Array.from(data), wrap: texture.wrapS, flip: texture.flipY, space: texture.colorSpace,
    channel: texture.channel };
};
window.tell = async (address) => {
  const file = await new GLTFLoader().loadAsync(address);
  const objects = [];
  file.scene.updateMatrixWorld(true);
  const all = [];
  file.scene.traverse((object) => all.push(object));
  for (const object of all) {
    const told = { name: object.name, type: object.type, data: object.userData, matrix: object.matrixWorld.toArray() };
    if (object.isMesh) {
      const { material, geometry } = object;
      told.indices = geometry.index && Array.from(geometry.index.array);
      told.attributes = {};
      for (const [name, each] of Object.entries(geometry.attributes)) {
        const rows = Array.from({ length: each.count }, (_, row) => row);
        told.attributes[name] = rows.map((row) =>
          Array.from({ length: each.itemSize }, (_, column) => each.getComponent(row, column)));
      }
      told.material = { name: material.name, type: material.type, colour: material.color.toArray(), side: material.side,
        rough: material.roughness, metal: material.metalness, coloured: material.vertexColors, data: material.userData,
        map: material.map && await pixels(material.map), bump: material.normalMap && await pixels(material.normalMap),
        glow: material.emissive && material.emissive.toArray(), alpha: material.alphaTest };
    }
    objects.push(told);
  }
  const animations = file.animations.map((clip) => ({ name: clip.name,
    tracks: clip.tracks.map((track) => [track.name, Array.from(track.times), Array.from(track.values)]) }));
  const cameras = file.cameras.map((camera) => [camera.name, camera.fov, camera.near]);
  return { objects, animations, cameras, asset: file.asset };
};
document.body.dataset.ready = "";
</script><body>assets</body>"""


def picture(seed: int) -> bytes:
    content = io.BytesIO()
    values = np.random.default_rng(seed).integers(64, 256, (8, 4, 3), np.uint8)
    Image.fromarray(values).save(content, "PNG")
    return content.getvalue()


def room() -> Gltf:
    """A floor and a wall of two materials in one mesh, twice there, with a camera, a movement and extras."""
    made = Gltf()
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]])
    up, uv = np.tile([0.0, 1, 0], (4, 1)), np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
    halves = np.array([0, 1, 2, 0, 2, 3], "<u2")
    wall = square[:, [0, 2, 1]] * [1, -1, 1] + [0, 0, -1]
    first = made.primitive(made.accessor(halves), POSITION=square, NORMAL=up, TEXCOORD_0=uv, TEXCOORD_1=uv / 2)
    forth = np.tile([0.0, 0, 1], (4, 1))
    paint = made.accessor(np.full((4, 4), 128, "u1"), normalized=True)
    second = made.primitive(made.accessor(halves), POSITION=wall, NORMAL=forth, TEXCOORD_0=uv, COLOR_0=paint)
    times, moves = made.accessor(np.float32([0, 1])), made.accessor(np.float32([[0, 0, 0], [0, 1, 0]]))
    images = [
        {"bufferView": made.view(picture(seed)), "mimeType": "image/png", "name": f"p{seed}"} for seed in range(3)
    ]
    made.tree |= {
        "scene": 0,
        "scenes": [{"nodes": [0, 3], "name": "all"}],
        "nodes": [
            {"name": "house", "children": [1, 2], "extras": {"owner": "me"}, "translation": [0, 0, 1]},
            {"name": "left", "mesh": 0, "scale": [2, 1, 1], "extras": {"n": 1}},
            {"name": "right", "mesh": 0, "translation": [3, 0, 0], "rotation": [0, 0.6, 0, 0.8]},
            {"name": "seen from", "camera": 0, "translation": [0, 1, 5]},
        ],
        "cameras": [{"type": "perspective", "name": "eye", "perspective": {"yfov": 0.7, "znear": 0.1}}],
        "meshes": [
            {
                "name": "room",
                "primitives": [{**first, "material": 0}, {**second, "material": 1}],
                "extras": {"rooms": 1},
            }
        ],
        "materials": [
            {
                "name": "tiles",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "baseColorFactor": [0.5, 1, 0.25, 1],
                    "roughnessFactor": 0.3,
                    "metallicFactor": 0,
                },
                "normalTexture": {"index": 2},
                "extras": {"cost": 3},
            },
            {
                "name": "paper",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}, "metallicFactor": 0},
                "emissiveFactor": [0, 0.1, 0],
                "alphaMode": "MASK",
                "alphaCutoff": 0.25,
            },
        ],
        "textures": [{"source": each, "sampler": 0} for each in range(3)],
        "samplers": [{"wrapS": 33071, "magFilter": 9728}],
        "images": images,
        "animations": [
            {
                "name": "up",
                "samplers": [{"input": times, "output": moves}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
            }
        ],
        "extras": {"of the file": True},
    }
    return made


@pytest.fixture(scope="module")
def folder(libraries, tmp_path_factory):
    """A site of the room before and after, and of three.js as it comes from npm."""
    folder = tmp_path_factory.mktemp("assets") / "site"
    shutil.copytree(libraries, folder)
    room().save(folder / "before.glb")
    save_transfer(bake(load(folder / "before.glb"), order=3, rays=64, progress=False), folder / "room.safetensors")
    (folder / "index.html").write_text(PAGE)
    return folder


@pytest.fixture
def opened(folder, visit):
    """`opened(name, ...)`: what three.js says of these files."""

    def opened(*names):
        page = visit()
        with at(folder) as address:
            page.open(f"{address}/index.html")
            told = [page.page.evaluate(f"() => window.tell({json.dumps(name)})") for name in names]
        assert not page.complaints
        return told

    return opened


def test_a_glb_with_transfer_opens_with_all_that_it_had(folder, opened):
    transfer = load_transfer(folder / "room.safetensors")
    asset, why = find_asset(transfer)
    assert why == f"keeps what {folder / 'before.glb'} holds"
    save_transfer_glb(transfer, folder / "after.glb", 3, asset=asset)
    before, after = opened("before.glb", "after.glb")
    assert len([each for each in before["objects"] if "material" in each]) == 4
    numbers = []
    for old, new in zip(before["objects"], after["objects"], strict=True):
        if "attributes" in new:
            found = [new["attributes"].pop(f"_prt_{k}") for k in range(3)]
            numbers.append((new["attributes"].pop("_prt_albedo"), np.concatenate(found, axis=1)))
        # three.js numbers meshes of one name.
        assert new.pop("name").split("_")[0] == old.pop("name").split("_")[0]
        said = new["data"].pop("torchprt", None)
        assert said is None or (said["order"], said["channels"]) == (3, 1)
        assert new == old
    assert after["animations"] == before["animations"]
    assert after["cameras"] == before["cameras"]
    # Meshes in the order of the file: its primitives, of each the nodes; three.js goes node by node.
    rows = np.concatenate([numbers[k][1] for k in (0, 2, 1, 3)])[:, :9]
    np.testing.assert_allclose(rows, transfer.layers["diffuse"].signal.values[0].T, rtol=1e-6, atol=1e-7)
    albedo = np.concatenate([numbers[k][0] for k in (0, 2, 1, 3)])
    np.testing.assert_allclose(albedo, transfer.albedo, rtol=1e-6)
    # Factors of the tiles, and pictures of 64 to 255 in sRGB: not the grey of bakes that know no material.
    assert np.ptp(albedo) > 0.1


def test_a_map_is_on_its_own_texture_coordinates_and_needs_no_light(folder, opened):
    whole = lit_cube()
    colours = torch.rand(whole.vertices, 3, generator=torch.Generator().manual_seed(0))
    save_lit_glb(whole, colours, folder / "map.glb")
    (told,) = opened("map.glb")
    (cube,) = (each for each in told["objects"] if "material" in each)
    assert cube["material"]["type"] == "MeshBasicMaterial"
    # Texture coordinates that a texture does not name would be those of set 0.
    assert cube["material"]["map"]["channel"] == 1
    found = np.array(cube["attributes"]["uv1"])[np.array(cube["indices"])].reshape(-1, 3, 2)
    np.testing.assert_allclose(found, whole.receivers.mesh_uv, atol=1e-6)
    pixels = np.array(cube["material"]["map"]["data"]).reshape(20, 30, 4)[..., :3]
    np.testing.assert_allclose(pixels, srgb(whole.receivers.image(colours)) * 255, atol=1)
    assert cube["material"]["map"]["space"] == "srgb"


def test_a_glb_under_a_light_keeps_textures_and_needs_no_light(folder, opened):
    transfer = load_transfer(folder / "room.safetensors")
    colours = transfer.positions.float() / 10 + 0.3
    save_lit_glb(transfer, colours, folder / "lit.glb")
    before, after = opened("before.glb", "lit.glb")
    for old, new in zip(before["objects"], after["objects"], strict=True):
        if "material" not in new:
            assert new == old
            continue
        material = new["material"]
        assert (material["type"], material["coloured"]) == ("MeshBasicMaterial", True)
        assert material["colour"] == [1, 1, 1]
        for kept in ("name", "map", "side", "alpha"):
            assert material[kept] == old["material"][kept]
        for name, values in old["attributes"].items():
            assert name == "color" or new["attributes"][name] == values

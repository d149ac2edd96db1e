"""Does the module for three.js draw, in a real browser, what torch computes: every pixel to 2 parts in 255?"""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from gltf_files import Gltf
from scipy.ndimage import binary_erosion
from web.conftest import SIZE, Visit, at

from torchprt import bake, light, preview, sh, web
from torchprt.compression import compress, fit
from torchprt.pose import SkinnedMesh
from torchprt.preview import Camera, Still
from torchprt.preview.environment import Environment
from torchprt.scene import Material, load, samples
from torchprt.shade import shader
from torchprt.transfer import Dense, Diffuse, Transfer
from torchprt.transfer.atlas import Atlas, bilinear

PIXELS = 192
BY_ATTRIBUTES = ("attributes", "leaf3")
# Of half precision (2^-11 a number), for sums of 25 numbers whose signs cancel.
HALF = 3e-3
# What a shader does after the numbers are read: sums of 25 products in float32.
CLOSE = 64 * np.finfo(np.float32).eps


def atlas_of(rows=24):
    """A square of two charts side by side, with transfer that varies from texel to texel, and gutters of one texel."""
    columns = 2 * rows
    low, high = 2, rows - 2
    corner = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0.5, 0, 1], [0, 0, 1]])
    positions = torch.cat([corner, corner + torch.tensor([0.5, 0, 0])])
    faces = torch.tensor([[0, 2, 1], [0, 3, 2], [4, 6, 5], [4, 7, 6]], dtype=torch.int32)
    square = torch.tensor([[low, high], [high, high], [high, low], [low, low]]) / torch.tensor([columns, rows])
    uv = torch.cat([square, square + torch.tensor([rows / columns, 0])])[faces.long()]
    row, column = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    inside = (row >= low) & (row < high) & (column % rows >= low) & (column % rows < high)
    texel = inside.flatten().nonzero()[:, 0]
    number = torch.full((rows * columns,), -1)
    number[texel] = torch.arange(len(texel))
    # Around: of the row or column at the border, half of the nearest and half of the next.
    near_row, near_column = row.clamp(low, high - 1), (column % rows).clamp(low, high - 1) + column // rows * rows
    around = ((row - near_row).abs() + (column - near_column).abs() == 1).flatten().nonzero()[:, 0]
    nearest = number[(near_row * columns + near_column).flatten()[around]]
    sources = torch.stack([nearest, (nearest + 1).clamp(max=len(texel) - 1), nearest, nearest], -1)
    place = torch.stack([column.flatten()[texel] / columns, torch.zeros(len(texel)), row.flatten()[texel] / rows], -1)
    return Atlas(
        rows=rows,
        columns=columns,
        positions=place,
        normals=torch.tensor([0.0, 1, 0]).repeat(len(texel), 1),
        texel=texel.int(),
        chart=(column.flatten()[texel] // rows).int(),
        mesh_positions=positions,
        mesh_normals=torch.tensor([0.0, 1, 0]).repeat(8, 1),
        mesh_faces=faces,
        mesh_uv=uv,
        gutter=around.int(),
        gutter_sources=sources.int(),
        gutter_weights=torch.tensor([0.5, 0.5, 0, 0]).repeat(len(around), 1),
    )


def smooth_vectors(channels, order, places, contrast=0.2):
    """Random transfer that is smooth over a surface."""
    generator = torch.Generator().manual_seed(channels + order)
    band = torch.arange(order).repeat_interleave(2 * torch.arange(order) + 1)
    waves = torch.randn(channels, order**2, 3, generator=generator)
    values = torch.sin(2 * (waves @ places.float().T) + torch.randn(channels, order**2, 1, generator=generator))
    values[:, 0] = 0.3 + 0.05 * values[:, 0]
    return torch.cat([values[:, :1], contrast * values[:, 1:] / (1 + band[1:, None]) ** 2], 1)


def write_limb(path):
    """A tube on two joints, whose armature is turned about the vertical, so that its rest is no identity."""
    (tube,) = (each.mesh for each in samples.cylinder(20).objects[:1])
    height = tube.positions[:, 1]
    share = ((height - height.min()) / (height.max() - height.min())).numpy()
    zero = np.zeros_like(share)
    made = Gltf(scene=0, scenes=[{"nodes": [0, 1]}])
    joints = made.accessor(np.tile([0, 1, 0, 0], (len(share), 1)).astype("u1"))
    weights = np.stack([1 - share, share, zero, zero], -1)
    arrays = {"POSITION": tube.positions.numpy(), "NORMAL": tube.normals.numpy(), "WEIGHTS_0": weights}
    primitive = made.primitive(tube.faces.numpy().reshape(-1), JOINTS_0=joints, **arrays)
    made.tree["meshes"] = [{"primitives": [primitive]}]
    half = 0.5**0.5
    made.tree["nodes"] = [
        {"mesh": 0, "skin": 0},
        {"children": [2, 3], "rotation": [0, half, 0, half]},
        {"name": "lower"},
        {"name": "upper"},
    ]
    made.tree["skins"] = [{"joints": [2, 3]}]
    return made.save(path), torch.from_numpy(weights[:, :2]).double()


def write_leaf(path, side=12):
    """A bent sheet whose material has two sides."""
    ticks = np.linspace(-1, 1, side)
    x, z = (each.ravel() for each in np.meshgrid(ticks, ticks))
    normals = np.stack([-1.2 * np.cos(2 * x), np.ones_like(x), np.zeros_like(x)], -1)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([corner, corner + side, corner + 1, corner + 1, corner + side, corner + side + 1])
    faces = faces.reshape(2, 3, -1).transpose(0, 2, 1)
    made = Gltf(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0}], materials=[{"doubleSided": True}])
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    primitive = made.primitive(faces.reshape(-1), POSITION=np.stack([x, 0.6 * np.sin(2 * x), z], -1), NORMAL=unit)
    made.tree["meshes"] = [{"primitives": [{**primitive, "material": 0}]}]
    return made.save(path)


@pytest.fixture(scope="module")
def cases(tmp_path_factory) -> dict[str, Transfer]:
    """What is drawn, by name."""
    limb = bake(load(write_limb(tmp_path_factory.mktemp("limb") / "limb.glb")[0]), order=4, rays=64, progress=False)
    plane = bake(samples.plane_and_blocker(24), order=5, rays=64, progress=False)
    # Colours that differ from vertex to vertex.
    albedo = 0.3 + 0.5 * (torch.sin(3 * plane.positions) * 0.5 + 0.5)
    plane = plane.with_layers(diffuse=plane.layers["diffuse"].replace(albedo=albedo))
    coloured = smooth_vectors(3, 5, plane.positions)
    dish = bake(
        samples.dish(20, Material(0.2, gloss="ggx:0.4", specular=(0.9, 0.6, 0.3))), order=3, rays=32, progress=False
    )
    atlas = atlas_of()
    mapped = Diffuse(albedo=torch.full((1, 1), 0.7), signal=Dense(values=smooth_vectors(1, 3, atlas.positions, 0.5)))
    leaf = bake(load(write_leaf(tmp_path_factory.mktemp("leaf") / "leaf.glb")), order=4, rays=64, progress=False)
    return {
        "leaf": leaf,
        "leaf3": leaf,
        "attributes": plane,
        "dense": plane,
        "colours": plane.with_layers(diffuse=Diffuse(albedo=albedo, signal=Dense(values=coloured))),
        "clustered": compress(plane, clusters=6, components=5),
        "exit": dish,
        "packed": compress(dish, clusters=4, components=6),
        "lobes": fit(limb, lobes=2),
        "atlas": Transfer(receivers=atlas, layers={"diffuse": mapped}),
    }


@pytest.fixture(scope="module")
def site(libraries, cases, tmp_path_factory):
    folder = tmp_path_factory.mktemp("three")
    for name, transfer in cases.items():
        order = 3 if name in BY_ATTRIBUTES else None
        asset = preview.find_asset(transfer)[0] if name in ("lobes", "leaf", "leaf3") else None
        options = {"order": order, "asset": asset, "exact": name == "packed", "environments": LAMPS}
        web.export_three(transfer, folder / name, check=False, **options)
    packed = compress(cases["exit"], clusters=4, components=6)
    web.export(cases["exit"], folder / "page", compressed=packed, environments=LAMPS, check=False, gpu=True)
    web.export(cases["atlas"], folder / "mapped", environments=LAMPS, check=False, gpu=True)
    np.save(folder / "sky.npy", LIGHT.numpy())
    return folder


STUDIO = light.built_in("studio", 32)
LIGHT = light.project(STUDIO, 5).float()
LAMPS = [Environment("Studio", LIGHT, STUDIO)]


@pytest.fixture(scope="module")
def tab(browser, site):
    """The example in a folder, which all cases are drawn in: a browser is slow to start."""
    with at(site) as root:
        page = browser.new_page(viewport=SIZE)
        tab = Visit(page).open(f"{root}/dense/")
        tab.ask(DRAW)
        yield tab
        page.close()


# How the light is turned, and the model.
TURN = sh.yaw_pitch_roll(torch.tensor([70.0, 20, -10], dtype=torch.float64))
DRAW = """
it.renderer.setAnimationLoop(null);
const THREE = it.THREE;
const { GLTFLoader } = await import("./libraries/loaders/GLTFLoader.js");
it.module = await import("./torchprt.js");
it.loader = new GLTFLoader();
it.load = async (name) => {
  const { loadPRT, loadPRTAttributes } = it.module;
  if (["attributes", "leaf3"].includes(name)) return loadPRTAttributes(`../${name}/model.glb`, it.loader);
  return loadPRT(`../${name}/`, it.loader);
};
/** Pixels of an object under a camera of Python, as bytes in a string. */
it.shoot = (object, { eye, target, field }, model) => {
  const { renderer } = it;
  const size = PIXELS;
  renderer.toneMapping = THREE.NoToneMapping;
  renderer.setPixelRatio(1);
  renderer.setSize(size, size, false);
  renderer.setClearColor(0);
  const camera = new THREE.PerspectiveCamera(field, 1, 0.01, 100);
  camera.position.set(...eye);
  camera.lookAt(...target);
  const scene = new THREE.Scene();
  scene.add(object);
  model?.update(renderer, camera);
  renderer.render(scene, camera);
  const gl = renderer.getContext();
  const values = new Uint8Array(4 * size * size);
  gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, values);
  scene.remove(object);
  return Array.from(values, (value) => String.fromCharCode(value)).join("");
};
/** Turned as the row-major matrix. */
it.turn = ([a, b, c, d, e, f, g, h, i]) =>
  new THREE.Quaternion().setFromRotationMatrix(new THREE.Matrix4().set(a, b, c, 0, d, e, f, 0, g, h, i, 0, 0, 0, 0, 1));
""".replace("PIXELS", str(PIXELS))


def bytes_of(text):
    """`[H, W, 3]`, the upper row first."""
    return np.frombuffer(text.encode("latin-1"), np.uint8).reshape(PIXELS, PIXELS, 4)[::-1, :, :3].astype(int)


def camera_of(transfer):
    return preview.frame(preview.subject(transfer.receivers), aspect=1.0)


def flat(values):
    return json.dumps(torch.as_tensor(values).double().flatten().tolist())


def shown(camera):
    return json.dumps({"eye": list(camera.eye), "target": list(camera.target), "field": camera.field})


def check_pixels(found, positions, faces, radiance, camera, *, at_places=None, most=2):
    """Of the picture what is well inside of the silhouette, against rays cast in Python."""
    still = Still(positions.float(), faces, size=(PIXELS, PIXELS), camera=camera, samples=1)
    values = still.radiance(radiance.float(), background=0.0) if at_places is None else at_places(still)
    covered = still.radiance(torch.ones(len(positions), 3), background=0.0)[..., 0].numpy() > 0.5
    # Where one part of the surface stands before another, rays and rasterised triangles disagree about a pixel.
    places = still.radiance(positions.float(), background=0.0).numpy()
    step = sum(np.abs(np.diff(places, axis=axis, append=0)).max(-1) for axis in (0, 1))
    covered &= step < 6 * np.median(step[binary_erosion(covered)])
    inside = binary_erosion(covered, iterations=2)
    linear = values.double().clamp(0, 1)
    encoded = torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    expected = (255 * encoded.numpy()).round()
    assert inside.sum() > 3000
    assert np.ptp(expected[inside]) > 50
    apart = np.abs(found - expected)[inside].max(-1)
    assert apart.max() <= most


def draw(tab, name, camera, exposure=0.3, turned=True):
    """Pixels of a case under the light, turned, and the radiance of its receivers if there is a texture of them."""
    pixels, radiance, where = tab.ask(f"""
        const model = await it.load("{name}");
        const [light] = await it.module.loadLights("../sky.npy");
        light.intensity = {exposure};
        light.quaternion.copy(it.turn({flat(TURN)}));
        model.light = light;
        const pixels = it.shoot(model.object, {shown(camera)}, model);
        const radiance = model.shading ? Array.from(model.shading.read(it.renderer)) : null;
        const bytes = model.meshes.length;
        model.dispose();
        return [pixels, radiance, bytes];
    """)
    assert where >= 1
    return bytes_of(pixels), None if radiance is None else np.reshape(radiance, (-1, 3))


def test_the_example_runs_from_a_plain_folder_and_asks_nothing_of_others(tab):
    assert tab.complaints == []
    names = {url.split("/dense/")[-1] for url in tab.requests}
    assert {"torchprt.js", "model.glb", "transfer.bin", "lights.json"} <= names
    assert not [name for name in names if "onnx" in name or "ort." in name or "wasm" in name]


OWN = """<!doctype html><link rel="icon" href="data:,"><body><script type="importmap">
{"imports": {"three": "./scene/libraries/three.module.min.js", "three/addons/": "./scene/libraries/"}}
</script><script type="module">
import * as THREE from "three";
const renderer = new THREE.WebGLRenderer();
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(40, 1, 0.1, 100);
camera.position.set(0, 4, 6);
camera.lookAt(0, 0, 0);
CODE
const drawn = new Uint8Array(4);
renderer.render(scene, camera);
const gl = renderer.getContext();
gl.readPixels(150, 75, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, drawn);
window.torchprt = { drawn: [...drawn], frames: renderer.info.render.frame };
document.body.dataset.ready = "yes";
</script>"""


def test_the_lines_of_the_docs_run_in_a_scene_of_ones_own(browser, site):
    text = (Path(__file__).parents[2] / "docs" / "gpu.md").read_text()
    code = re.search(r"```js\n(.*?)```", text, re.DOTALL)[1]
    assert len(code.strip().splitlines()) <= 12
    (site / "own").mkdir()
    shutil.copytree(site / "dense", site / "own" / "scene")
    (site / "own" / "index.html").write_text(
        OWN.replace("CODE", code + "await new Promise((done) => setTimeout(done, 300));")
    )
    with at(site) as root:
        page = browser.new_page(viewport=SIZE)
        tab = Visit(page).open(f"{root}/own/")
        assert tab.complaints == []
        drawn, frames = tab.ask("return [it.drawn, it.frames];")
        page.close()
    assert frames > 1
    assert min(drawn[:3]) > 30


@pytest.mark.parametrize("name", ["attributes", "dense", "colours", "clustered", "exit", "packed"])
def test_every_pixel_is_that_of_torch(tab, cases, name):
    transfer = cases[name].to_order(3) if name == "attributes" else cases[name]
    camera = camera_of(transfer)
    if "eye" in transfer.needs:
        # From above, where no part of it hides another.
        away = float(np.linalg.norm(np.subtract(camera.eye, camera.target)))
        camera = Camera((0.1 * away, 0.95 * away, 0.3 * away), camera.target, field=camera.field)
    found, radiance = draw(tab, name, camera)
    count = transfer.order**2
    lamp = sh.rotate(LIGHT[:count].double(), TURN) * 0.3
    eye = torch.tensor(camera.eye, dtype=torch.float64)
    seen = {"eye": eye} if "eye" in transfer.needs else {}
    expected = shader(transfer).double()(lamp, **seen)
    check_pixels(found, transfer.positions, transfer.faces, expected, camera)
    if radiance is not None:
        read = web.shader_file(transfer, exact=name == "packed").transfer
        size = float(expected.abs().max())
        np.testing.assert_allclose(radiance, shader(read).double()(lamp, **seen), rtol=0, atol=16 * CLOSE * size)
        assert np.abs(radiance - expected.numpy()).max() < HALF * size


@pytest.mark.parametrize("name", ["leaf", "leaf3"])
@pytest.mark.parametrize("height", [3.0, -3.0])
def test_both_sides_of_a_sheet_show_what_each_recorded(tab, cases, name, height):
    transfer = cases[name].to_order(3) if name in BY_ATTRIBUTES else cases[name]
    assert {each["side"] for each in transfer.receivers.objects} == {"front", "back"}
    camera = Camera((0.4, height, 0.3), (0.0, 0.0, 0.0), field=45.0)
    found, _ = draw(tab, name, camera)
    lamp = sh.rotate(LIGHT[: transfer.order**2].double(), TURN) * 0.3
    check_pixels(found, transfer.positions, transfer.faces, shader(transfer).double()(lamp), camera)


def test_a_model_that_is_moved_turned_and_scaled_stays_in_the_light_and_under_the_eye_of_the_world(tab, cases):
    transfer = cases["exit"]
    whole = sh.yaw_pitch_roll(torch.tensor([50.0, -20, 130], dtype=torch.float64))
    place, eye = torch.tensor([1.0, 2, -3]).double(), torch.tensor([2.0, 4, 1]).double()
    found = tab.ask(f"""
        const model = await it.load("exit");
        [model.light] = await it.module.loadLights("../sky.npy");
        model.light.quaternion.copy(it.turn({flat(TURN)}));
        model.object.quaternion.copy(it.turn({flat(whole)}));
        model.object.scale.setScalar(2);
        model.object.position.set(...{flat(place)});
        const camera = new it.THREE.PerspectiveCamera();
        camera.position.set(...{flat(eye)});
        model.update(it.renderer, camera);
        const first = Array.from(model.shading.read(it.renderer));
        // Nothing moved, so nothing is drawn; then only the eye does.
        const again = model.shading.render(it.renderer, model.shading.light, model.shading.eye);
        camera.position.x += 1;
        model.update(it.renderer, camera);
        const second = Array.from(model.shading.read(it.renderer));
        model.dispose();
        return [first, second, again];
    """)
    assert found[2] is False
    lamp = sh.rotate(sh.rotate(LIGHT[:9].double(), TURN), whole.T)
    read = shader(web.shader_file(transfer).transfer).double()
    for values, step in zip(found[:2], (0.0, 1.0), strict=True):
        there = whole.T @ (eye + torch.tensor([step, 0, 0]) - place) / 2
        expected = read(lamp, eye=there)
        size = float(expected.abs().max())
        np.testing.assert_allclose(np.reshape(values, (-1, 3)), expected, rtol=0, atol=16 * CLOSE * size)


def test_a_map_is_read_between_its_texels_and_in_its_gutters(tab, cases):
    transfer = cases["atlas"]
    atlas = transfer.receivers.as_atlas()
    camera = Camera((0.5, 1.6, 0.5001), (0.5, 0.0, 0.5), field=40.0)
    found, radiance = draw(tab, "atlas", camera)
    lamp = sh.rotate(LIGHT[:9].double(), TURN) * 0.3
    values = shader(web.shader_file(transfer).transfer).double()(lamp)
    np.testing.assert_allclose(radiance, values, rtol=0, atol=CLOSE * float(values.max()))
    # A vertex for every corner, so that coordinates may jump at a seam.
    corners = atlas.mesh_positions[atlas.mesh_faces.long()].flatten(0, 1)
    faces = torch.arange(len(corners)).reshape(-1, 3)
    uv = torch.cat([atlas.mesh_uv.flatten(0, 1), torch.zeros(len(corners), 1)], 1).float()

    def at_places(still):
        places = still.radiance(uv, background=0.0)[..., :2].reshape(-1, 2)
        return bilinear(atlas.image(values).float(), places).reshape(PIXELS, PIXELS, 3)

    check_pixels(found, corners, faces, torch.zeros(len(corners), 3), camera, at_places=at_places)


def test_a_set_of_lightmaps_adds_up_what_each_light_brings(tab, cases):
    transfer = cases["atlas"]
    atlas = transfer.receivers.as_atlas()
    # One map of each coefficient, as unit lights make them, and the light as their weights.
    maps = atlas.image(shader(transfer)(torch.eye(9)[..., None].expand(9, 9, 3).contiguous()))
    lamp = sh.rotate(LIGHT[:9].double(), TURN) * 0.3
    camera = Camera((0.5, 1.6, 0.5001), (0.5, 0.0, 0.5), field=40.0)
    # The lowest row first, as a loader of .exr has it.
    four = torch.cat([maps, torch.ones_like(maps[..., :1])], -1).flip(1)
    found = bytes_of(
        tab.ask(f"""
        const model = await it.load("atlas");
        const {{ THREE }} = it;
        const maps = {json.dumps([each.flatten().tolist() for each in four])}.map((data) =>
          new THREE.DataTexture(
            Float32Array.from(data), {atlas.columns}, {atlas.rows}, THREE.RGBAFormat, THREE.FloatType));
        const material = it.module.lightmapMaterial(maps, {{ lowestFirst: true }});
        const weights = {json.dumps(lamp.tolist())};
        material.uniforms.prtWeights.value.forEach((each, i) => each.set(...weights[i]));
        model.object.traverse((each) => {{ if (each.isMesh) each.material = material; }});
        return it.shoot(model.object, {shown(camera)});
    """)
    )
    drawn, _ = draw(tab, "atlas", camera)
    assert np.ptp(drawn) > 50
    assert np.abs(found - drawn).max() <= 2


def test_lobes_turn_with_the_bones_of_a_skinned_mesh(tab, cases, tmp_path):
    transfer = cases["lobes"]
    _, weights = write_limb(tmp_path / "limb.glb")
    bend = sh.yaw_pitch_roll(torch.tensor([40.0, 35, 50], dtype=torch.float64))
    armature = sh.yaw_pitch_roll(torch.tensor([90.0, 0, 0], dtype=torch.float64))
    joints = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    joints[1, :3, :3] = armature @ bend @ armature.T
    positions, frames = SkinnedMesh(transfer.positions.double(), weights)(joints)
    lamp = sh.rotate(LIGHT[:16].double(), TURN) * 0.3
    # The whole model is turned too, under a light that is not.
    whole = sh.yaw_pitch_roll(torch.tensor([-30.0, 0, 25], dtype=torch.float64))
    expected = shader(transfer).double()(lamp, frames=whole @ frames)
    positions = positions @ whole.T
    camera = preview.frame(positions.float(), aspect=1.0)
    pixels = tab.ask(f"""
        const model = await it.load("lobes");
        [model.light] = await it.module.loadLights("../sky.npy");
        model.light.intensity = 0.3;
        model.light.quaternion.copy(it.turn({flat(TURN)}));
        if (!model.meshes[0].isSkinnedMesh) throw new Error("not a skin");
        model.object.getObjectByName("upper").quaternion.copy(it.turn({flat(bend)}));
        model.object.quaternion.copy(it.turn({flat(whole)}));
        return it.shoot(model.object, {shown(camera)}, model);
    """)
    # Away from the rest pose, so that it is seen whether axes turn.
    still = shader(transfer).double()(lamp)
    assert float((still - expected).abs().max()) > 0.2 * float(expected.max())
    check_pixels(bytes_of(pixels), positions, transfer.faces, expected, camera)


def test_light_is_turned_and_projected_as_in_python(tab):
    sky = light.built_in("studio", 16).float()
    rows, columns, _ = sky.shape
    turned, projected = tab.ask(f"""
        const {{ THREE, module }} = it;
        const [light] = await module.loadLights("../sky.npy");
        light.quaternion.copy(it.turn({flat(TURN)}));
        const data = Float32Array.from({flat(torch.cat([sky, torch.ones_like(sky[..., :1])], -1))});
        const texture = new THREE.DataTexture(data, {columns}, {rows}, THREE.RGBAFormat, THREE.FloatType);
        texture.flipY = true;
        return [Array.from(light.turned(5)), Array.from(module.PRTLight.fromEquirect(texture, 5).coefficients)];
    """)
    close = {"rtol": 0, "atol": 1e-6 * float(LIGHT.abs().max())}
    np.testing.assert_allclose(np.reshape(turned, (-1, 3)), sh.rotate(LIGHT.double(), TURN), **close)
    # three.js has the middle of a picture at +x, where this project has -z.
    quarter = sh.yaw_pitch_roll(torch.tensor([-90.0, 0, 0], dtype=torch.float64))
    assert torch.allclose(quarter @ torch.tensor([0.0, 0, -1], dtype=torch.float64), torch.tensor([1.0, 0, 0]).double())
    expected = sh.rotate(light.project(sky.double(), 5), quarter)
    np.testing.assert_allclose(np.reshape(projected, (-1, 3)), expected, **close)


def test_a_page_that_shades_in_webgl_shows_what_torch_computes(browser, site, cases):
    with at(site) as root:
        page = browser.new_page(viewport=SIZE)
        tab = Visit(page).open(f"{root}/page/")
        tab.drag(90, 40, button="right")
        tab.drag(60, -20)
        assert tab.complaints == []
        assert not [url for url in tab.requests if "ort." in url or "onnx" in url]
        values = torch.tensor(tab.ask("return Array.from(it.light.coefficients);")).double().reshape(-1, 3)
        for mode, transfer in (("transfer", cases["exit"]), ("compressed", cases["packed"])):
            tab.page.click(f"#modes input[value={mode}]")
            found = np.reshape(tab.radiance(), (-1, 3))
            rotation, eye = tab.ask("return [it.rotation, it.view.eye.toArray()];")
            lamp = sh.rotate(values, torch.tensor(rotation).double().reshape(3, 3))
            expected = shader(web.shader_file(transfer).transfer).double()(lamp, eye=torch.tensor(eye).double())
            np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * float(expected.abs().max()))
        assert "WebGL 2" in tab.page.inner_text("#statistics")
        page.close()


def test_a_page_of_a_map_draws_it_on_the_meshes(browser, site, cases):
    transfer = cases["atlas"]
    atlas = transfer.receivers.as_atlas()
    with at(site) as root:
        page = browser.new_page(viewport=SIZE)
        tab = Visit(page).open(f"{root}/mapped/")
        found = np.reshape(tab.radiance(), (-1, 3))
        image, corners, where = tab.ask("""
            const { filled, geometry } = it.view;
            const { uv, position } = geometry.attributes;
            return [Array.from(filled.data), Array.from(uv.array), Array.from(position.array)];
        """)
        tab.page.click("#modes input[value=unshadowed]")
        plain = np.reshape(tab.radiance(), (-1, 3))
        assert "texels" in tab.page.inner_text("#statistics")
        assert tab.complaints == []
        page.close()
    values = shader(web.shader_file(transfer).transfer).double()(LIGHT[:9].double())
    np.testing.assert_allclose(found, values, rtol=0, atol=CLOSE * float(values.max()))
    shown = np.reshape(image, (atlas.rows, atlas.columns, 4))[..., :3]
    np.testing.assert_allclose(shown, atlas.image(values), rtol=0, atol=2 * CLOSE * float(values.max()))
    # Coordinates of the corners are those of the atlas: this one has u along x, and v along -z of each chart.
    uv, place = np.reshape(corners, (-1, 2)), np.reshape(where, (-1, 3))
    for corner, point in zip(uv, place, strict=True):
        same = (atlas.mesh_positions[atlas.mesh_faces.long()].flatten(0, 1) - torch.tensor(point)).abs().amax(1) < 1e-3
        assert (atlas.mesh_uv.flatten(0, 1)[same] - torch.tensor(corner)).abs().amax(1).min() < 1e-6
    assert plain.shape == found.shape
    assert np.ptp(plain) < np.ptp(found)


def test_faults_are_sentences(tab):
    for script, words in (
        ("it.module.parseTransfer(new ArrayBuffer(4))", "no transfer, or half of one"),
        ("new it.module.PRTLight([1, 2, 3, 4])", "3 for each of order"),
        ("it.model.light = null; it.model.update(it.renderer, it.camera)", "has no light"),
    ):
        said = tab.ask(f"try {{ {script} }} catch (fault) {{ return fault.message; }} return null;")
        assert words in (said or ""), said

"""Does the page, in a real browser and under a real mouse, show what ONNX Runtime in Python computes?"""

import gzip
import json
import shutil

import numpy as np
import onnxruntime
import pytest
import torch
from scipy.ndimage import binary_erosion
from transfers import stored
from web.conftest import SIZE, Visit, at

from torchprt import sh
from torchprt.preview import Camera, Still
from torchprt.preview.modes import one_lamp, unshadowed
from torchprt.shade import shader

# A few products of 16 or 25 numbers in float32, added in another order.
CLOSE = 32 * np.finfo(np.float32).eps
# As many numbers of 16 bits, each off by half a step at most.
PACKED = 16 * 0.5 / 65535


@pytest.fixture(scope="module")
def address(pages):
    with at(pages.parent) as root:
        yield f"{root}/some%20where"


@pytest.fixture
def plane_tab(visit, address):
    return visit().open(f"{address}/plane/")


def in_python(folder, name, rotation, *, eye=None, environment=0):
    """Radiance `[V, 3]` by ONNX Runtime for Python under a light of the page."""
    about = json.loads((folder / "scene.json").read_text())
    light = np.array(about["environments"][environment]["coefficients"], np.float32)
    feed = {"light": light[None], "rotation": np.array(rotation, np.float32).reshape(1, 3, 3)}
    if eye is not None:
        feed["eye"] = np.array(eye, np.float32)[None]
    content = gzip.decompress((folder / f"{name}.gz").read_bytes())
    return onnxruntime.InferenceSession(content).run(["radiance"], feed)[0][0]


def near(values, expected, close=CLOSE):
    expected = np.asarray(expected)
    np.testing.assert_allclose(np.asarray(values).reshape(-1, 3), expected, rtol=0, atol=close * np.abs(expected).max())


def test_it_loads_from_a_subfolder_of_any_server_and_asks_nothing_of_others(visit, address):
    tab = visit().open(f"{address}/plane/")
    tab.page.wait_for_load_state("networkidle")
    assert tab.complaints == []
    files = {url.removeprefix(f"{address}/plane/") for url in tab.requests if not url.startswith(("data:", "blob:"))}
    assert not [name for name in files if "://" in name]
    assert {"", "scene.json", "model.onnx.gz", "compressed.onnx.gz", "mesh.glb", "environments/0.jpg"} <= files
    assert tab.page.title() == "A plane"
    assert not tab.page.is_visible("#message")


def test_a_drag_of_the_light_changes_colours_and_one_of_the_camera_does_not(plane_tab):
    before, picture = plane_tab.radiance(), plane_tab.page.screenshot()
    plane_tab.drag(120, 0, button="right")
    turned = plane_tab.ask("return it.rotation;")
    after = plane_tab.radiance()
    assert np.abs(np.subtract(after, before)).max() > 0.05 * np.max(before)
    assert plane_tab.page.screenshot() != picture
    # To the right is a turn about +y: what shone from the front now shines from the right.
    assert np.allclose(np.reshape(turned, (3, 3)) @ [0, 1, 0], [0, 1, 0], atol=1e-6)
    assert (np.reshape(turned, (3, 3)) @ [0, 0, 1])[0] > 0.5
    plane_tab.drag(-60, 40, shift=True)
    assert plane_tab.ask("return it.rotation;") != turned
    lit, eye = plane_tab.radiance(), plane_tab.ask("return it.view.eye.toArray();")
    picture = plane_tab.page.screenshot()
    plane_tab.drag(80, -30)
    assert plane_tab.radiance() == lit
    assert plane_tab.ask("return it.view.eye.toArray();") != eye
    assert plane_tab.page.screenshot() != picture
    plane_tab.page.mouse.wheel(0, -300)
    plane_tab.page.wait_for_function("() => window.torchprt.view.distance < window.torchprt.view.farthest")


def test_keys_turn_light_and_camera_too(plane_tab):
    before = plane_tab.ask("return [it.rotation, it.view.azimuth];")
    plane_tab.page.focus("#canvas")
    plane_tab.page.keyboard.press("ArrowRight")
    plane_tab.page.keyboard.press("Shift+ArrowUp")
    after = plane_tab.ask("return [it.rotation, it.view.azimuth];")
    assert before[0] != after[0]
    assert before[1] != after[1]
    plane_tab.page.keyboard.press("+")
    assert plane_tab.ask("return it.view.distance < it.view.farthest;")


def test_one_finger_turns_the_camera_and_two_turn_the_light_and_zoom(plane_tab):
    def state():
        plane_tab.settled()
        return plane_tab.ask("return [it.rotation, it.view.azimuth, it.view.distance];")

    fingers = plane_tab.page.context.new_cdp_session(plane_tab.page)

    def touch(kind, *places):
        points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    start = state()
    touch("touchStart", (150, 200))
    touch("touchMove", (200, 200))
    touch("touchEnd")
    one = state()
    assert one[0] == start[0]
    assert one[1] != start[1]
    assert one[2] == start[2]
    touch("touchStart", (150, 200), (250, 200))
    touch("touchMove", (170, 240), (290, 240))
    touch("touchEnd")
    two = state()
    assert two[0] != one[0]
    assert two[1] == one[1]
    # 100 pixels apart became 120.
    assert two[2] == pytest.approx(one[2] / 1.2)


def test_radiance_is_that_of_onnx_runtime_in_python(plane_tab, pages):
    for right, down, number in ((0, 0, 0), (200, 0, 2), (-70, 110, 3)):
        plane_tab.page.click(f"#environments label:nth-child({number + 1})")
        plane_tab.drag(right, down, button="right")
        rotation = plane_tab.ask("return it.rotation;")
        near(plane_tab.radiance(), in_python(pages / "plane", "model.onnx", rotation, environment=number))
    plane_tab.page.click("#modes input[value=compressed]")
    rotation = plane_tab.ask("return it.rotation;")
    near(plane_tab.radiance(), in_python(pages / "plane", "compressed.onnx", rotation, environment=3))


def test_glossy_radiance_follows_the_eye(visit, address, pages, dish):
    tab = visit().open(f"{address}/dish/")
    seen = []
    for right, down in ((0, 0), (150, 20), (-300, -60)):
        tab.drag(right, down)
        eye, rotation = tab.ask("return [it.view.eye.toArray(), it.rotation];")
        seen.append(tab.radiance())
        expected = in_python(pages / "dish", "model.onnx", rotation, eye=eye)
        # The direction to the eye is rounded as well, which silhouettes magnify.
        assert np.abs(np.reshape(seen[-1], (-1, 3)) - expected).max() < 1e-4 * np.abs(expected).max()
    assert np.abs(np.subtract(seen[0], seen[1])).max() > 0.05 * np.max(seen[0])


def test_mirrors_are_drawn_and_show_what_surrounds_them(visit, address):
    tab = visit().open(f"{address}/dish/")
    with_it = tab.page.screenshot()
    tab.ask(
        "it.view.scene.children.find((each) => each.material === it.view.mirror).visible = false; await it.zoom(1);"
    )
    without = tab.page.screenshot()
    assert without != with_it
    tab.ask("it.view.scene.children.find((each) => each.material === it.view.mirror).visible = true; await it.zoom(1);")
    assert tab.page.screenshot() == with_it
    assert tab.complaints == []


def test_webgpu_computes_the_same(launch, address, pages):
    graphics = launch("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan")
    tab = Visit(graphics.new_page(viewport=SIZE)).open(f"{address}/plane/")
    values = tab.ask("""
        await it.raced;
        const { Model } = await import("./runtime.js");
        const model = await Model.openOnGpu("model.onnx.gz");
        return model && Array.from(await model.shade(it.light.coefficients, it.rotation, [0, 0, 0]));
    """)
    if values is None:
        pytest.skip("WEBGPU IS NOT TESTED: this Chromium has no adapter, not even in software")
    assert tab.complaints == []
    near(values, in_python(pages / "plane", "model.onnx", np.eye(3)))


def pixels(tab):
    """The canvas as it was drawn, `[H, W, 3]` bytes, without the environment."""
    tab.ask("it.surrounded = false;")
    tab.settled()
    width, height, values = tab.ask("""
        const gl = it.view.renderer.getContext();
        const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
        const values = new Uint8Array(4 * width * height);
        it.view.draw();
        gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, values);
        return [width, height, Array.from(values, (value) => String.fromCharCode(value)).join("")];
    """)
    return np.frombuffer(values.encode("latin-1"), np.uint8).reshape(height, width, 4)[::-1, :, :3]


@pytest.mark.parametrize("stops", [0.0, -2.5, 2.0])
def test_every_pixel_is_that_of_a_ray_caster_in_python_to_one_part_in_255(plane_tab, pages, plane, stops):
    plane_tab.drag(70, -30, button="right")
    plane_tab.drag(-40, 120)
    plane_tab.ask(f"it.stops = {stops};")
    shown = pixels(plane_tab)
    eye, target, field, rotation, exposure = plane_tab.ask(
        "return [it.view.eye.toArray(), it.view.target.toArray(), it.view.camera.fov, it.rotation, it.exposure];"
    )
    height, width, _ = shown.shape
    camera = Camera(tuple(map(float, eye)), tuple(map(float, target)), field=float(field))
    still = Still(plane.positions, plane.faces, size=(width, height), camera=camera, samples=1)
    radiance = torch.from_numpy(in_python(pages / "plane", "model.onnx", rotation))
    expected = (255 * still.picture(radiance, exposure=exposure).numpy()).round()
    inside = binary_erosion(
        still.radiance(torch.ones(len(radiance), 3), background=0.0)[..., 0].numpy() > 0.5, iterations=2
    )
    assert inside.sum() > 10_000
    assert np.abs(shown[inside] - expected[inside]).max() <= 1
    # Not one flat colour, which would prove little.
    assert np.ptp(expected[inside]) > 25


def test_modes_without_transfer_are_those_of_the_window(plane_tab, plane):
    plane_tab.drag(90, 50, button="right")
    rotation = torch.tensor(plane_tab.ask("return it.rotation;"), dtype=torch.float64).reshape(3, 3)
    light = torch.tensor(plane_tab.ask("return Array.from(it.light.coefficients);"), dtype=torch.float64).reshape(-1, 3)
    turned, normals = sh.rotate(light, rotation), plane.normals.double()
    for mode, function in (("unshadowed", unshadowed), ("lambert", one_lamp)):
        plane_tab.page.click(f"#modes input[value={mode}]")
        near(plane_tab.radiance(), (plane.albedo * function(turned, normals)).numpy(), PACKED)
    plane_tab.page.click("#modes input[value=transfer]")
    assert (
        np.abs(np.reshape(plane_tab.radiance(), (-1, 3)) - (plane.albedo * unshadowed(turned, normals)).numpy()).max()
        > 0.01
    )


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_its_basis_and_irradiance_are_ours(plane_tab, order):
    directions = torch.nn.functional.normalize(
        torch.randn(50, 3, generator=torch.Generator().manual_seed(order)), dim=-1
    )
    directions = torch.cat([directions, torch.eye(3), -torch.eye(3)]).double()
    light = torch.randn(order**2, 3, generator=torch.Generator().manual_seed(7)).double()
    values, reflected = plane_tab.ask(f"""
        const {{ basis, irradiance }} = await import("./sh.js");
        const directions = {directions.tolist()};
        const reflect = irradiance({light.flatten().tolist()});
        return [
          directions.map((d) => Array.from(basis(...d, {order}, new Float64Array({order**2})))),
          directions.map((d) => (reflect(...d, d), d)),
        ];
    """)
    np.testing.assert_allclose(values, sh.basis(directions, order), atol=1e-13)
    np.testing.assert_allclose(reflected, unshadowed(light, directions), atol=1e-13)


def test_the_difference_is_that_of_the_two_and_its_figure_is_shown(plane_tab, pages):
    plane_tab.page.click("#modes input[value=difference]")
    plane_tab.settled()
    full, packed = (in_python(pages / "plane", name, np.eye(3)) for name in ("model.onnx", "compressed.onnx"))
    relative = np.sqrt(np.square(packed - full).sum() / np.square(full).sum())
    assert plane_tab.ask("return it.relative;") == pytest.approx(relative, rel=1e-3)
    assert f"{100 * relative:.2g}" in plane_tab.page.inner_text("#statistics")
    shown = plane_tab.ask("return Array.from(it.view.geometry.attributes.radiance.array);")
    unit = 0.1 * np.sqrt(np.square(full).mean())
    expected = np.sqrt(np.square(packed - full).mean(1)) / unit
    np.testing.assert_allclose(np.reshape(shown, (-1, 3)), np.repeat(expected[:, None], 3, 1), atol=1e-3)
    assert plane_tab.page.is_visible("#legend")


def test_bands_and_exposure_do_what_their_sliders_say(plane_tab, plane):
    light = torch.tensor(plane_tab.ask("return Array.from(it.light.coefficients);")).reshape(-1, 3)
    for order in (1, 3):
        plane_tab.page.locator("#order").fill(str(order))
        light_below = torch.where((torch.arange(16) < order**2)[:, None], light, 0.0)
        near(plane_tab.radiance(), shader(plane)(light_below).numpy(), PACKED)
    bright = plane_tab.ask("return it.exposure;")
    plane_tab.page.locator("#exposure").fill("1.5")
    assert plane_tab.ask("return it.exposure;") == pytest.approx(bright + 1.5)


@pytest.fixture
def damaged(pages, tmp_path):
    """`damaged(name, change)`: a page with one file changed, or away."""

    def damaged(name, content):
        folder = tmp_path / "page"
        shutil.copytree(pages / "plane", folder)
        (folder / name).unlink()
        if content is not None:
            (folder / name).write_bytes(content)
        return tmp_path

    return damaged


MISSING, DAMAGED = "A file is missing on the server", "A file of this page is damaged"


@pytest.mark.parametrize(
    ("name", "content", "title", "words"),
    [
        ("model.onnx.gz", b"\x08\x07 no graph", "The model cannot be run", "ONNX Runtime cannot read model.onnx.gz"),
        ("model.onnx.gz", b"", "The model cannot be run", "ONNX Runtime cannot read model.onnx.gz"),
        ("model.onnx.gz", b"\x1f\x8b\x08", DAMAGED, "model.onnx.gz is damaged"),
        ("model.onnx.gz", None, MISSING, "model.onnx.gz could not be loaded (404"),
        ("mesh.glb", b"glTF", DAMAGED, "mesh.glb could not be read as a mesh"),
        ("mesh.glb", None, MISSING, "mesh.glb could not be loaded (404"),
        ("scene.json", None, MISSING, "scene.json could not be loaded (404"),
        ("scene.json", b"{", DAMAGED, "scene.json is no JSON"),
        ("environments/1.jpg", None, MISSING, "environments/1.jpg could not be loaded (404"),
        ("environments/1.jpg", b"no picture", DAMAGED, "environments/1.jpg is no picture"),
        ("libraries/ort.wasm.wasm.gz", b"\x1f\x8b\x08", DAMAGED, "ort.wasm.wasm.gz is damaged"),
        ("libraries/ort.wasm.bundle.min.mjs", None, "A file could not be loaded", "ort.wasm.bundle.min.mjs"),
        ("libraries/three.core.min.js", None, "This page is not complete", "app.js, or a module that it imports"),
        ("app.js", b"import {", "This page is not complete", "app.js"),
    ],
)
def test_a_page_with_a_broken_file_says_which_and_what_to_do(visit, damaged, name, content, title, words):
    with at(damaged(name, content)) as root:
        tab = visit()
        tab.page.goto(f"{root}/page/")
        tab.page.wait_for_selector("#message:not([hidden])", timeout=20_000)
        said = tab.page.inner_text("#message")
    assert said.startswith(title)
    assert words in said
    assert "torchprt export --web" in said
    assert not tab.page.is_visible("#loading")
    assert not tab.page.is_visible("#controls")


WITHOUT = {
    "WebGL": "HTMLCanvasElement.prototype.getContext = () => null;",
    "WebAssembly": "delete window.WebAssembly;",
    "SIMD": "WebAssembly.validate = () => false;",
    "gzip": "delete window.DecompressionStream;",
    "import maps": "HTMLScriptElement.supports = undefined;",
}


@pytest.mark.parametrize(
    ("lacks", "title"),
    [
        ("WebGL", "This browser shows no WebGL 2"),
        ("WebAssembly", "This browser runs no WebAssembly"),
        ("SIMD", "This browser is too old"),
        ("gzip", "This browser is too old"),
        ("import maps", "This browser is too old"),
    ],
)
def test_a_browser_that_lacks_something_is_to_be_changed_and_the_page_is_not(visit, address, lacks, title):
    tab = visit()
    tab.page.add_init_script(WITHOUT[lacks])
    tab.page.goto(f"{address}/plane/")
    tab.page.wait_for_selector("#message:not([hidden])", timeout=20_000)
    said = tab.page.inner_text("#message")
    assert said.startswith(title)
    assert "Use a current Firefox, Chrome, Edge or Safari" in said
    assert "torchprt" not in said


def test_the_check_for_simd_lets_a_browser_pass_that_has_it(visit, address):
    """The bytes are a module: one that is not would turn every browser away."""
    tab = visit().open(f"{address}/plane/")
    tab.ask('(await import("./faults.js")).checkBrowser();')


@pytest.mark.parametrize(
    ("status", "title", "words"),
    [
        (403, "The server does not give out a file", "permissions"),
        (503, "The server has failed", "in a while"),
        (None, "The server does not answer", "connection"),
    ],
)
def test_what_the_server_answers_is_told_apart(visit, address, status, title, words):
    tab = visit()
    answer = (lambda route: route.abort()) if status is None else (lambda route: route.fulfill(status=status, body=""))
    tab.page.route("**/mesh.glb", answer)
    tab.page.goto(f"{address}/plane/")
    tab.page.wait_for_selector("#message:not([hidden])", timeout=20_000)
    said = tab.page.inner_text("#message")
    assert said.startswith(title)
    assert words in said
    assert "torchprt export" not in said


def test_too_little_memory_is_no_damage(visit, address):
    tab = visit()
    tab.page.add_init_script(
        "Response.prototype.arrayBuffer = () => Promise.reject(new RangeError('Array buffer allocation failed'));"
    )
    tab.page.goto(f"{address}/plane/")
    tab.page.wait_for_selector("#message:not([hidden])", timeout=20_000)
    said = tab.page.inner_text("#message")
    assert said.startswith("There is not enough memory for this model")
    assert "torchprt compress" in said


def test_a_graphics_card_that_is_lost_is_told(plane_tab):
    plane_tab.ask('it.view.renderer.getContext().getExtension("WEBGL_lose_context").loseContext();')
    plane_tab.page.wait_for_selector("#message:not([hidden])")
    assert "Load this page again" in plane_tab.page.inner_text("#message")


def test_without_scripts_it_says_so(browser, address):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(f"{address}/plane/")
    assert "This page needs JavaScript" in page.inner_text("main")
    assert not page.is_visible("#loading")
    assert not page.is_visible("#controls")
    context.close()


def test_a_model_of_another_mesh_is_refused(visit, pages, tmp_path):
    shutil.copytree(pages / "plane", tmp_path / "page")
    shutil.copyfile(pages / "dish" / "mesh.glb", tmp_path / "page" / "mesh.glb")
    with at(tmp_path) as root:
        tab = visit()
        tab.page.goto(f"{root}/page/")
        tab.page.wait_for_selector("#message:not([hidden])", timeout=20_000)
        assert "vertices where the model shades" in tab.page.inner_text("#message")


def test_opened_from_the_disk_it_asks_for_a_server(visit, pages):
    tab = visit()
    tab.page.goto((pages / "plane" / "index.html").as_uri())
    tab.page.wait_for_selector("#message:not([hidden])", timeout=20_000)
    assert "torchprt serve" in tab.page.inner_text("#message")


def test_transfer_in_a_glb_reaches_three_js_under_small_letters(visit, address, pages, plane):
    from torchprt.preview import save_transfer_glb

    save_transfer_glb(plane, pages / "plane" / "prt.glb", 3)
    tab = visit().open(f"{address}/plane/")
    names, first = tab.ask("""
        const { GLTFLoader } = await import("./libraries/loaders/GLTFLoader.js");
        const { scene } = await new GLTFLoader().loadAsync("prt.glb");
        const { attributes } = scene.children[0].geometry;
        return [Object.keys(attributes), Array.from(attributes._prt_1.array.slice(0, 4))];
    """)
    assert {"_prt_0", "_prt_1", "_prt_2"} <= set(names)
    np.testing.assert_array_equal(np.float32(first), stored(plane)[0, 4:8, 0])

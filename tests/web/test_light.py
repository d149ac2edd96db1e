"""Does the browser make of an image, a light and radiance what Python makes of them?"""

import io
import json
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
import PIL.Image
import pytest
import torch
from web.conftest import Visit, at

from torchprt import light, sh
from torchprt.light import WINDOWS, built_in, windowed
from torchprt.preview.environment import automatic_exposure
from torchprt.shade.display import TONES, display

SINGLE = 1e-6


@pytest.fixture(scope="module")
def tab(pages, browser):
    with at(pages.parent) as root:
        page = browser.new_page(viewport={"width": 900, "height": 700})
        yield Visit(page).open(f"{root}/some%20where/plane/")
        page.close()


@pytest.fixture
def opened(tab, tmp_path):
    """`opened(name, bytes)`: opens such a file in the page; the number of lights before, and what was said."""

    def opened(name, content):
        (tmp_path / name).write_bytes(content)
        before = tab.ask("return it.about.environments.length;")
        tab.page.set_input_files("#file", str(tmp_path / name))
        tab.page.wait_for_function("() => !document.getElementById('note').textContent.startsWith('reading')")
        return before, tab.page.inner_text("#note") if tab.page.is_visible("#note") else ""

    return opened


def last(tab):
    """Coefficients, exposure and lamp of the light that was opened last."""
    coefficients, exposure, lamp = tab.ask(
        "const last = it.about.environments.at(-1); return [Array.from(last.coefficients), last.exposure, last.lamp];"
    )
    return np.reshape(coefficients, (-1, 3)), exposure, lamp


def check_light(tab, path, order=4):
    """The light that was opened last is what Python makes of the file."""
    wanted = light.project(light.read(path), order)
    found, exposure, lamp = last(tab)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * float(wanted.abs().max()))
    assert exposure == pytest.approx(automatic_exposure(wanted), abs=1e-4)
    direction, colour = light.dominant(wanted.double())
    np.testing.assert_allclose(lamp["direction"], direction, atol=1e-5)
    np.testing.assert_allclose(lamp["colour"], colour, rtol=1e-4, atol=1e-6)


def image(height=24):
    """A sky with a small sun, and an odd wave of colours."""
    picture = built_in("sunset", height)
    wave = torch.linspace(0, 9, 2 * height).sin()[None, :, None] * torch.tensor([0.3, -0.2, 0.1])
    return (picture * (1 + wave)).numpy().astype(np.float32)


def exr(pixels, **header):
    channels = {name: np.ascontiguousarray(pixels[..., index]) for index, name in enumerate("RGB")}
    with (
        tempfile.TemporaryDirectory() as folder,
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, **header}, channels) as file,
    ):
        file.write(f"{folder}/x.exr")
        return (Path(folder) / "x.exr").read_bytes()


def rgbe(pixels, header=b"", runs=False):
    """A Radiance picture, flat or with each component of each line as one run after the other."""
    height, width, _ = pixels.shape
    _, exponent = np.frexp(pixels.max(-1))
    mantissa = np.clip(np.floor(np.ldexp(pixels, 8 - exponent[..., None])), 0, 255).astype(np.uint8)
    quads = np.concatenate([mantissa, (exponent + 128).astype(np.uint8)[..., None]], -1)
    start = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n" + header + b"\n-Y %d +X %d\n" % (height, width)
    if not runs:
        return start + quads.tobytes()
    lines = []
    for line in quads:
        lines.append(bytes([2, 2, width >> 8, width & 255]))
        for component in line.T:
            for first in range(0, width, 100):
                part = component[first : first + 100]
                same = bool((part == part[0]).all())
                lines.append(bytes([128 + len(part), part[0]]) if same else bytes([len(part), *part]))
    return start + b"".join(lines)


def test_openexr_and_radiance_files_become_the_light_that_python_makes_of_them(tab, opened, tmp_path):
    pixels = image()
    for name, content in (
        ("half.exr", exr(pixels.astype(np.float16))),
        ("full.exr", exr(pixels)),
        ("flat.hdr", rgbe(pixels)),
        ("runs.hdr", rgbe(pixels, b"EXPOSURE=2.5\n", runs=True)),
    ):
        before, said = opened(name, content)
        assert tab.ask("return [it.about.environments.length, it.environment];") == [before + 1, before], said
        check_light(tab, tmp_path / name)
    assert tab.page.locator("#environments label").count() == before + 1
    assert tab.page.locator("#environments input:checked").get_attribute("value") == str(before)
    assert tab.ask("return it.pictures.at(-1).width;") == 48


def test_pictures_are_read_as_srgb(tab, opened, tmp_path):
    values = (255 * display(torch.from_numpy(image(20)))).round().byte().numpy()
    for name, options in (("sky.png", {}), ("sky.webp", {"lossless": True})):
        made = io.BytesIO()
        PIL.Image.fromarray(values).save(made, name.split(".")[1], **options)
        opened(name, made.getvalue())
        check_light(tab, tmp_path / name)


def test_files_that_are_no_environments_are_told_and_change_nothing(tab, opened):
    pixels = image()
    broken = pixels.copy()
    broken[3, 4, 1] = np.nan
    deep = io.BytesIO()
    PIL.Image.fromarray(np.zeros((8, 16), np.uint16)).save(deep, "png")
    whole = exr(pixels)
    for name, content, words in (
        ("square.hdr", rgbe(pixels[:, :24]), "is 24 x 24 pixels"),
        ("cut.hdr", rgbe(pixels)[:-40], "is truncated"),
        ("cut-runs.hdr", rgbe(pixels, runs=True)[:-40], "is truncated"),
        ("cut.exr", whole[: len(whole) // 2], "is damaged"),
        ("nan.exr", exr(broken), "1 value that is not finite"),
        ("empty.png", b"", "is empty"),
        ("words.jpg", b"no picture at all", "no image that this browser reads"),
        ("xyz.hdr", rgbe(pixels).replace(b"_rgbe", b"_xyze"), "has pixels of format 32-bit_rle_xyze"),
    ):
        before, said = opened(name, content)
        assert name in said
        assert words in said
        assert tab.ask("return it.about.environments.length;") == before


def test_negative_values_are_set_to_zero_and_told(tab, opened, tmp_path):
    pixels = image()
    pixels[5, 5, 0] = -2
    _, said = opened("negative.exr", exr(pixels))
    assert "1 value was negative, down to -2.00" in said
    with pytest.warns(light.DamagedImageWarning):
        check_light(tab, tmp_path / "negative.exr")


def test_a_file_that_is_dropped_is_opened_too(tab):
    pixels = rgbe(image())
    before = tab.ask("return it.about.environments.length;")
    tab.ask(f"""
        const data = new DataTransfer();
        data.items.add(new File([Uint8Array.from({json.dumps(list(pixels))})], "dropped.hdr"));
        dispatchEvent(new DragEvent("dragenter", {{ dataTransfer: data, cancelable: true }}));
        if (document.getElementById("drop").hidden) throw new Error("nothing says where to drop");
        dispatchEvent(new DragEvent("drop", {{ dataTransfer: data, cancelable: true }}));
    """)
    tab.page.wait_for_function(f"() => window.torchprt.about.environments.length === {before + 1}")
    assert not tab.page.is_visible("#drop")
    assert tab.ask("return it.light.name;") == "dropped"


@pytest.mark.parametrize("order", [1, 2, 5, 7])
def test_projection_is_that_of_python(tab, order):
    pixels = torch.rand(9, 18, 3, generator=torch.Generator().manual_seed(order)).double()
    found = tab.ask(f"""
        const {{ project }} = await import("./project.js");
        const data = Float64Array.from({pixels.flatten().tolist()});
        return Array.from(project({{ data, width: 18, height: 9 }}, {order}));
    """)
    np.testing.assert_allclose(np.reshape(found, (-1, 3)), light.project(pixels, order), atol=1e-12)


@pytest.mark.parametrize("order", [1, 3, 5])
@pytest.mark.parametrize("name", WINDOWS)
def test_windows_are_those_of_the_window(tab, order, name):
    lamp = light.project(built_in("three-point", 32), order).double()
    found = tab.ask(f"""
        const {{ windowed, WINDOWS }} = await import("./windows.js");
        return [WINDOWS, Array.from(windowed(Float64Array.from({lamp.flatten().tolist()}), {order}, "{name}"))];
    """)
    assert found[0] == list(WINDOWS)
    wanted = windowed(lamp, name)
    np.testing.assert_allclose(np.reshape(found[1], (-1, 3)), wanted, atol=SINGLE * float(wanted.abs().max()))


def test_a_light_that_is_positive_already_keeps_its_bands(tab):
    sky = torch.tensor([[3.0, 3.0, 3.0], [-0.5, 0.2, 0.0], [0.1, 0.0, 0.3], [0.0, 0.4, 0.4]])
    assert float(sh.least_window(sky)[1].min()) == 1
    found = tab.ask(f"""
        const {{ leastWindow }} = await import("./windows.js");
        return leastWindow(Float32Array.from({sky.flatten().tolist()}), 2);
    """)
    assert found == [1, 1]


def test_no_window_mends_a_negative_mean(tab):
    said = tab.ask("""
        const { leastWindow } = await import("./windows.js");
        try { leastWindow(Float32Array.of(-1, 1, 1), 1); } catch (fault) { return fault.message; }
    """)
    assert "negative" in said


def test_the_window_that_is_chosen_is_put_over_the_light(tab):
    tab.page.locator("#environments input").first.check()
    plain = np.reshape(tab.ask("return Array.from(it.light.coefficients);"), (-1, 3))
    tab.page.select_option("#window", "hann")
    tab.page.locator("#order").fill("3")
    shining = np.reshape(tab.ask("await it.change(); return Array.from(it.shining);"), (-1, 3))
    wanted = windowed(torch.from_numpy(plain[:9]), "hann")
    np.testing.assert_allclose(shining[:9], wanted, atol=SINGLE)
    np.testing.assert_array_equal(shining[9:], 0)
    tab.page.select_option("#window", "none")
    tab.page.locator("#order").fill("4")


@pytest.mark.parametrize("tone", TONES)
def test_tone_maps_are_those_of_python_in_javascript_and_on_the_graphics_card(tab, tone):
    generator = torch.Generator().manual_seed(2)
    radiance = 2 ** (12 * torch.rand(64, 3, generator=generator) - 8)
    radiance[:3] = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-0.5, 0.02, 300.0]])
    wanted = display(radiance, exposure=-0.5, tone=tone)
    values = radiance.flatten().tolist()
    shown, drawn = tab.ask(f"""
        const {{ display, DISPLAY, TONES }} = await import("./display.js");
        const THREE = await import("three");
        const values = {values};
        const shown = [];
        for (let i = 0; i < values.length; i += 3) shown.push(display(values.slice(i, i + 3), -0.5, "{tone}"));
        const data = new Float32Array(4 * shown.length);
        values.forEach((value, i) => (data[4 * Math.floor(i / 3) + (i % 3)] = value));
        const texture = new THREE.DataTexture(data, shown.length, 1, THREE.RGBAFormat, THREE.FloatType);
        texture.needsUpdate = true;
        const target = new THREE.WebGLRenderTarget(shown.length, 1, {{ type: THREE.FloatType }});
        const material = new THREE.ShaderMaterial({{
          uniforms: {{ values: {{ value: texture }}, tone: {{ value: TONES.indexOf("{tone}") }} }},
          vertexShader: "void main() {{ gl_Position = vec4(position, 1.0); }}",
          fragmentShader: `uniform sampler2D values; uniform int tone;
            ${{DISPLAY}}
            void main() {{
              vec3 radiance = texelFetch(values, ivec2(gl_FragCoord.xy), 0).rgb;
              gl_FragColor = vec4(srgb(toned(radiance * exp2(-0.5), tone)), 1.0);
            }}`,
        }});
        const quad = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
        const {{ renderer }} = it.view;
        renderer.setRenderTarget(target);
        renderer.render(quad, new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1));
        const drawn = new Float32Array(4 * shown.length);
        renderer.readRenderTargetPixels(target, 0, 0, shown.length, 1, drawn);
        renderer.setRenderTarget(null);
        return [shown, Array.from(drawn)];
    """)
    np.testing.assert_allclose(shown, wanted, atol=1e-5)
    np.testing.assert_allclose(np.reshape(drawn, (-1, 4))[:, :3], wanted, atol=2e-4)

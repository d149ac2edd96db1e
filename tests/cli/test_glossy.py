"""Do the verbs do with glossy surfaces what they promise, and refuse what makes no sense, in one sentence?"""

import math

import numpy as np
import onnxruntime
import pytest
import torch
import trimesh
from environments import lamp, save_exr
from transfers import gloss, stored

from torchprt import shader
from torchprt.brdf import parse
from torchprt.preview import frame
from torchprt.transfer import load

EPSILON = np.finfo(np.float32).eps
NO_FACTORS = ("0", "-1", "2.5", "nan", "some", "", "²")


@pytest.fixture(scope="session")
def glossy(tmp_path_factory):
    """Files that no test changes: a ball, a floor, bakes of every kind, and a light of order 3."""
    from torchprt import bake
    from torchprt import load as load_scene
    from torchprt.light import disc, write_coefficients
    from torchprt.transfer import save

    made = tmp_path_factory.mktemp("glossy")
    trimesh.creation.icosphere(subdivisions=2).export(made / "ball.ply")
    scene = load_scene(made / "ball.ply", material="phong:4")
    wanted = {
        "exit": {},
        "factored": {"factors": 3},
        "incident": {"frame": "incident"},
        "visibility": {"frame": "visibility"},
    }
    for name, options in wanted.items():
        transfer = bake(scene, order=3, rays=64, threads=1, progress=False, **options)
        save(transfer, made / f"{name}.safetensors")
    diffuse = bake(load_scene(made / "ball.ply"), order=3, rays=64, threads=1, progress=False)
    save(diffuse, made / "diffuse.safetensors")
    write_coefficients(disc((1.0, 0.0, 0.0), 0.5, 1.0, 3).float(), made / "light.npy")
    return made


@pytest.fixture
def baked(done, glossy, tmp_path):
    """The transfer that `bake` with these options leaves, and what the command said."""

    def baked(*options, order=3):
        output = tmp_path / "a.safetensors"
        said = done("bake", glossy / "ball.ply", "-o", output, "--order", order, "--rays", 16, *options)
        return load(output), said

    return baked


# What is refused


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--material", "velvet:3"], ["material 'velvet:3'", "phong:40"]),
        (["--material", "phong"], ["material 'phong'", "phong:40"]),
        (["--material", "phong:"], ["material 'phong:'"]),
        (["--material", "phong:-4"], ["material 'phong:-4'"]),
        (["--material", ""], ["material ''"]),
        (["--material", "none.toml"], ["none.toml", "does not exist"]),
        (["--material", "membrane:2"], ["material 'membrane:2'"]),
        (["--material", "lambert", "--albedo", "0.5"], ["gives back"]),
        (["--specular", "0.5"], ["--specular", "--material"]),
        (["--material", "phong:4", "--specular", "1.5"], ["specular"]),
        (["--material", "phong:4", "--specular", "1,1"], ["--specular is '1,1'", "r,g,b"]),
        (["--material", "phong:4", "--specular", "vertex"], ["--specular is 'vertex'"]),
        (["--material", "phong:4", "--frame", "entrance"], ["--frame is 'entrance'", "incident"]),
        (["--material", "phong:4", "--projection", "best"], ["--projection is 'best'", "optimal"]),
        *((["--material", "phong:4", "--factors", text], [f"--factors is '{text}'"]) for text in NO_FACTORS),
        (["--material", "phong:4", "--factors", "3", "--frame", "incident"], ["factors"]),
        (["--material", "phong:4", "--frame", "visibility", "--bounces", "1"], ["bounces"]),
        (["--frame", "incident"], ["glossy", "the scene has none"]),
        (["--output-order", "4"], ["glossy", "the scene has none"]),
        (["--factors", "3"], ["glossy", "the scene has none"]),
    ],
)
def test_a_gloss_that_cannot_be_baked(options, words, refused, glossy, tmp_path):
    arguments = ["bake", glossy / "ball.ply", "-o", tmp_path / "a.safetensors", "--order", "3", *options]
    refused(*words, arguments=arguments)


@pytest.mark.parametrize("option", ["--output-order", "--visibility-order"])
@pytest.mark.parametrize("text", ["0", "33", "x"])
def test_orders_out_of_range(option, text, misused, glossy, tmp_path):
    arguments = ["bake", glossy / "ball.ply", "-o", tmp_path / "a.safetensors", "--material", "phong:4", option, text]
    misused(option, arguments=arguments)


@pytest.mark.parametrize("suffix", [".npy", ".ply"])
@pytest.mark.parametrize("name", ["exit", "factored", "visibility"])
def test_numbers_without_an_eye(name, suffix, refused, glossy, tmp_path):
    arguments = [
        "shade",
        glossy / f"{name}.safetensors",
        "--light",
        glossy / "light.npy",
        "-o",
        tmp_path / f"a{suffix}",
    ]
    refused("--eye", "--toward", arguments=[*arguments, "-o", tmp_path / f"a{suffix}"])


@pytest.mark.parametrize("suffix", [".npy", ".png"])
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--eye", "1,2"], ["--eye is '1,2'"]),
        (["--eye", "a,b,c"], ["--eye is 'a,b,c'"]),
        (["--eye", "inf,0,0"], ["--eye is 'inf,0,0'"]),
        (["--toward", "0,0,0"], ["--toward is '0,0,0'"]),
        (["--toward", "nan,0,1"], ["--toward is 'nan,0,1'"]),
        (["--eye", "1,2,3", "--toward", "1,2,3"], ["--eye and --toward"]),
        (["--eye", "1,2,3", "--material", "phong:9"], ["--material", "baked in"]),
    ],
)
def test_eyes_and_materials_that_make_no_sense(options, words, suffix, refused, glossy, tmp_path):
    arguments = ["shade", glossy / "exit.safetensors", "--light", glossy / "light.npy", "-o", tmp_path / f"a{suffix}"]
    refused(*words, arguments=[*arguments, *options])


@pytest.mark.parametrize("options", [["--eye", "1,2,3"], ["--toward", "1,2,3"]])
def test_diffuse_transfer_has_no_eye(options, refused, glossy, tmp_path):
    arguments = ["shade", glossy / "diffuse.safetensors", "--light", glossy / "light.npy", "-o", tmp_path / "a.npy"]
    refused("--eye and --toward are for glossy transfer", arguments=[*arguments, *options])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], ["incident", "--material"]),
        (["--material", "velvet:3"], ["velvet:3"]),
        (["--material", "membrane:0.5"], ["--material is 'membrane:0.5'", "no gloss"]),
    ],
)
def test_an_open_reflectance_that_nothing_closes(options, words, refused, glossy, tmp_path):
    arguments = ["shade", glossy / "incident.safetensors", "--light", glossy / "light.npy", "--eye", "0,0,3"]
    refused(*words, arguments=[*arguments, "-o", tmp_path / "a.npy", *options])
    refused(*words, arguments=["export", glossy / "incident.safetensors", "-o", tmp_path / "a.onnx", *options])


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("exit", ["--eye", "camera"], ["--eye is 'camera'", "direction"]),
        ("exit", ["--fix-eye", "1,2"], ["--fix-eye is '1,2'"]),
        ("exit", ["--eye", "direction", "--fix-eye", "0,0,0"], ["--fix-eye is '0,0,0'"]),
        ("exit", ["--fix-light", "none.npy"], ["none.npy", "does not exist"]),
        ("exit", ["--material", "phong:9"], ["--material", "baked in"]),
        ("diffuse", ["--eye", "point"], ["--eye", "looks the same"]),
        ("diffuse", ["--fix-eye", "1,2,3"], ["--fix-eye", "looks the same"]),
        ("diffuse", ["--fix-light", "none.npy"], ["--fix-light", "looks the same"]),
    ],
)
def test_a_graph_that_cannot_be_made(name, options, words, refused, glossy, tmp_path):
    refused(*words, arguments=["export", glossy / f"{name}.safetensors", "-o", tmp_path / "a.onnx", *options])


# What is made


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], ["exit, shadowed, order 3, output order 3 (optimal)", "exit: exit functions of order 3 hold phong:4 to"]),
        (["--bounces", 1], ["exit, interreflected, 1 bounce,"]),
        (["--output-order", 5, "--projection", "reduced"], ["output order 5 (reduced)", "exit functions of order 5"]),
        (["--factors", 3], ["factored, shadowed, order 3, 3 factors", "3 factors hold the material to"]),
        (["--frame", "incident"], ["incident, shadowed, order 3, incident radiance of order 3", "when it is shaded"]),
        (["--frame", "visibility", "--visibility-order", 4], ["visibility order 4, output order 3", "costs"]),
        (["--unshadowed"], ["exit, unshadowed"]),
    ],
)
def test_every_kind_is_baked_and_told_of(options, words, baked, done, tmp_path):
    transfer, said = baked("--material", "phong:4", *options)
    told = done("info", tmp_path / "a.safetensors")
    for word in (*words, "162 vertices (162 glossy)", "materials phong:4, specular 1"):
        assert word in said
        assert word in told
    # Under a gloss the albedo is zero: there is no diffuse layer.
    assert "albedo" not in told
    assert "diffuse" not in transfer.layers
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.safetensors"]


def test_rows_by_their_error_are_as_many_as_it_takes(baked):
    few, many = (baked("--material", "ggx:0.4", "--factors", text)[0] for text in ("0.3", "0.05"))
    assert gloss(few).factor_error <= 0.3
    assert gloss(many).factor_error <= 0.05
    assert len(gloss(few).factors) < len(gloss(many).factors)


def test_albedo_and_specular_are_weights_of_both_layers(baked):
    transfer, said = baked("--material", "phong:4", "--albedo", "0.25", "--specular", "0.5,0.25,0.125")
    torch.testing.assert_close(transfer.albedo, torch.tensor([[0.25]]))
    torch.testing.assert_close(gloss(transfer).specular, torch.tensor([[0.5, 0.25, 0.125]]))
    assert stored(transfer, "diffuse").shape == (1, 9, 162)
    assert "specular 0.5, 0.25, 0.125" in said


def test_without_a_gloss_the_albedo_is_a_half_as_ever(baked, done, tmp_path):
    baked()
    assert "albedo 0.5" in done("info", tmp_path / "a.safetensors")


def test_half_stores_half_the_bytes_of_matrices(baked):
    whole, half = (baked("--material", "phong:4", *options)[0] for options in ([], ["--half"]))
    assert 2 * half.bytes == whole.bytes
    assert stored(half).dtype == torch.float16


def test_a_coarse_order_is_warned_of_in_one_line(run, glossy, tmp_path, monkeypatch):
    # pytest makes errors of warnings; the command does not.
    monkeypatch.setattr("warnings.filters", [])
    arguments = ["bake", glossy / "ball.ply", "-o", tmp_path / "a.safetensors", "--order", 4, "--output-order", 2]
    ended = run(*arguments, "--rays", 16, "--material", "ward:0.2,0.6")
    assert ended.code == 0
    told = [line for line in ended.err.splitlines() if line.startswith("torchprt: ")]
    assert len(told) == 2
    assert "tangents are a smooth field" in told[0]
    assert "output order 2 cannot hold the material ward:0.2,0.6" in told[1]
    assert ".py" not in ended.err


def test_more_light_than_arrives_is_warned_of_in_one_line(run, glossy, tmp_path, monkeypatch):
    monkeypatch.setattr("warnings.filters", [])
    arguments = ["bake", glossy / "ball.ply", "-o", tmp_path / "a.safetensors", "--order", 3, "--rays", 16]
    ended = run(*arguments, "--material", "ggx:0.3,0.04", "--albedo", "0.9")
    assert ended.code == 0
    told = [line for line in ended.err.splitlines() if "as bright as a uniform light" in line]
    assert len(told) == 1
    assert "albedo up to 0.9" in told[0]


# What is shaded


@pytest.mark.parametrize("name", ["exit", "factored", "visibility"])
@pytest.mark.parametrize(("option", "keyword"), [("--eye", "eye"), ("--toward", "view")])
def test_numbers_are_those_of_the_shader(name, option, keyword, done, glossy, tmp_path):
    transfer = load(glossy / f"{name}.safetensors")
    arguments = ["shade", glossy / f"{name}.safetensors", "--light", glossy / "light.npy", "-o", tmp_path / "a.npy"]
    done(*arguments, option, "1.5,0.5,2")
    found = np.load(tmp_path / "a.npy")
    light = torch.from_numpy(np.load(glossy / "light.npy"))
    wanted = shader(transfer)(light, **{keyword: torch.tensor([1.5, 0.5, 2.0], dtype=torch.float64)})
    # The command turns the light by nothing, through a quadrature: some tens of epsilon.
    np.testing.assert_allclose(found, wanted.numpy(), rtol=0, atol=64 * EPSILON * float(wanted.abs().max()))


def test_numbers_of_transferred_radiance_are_those_of_its_material(done, glossy, tmp_path):
    transfer = load(glossy / "incident.safetensors")
    arguments = ["shade", glossy / "incident.safetensors", "--light", glossy / "light.npy", "-o", tmp_path / "a.npy"]
    said = done(*arguments, "--toward", "1,0,1", "--material", "phong:9")
    assert "exit functions of order 3 hold phong:9 to" in said
    light = torch.from_numpy(np.load(glossy / "light.npy"))
    wanted = shader(transfer, brdf=parse("phong:9"))(light, view=torch.tensor([1.0, 0.0, 1.0]))
    found = np.load(tmp_path / "a.npy")
    np.testing.assert_allclose(found, wanted.numpy(), rtol=0, atol=64 * EPSILON * float(wanted.abs().max()))


@pytest.mark.parametrize("eye", [(3.0, 0.0, 4.0), (4.0, 0.0, -3.0), (0.0, 5.0, 0.0)])
def test_a_highlight_lies_between_lamp_and_eye(eye, done, glossy, tmp_path):
    light = save_exr(tmp_path / "a.exr", lamp((1.0, 0.0, 0.0)))
    arguments = ["shade", glossy / "exit.safetensors", "--light", light, "-o", tmp_path / "a.npy"]
    done(*arguments, "--toward", ",".join(map(str, eye)))
    radiance = np.load(tmp_path / "a.npy")[:, 0]
    middle = np.array([1.0, 0.0, 0.0]) + np.array(eye) / np.linalg.norm(eye)
    # The lobe of phong:4 is broad and counts the cosine too: its top lies up to a third of the way off, and the
    # vertices of this ball are 18 degrees apart.
    vertices = trimesh.load(glossy / "ball.ply", process=False).vertices
    assert vertices[radiance.argmax()] @ middle / np.linalg.norm(middle) > math.cos(math.radians(27))


def test_a_picture_is_seen_by_its_own_camera_and_says_so(done, glossy, tmp_path):
    arguments = ["shade", glossy / "exit.safetensors", "--light", glossy / "light.npy", "--size", "40x30"]
    said = done(*arguments, "-o", tmp_path / "own.png", "--view", "1,0.5,2")
    camera = frame(load(glossy / "exit.safetensors").positions, (1.0, 0.5, 2.0), aspect=40 / 30)
    assert "seen by the camera of the picture, from ({:.3g}, {:.3g}, {:.3g})".format(*camera.eye) in said
    eye = ",".join(map(repr, camera.eye))
    said = done(*arguments, "-o", tmp_path / "given.png", "--view", "1,0.5,2", "--eye", eye)
    assert "seen by" not in said
    done(*arguments, "-o", tmp_path / "other.png", "--view", "1,0.5,2", "--eye", "0,5,0")
    own, given, other = ((tmp_path / f"{name}.png").read_bytes() for name in ("own", "given", "other"))
    assert own == given
    assert own != other


# What is exported


@pytest.mark.parametrize(
    ("name", "options", "inputs"),
    [
        ("exit", [], ["light", "rotation", "eye"]),
        ("exit", ["--fix-eye", "1,0,3"], ["light", "rotation"]),
        ("exit", ["--fix-light", "light.npy"], ["eye"]),
        ("incident", ["--material", "phong:9", "--eye", "direction"], ["light", "rotation", "view"]),
    ],
)
def test_a_graph_takes_what_it_was_asked_to_take(name, options, inputs, done, glossy, tmp_path, untyped):
    options = [glossy / option if option == "light.npy" else option for option in options]
    said = done("export", glossy / f"{name}.safetensors", "-o", tmp_path / "a.onnx", *options)
    assert "same:" in said
    session = onnxruntime.InferenceSession(tmp_path / "a.onnx", providers=["CPUExecutionProvider"])
    assert [entry.name for entry in session.get_inputs()] == inputs
    given = {
        "light": np.load(glossy / "light.npy")[None],
        "rotation": np.eye(3, dtype=np.float32)[None],
        "eye": np.array([[1, 0, 3]], np.float32),
        "view": np.array([[1, 0, 3]], np.float32),
    }
    (found,) = session.run(None, {key: given[key] for key in inputs})
    eye = ["--toward" if "direction" in options else "--eye", "1,0,3"]
    material = [str(option) for option in options if option in ("--material", "phong:9")]
    arguments = ["shade", glossy / f"{name}.safetensors", "--light", glossy / "light.npy", "-o", tmp_path / "a.npy"]
    done(*arguments, *eye, *material)
    wanted = np.load(tmp_path / "a.npy")
    # Sums of 81 products, in another order.
    np.testing.assert_allclose(found[0], wanted, rtol=0, atol=128 * EPSILON * np.abs(wanted).max())

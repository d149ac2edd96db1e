"""Does an exported file turn the lobes of a surface with its pose, as they are defined?"""

from fractions import Fraction
from types import SimpleNamespace

import onnx
import onnxruntime
import pytest
import torch
from transfers import gloss, replaced
from zonal_transfers import by_definition, random_zonal, random_zonal_factored, turns

from torchprt import sh
from torchprt.errors import InputError
from torchprt.onnx import compare, describe, export
from torchprt.onnx.graph import ShaderGraph
from torchprt.onnx.hard_cases import random_poses
from torchprt.onnx.operators import ALLOWED
from torchprt.onnx.zonal import leading
from torchprt.shade import shader

pytestmark = pytest.mark.usefixtures("untyped")

EPSILON = torch.finfo(torch.float32).eps
# What each file is made of: low orders are traced faster.
FILES = {
    "frames": ({"order": 4, "lobes": 2}, {"pose": "frames"}),
    "positions": ({"order": 3, "channels": 3, "exact": False, "lobes": 2, "albedo": (1, 3)}, {"pose": "positions"}),
    "point": ({"kind": random_zonal_factored, "order": 3, "lobes": 1}, {}),
    "direction": (
        {"kind": random_zonal_factored, "order": 3, "rows": 1, "lobes": 1, "channels": 3, "glossy": 9, "exact": False},
        {"eye": "direction"},
    ),
    "environment": ({"order": 3, "lobes": 1, "albedo": ("V", 1)}, {"source": "environment", "size": 4}),
}


def run(path, **inputs):
    """Radiance [B, V, 3] in ONNX Runtime; rotation is the identity unless given."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    inputs.setdefault("rotation", torch.eye(3).expand(len(next(iter(inputs.values()))), 3, 3))
    return torch.from_numpy(session.run(["radiance"], {key: value.numpy() for key, value in inputs.items()})[0])


def lights(*batch, order=4, seed=1):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(seed))


def same(found, wanted, order=4):
    # What parity allows: 16 roundings times the order.
    return (found.double() - wanted).abs().max() <= 16 * EPSILON * order * wanted.abs().max()


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A file of each kind with its transfer and report, for the tests that only read it."""
    from jaxtyping import config

    config.update("jaxtyping_disable", True)
    folder, made = tmp_path_factory.mktemp("deformable"), {}
    for name, (options, arguments) in FILES.items():
        lobes = dict(options)
        transfer = lobes.pop("kind", random_zonal)(**lobes, fit_error=0.01)
        path = folder / f"{name}.onnx"
        made[name] = SimpleNamespace(path=path, transfer=transfer, report=export(transfer, path, **arguments))
    config.update("jaxtyping_disable", False)
    return made


# Misuse


@pytest.mark.parametrize(
    ("transfer", "arguments", "message"),
    [
        (random_zonal(), {"pose": "bones"}, "pose 'bones' is unknown: use 'frames' or 'positions'"),
        (random_zonal(), {"eye": "direction"}, "eye is given, but .* 'zonal diffuse' does not depend on the eye"),
        (random_zonal(1), {"pose": "positions"}, "the transfer has no faces, from which frames are estimated"),
        (random_zonal(0), {}, "the transfer has no vertices"),
        (random_zonal(lobes=0, exact=False), {}, "the transfer has no lobes"),
        (random_zonal_factored(), {"pose": "frames"}, "eye is a point and pose is frames"),
        (
            random_zonal_factored(),
            {"fix_eye": [1.0, 2.0, 3.0]},
            r"fix_eye is given, .* zonal factored' takes eye",
        ),
        (random_zonal_factored(), {"exponent": 3.0}, "exponent is given"),
        (random_zonal_factored(glossy=0), {}, "no receiver is glossy"),
    ],
)
def test_refuses_what_cannot_be_exported(tmp_path, transfer, arguments, message):
    with pytest.raises(InputError, match=message):
        export(transfer, tmp_path / "a.onnx", **arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_static_transfer_has_no_pose(make_transfer, tmp_path):
    with pytest.raises(InputError, match="pose is given, but transfer of kind 'diffuse' does not deform"):
        export(make_transfer(), tmp_path / "a.onnx", pose="frames")


def test_refuses_axes_that_are_not_unit_vectors(tmp_path):
    transfer = random_zonal()
    gloss(transfer).signal.axis[0, 0, :, 2] = 0
    with pytest.raises(InputError, match="axis of the transfer holds 1 vectors"):
        export(transfer, tmp_path / "a.onnx")


def test_refuses_more_than_two_gigabytes(tmp_path):
    one = random_zonal(1, order=6)
    count = 20_000_000
    lobes = gloss(one).signal
    large = replaced(
        one,
        axis=lobes.axis.expand(1, 4, 3, count),
        coefficients=lobes.coefficients.expand(1, 1, 4, 4, count),
        exact=lobes.exact.expand(1, 1, 4, count),
        squared_error=lobes.squared_error.expand(count),
        albedo=torch.ones(1, 1),
        positions=one.positions.expand(count, 3),
        normals=one.normals.expand(count, 3),
    )
    with pytest.raises(InputError, match=r"weights are 2\.4 GB"):
        export(large, tmp_path / "a.onnx")


# What is in the file


def test_the_pose_is_the_third_input_and_has_no_batch(written):
    report = written["frames"].report
    assert report.inputs == {"light": ("B", 16, 3), "rotation": ("B", 3, 3), "frames": (9, 3, 3)}
    assert written["positions"].report.inputs["positions"] == (9, 3)
    assert list(written["environment"].report.inputs) == ["environment", "rotation", "frames"]
    assert list(written["point"].report.inputs) == ["light", "rotation", "eye", "positions"]
    assert list(written["direction"].report.inputs) == ["light", "rotation", "view", "frames"]
    for file in written.values():
        assert file.report.outputs == {"radiance": ("B", 9, 3)}
        assert set(file.report.operators) <= ALLOWED
        assert file.report.parity.passed
        assert "one pose" in onnx.load(file.path).graph.input[-1].doc_string


def test_the_file_says_what_it_is(written):
    about = describe(written["positions"].path)
    assert (about["kind"], about["pose"], about["order"], about["fit_error"]) == ("zonal diffuse", "positions", 3, 0.01)
    assert describe(written["frames"].path)["pose"] == "frames"
    about = describe(written["point"].path)
    assert about["kind"] == "zonal diffuse + zonal factored"
    assert (about["pose"], about["eye"], about["glossy"]) == ("positions", "point", 4)


# What it computes


@pytest.mark.parametrize("batch", [1, 2, 5])
def test_all_lights_shine_on_one_pose(written, batch):
    file, light, frames = written["frames"], lights(batch), turns(9)
    found = run(file.path, light=light, frames=frames)
    for one, lamp in zip(found, light, strict=True):
        assert same(one, by_definition(file.transfer, lamp, frames))


def test_the_light_turns_and_the_pose_does_not(written):
    file, light, frames, rotation = written["frames"], lights(3), turns(9), turns(3, seed=8)
    found = run(file.path, light=light, rotation=rotation, frames=frames)
    for one, lamp in zip(found, sh.rotate(light, rotation), strict=True):
        assert same(one, by_definition(file.transfer, lamp, frames))


def test_frames_and_light_turned_together_change_nothing(written):
    file, light, frames, turn = written["frames"], lights(1), turns(9), turns(seed=5)
    still = run(file.path, light=light, frames=frames)
    turned = run(file.path, light=light, rotation=turn[None], frames=turn @ frames)
    assert (turned - still).abs().max() <= 1e-5 * still.abs().max()


def test_positions_give_what_torch_makes_of_them(written):
    file, light = written["positions"], lights(2, order=3)
    module = shader(file.transfer, dtype=torch.float64)
    for pose in random_poses(module, "positions", 3):
        found = run(file.path, light=light, **pose)
        assert same(found, module(light.double(), positions=pose["positions"].double()))


def test_a_collapsed_mesh_has_the_identity_as_in_torch(written):
    file, light = written["positions"], lights(1, order=3)
    module = shader(file.transfer, dtype=torch.float64)
    for posed in (torch.zeros(9, 3), file.transfer.positions * torch.tensor([1.0, 0.0, 0.0])):
        found = run(file.path, light=light, positions=posed)
        assert same(found, module(light.double(), positions=posed.double()))


@pytest.mark.parametrize("name", ["point", "direction"])
def test_glossy_surfaces_show_each_eye_what_torch_shows_it(written, name):
    file, light = written[name], lights(3, order=3)
    module = shader(file.transfer, dtype=torch.float64)
    seen, pose = list(file.report.inputs)[2:]
    eyes = 3 * torch.randn(3, 3, generator=torch.Generator().manual_seed(5))
    for posed in random_poses(module, pose, 3):
        found = run(file.path, light=light, **{seen: eyes}, **posed)
        inputs = {seen: eyes.double(), pose: posed[pose].double()}
        # Factors of random texels change as fast as functions of order 32.
        assert same(found, module(light.double(), **inputs), 32)


def test_environments_are_projected_first(written):
    file, frames = written["environment"], turns(9)
    environment = torch.rand(2, 6, 4, 4, 3, generator=torch.Generator().manual_seed(0))
    found = run(file.path, environment=environment, frames=frames)
    for one, lamp in zip(found, sh.project_cube(environment, 3), strict=True):
        assert same(one, by_definition(file.transfer, lamp, frames))


def test_another_transfer_does_not_pass_for_it(written):
    file = written["frames"]
    assert compare(file.path, shader(file.transfer), batches=(2,)).passed
    assert not compare(file.path, shader(random_zonal(seed=9)), batches=(2,)).passed


def test_refuses_to_compare_with_a_static_shader(written, make_transfer):
    with pytest.raises(InputError, match="takes light, rotation, frames but the module takes light, rotation"):
        compare(written["frames"].path, shader(make_transfer()))


# The graph, without the exporter


@pytest.mark.parametrize(
    ("order", "exact"), [(1, False), (2, False), (2, True), (3, False), (3, True), (6, False), (6, True), (16, True)]
)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("albedo", [("V", 3), ("V", 1), (1, 3), (1, 1)])
def test_the_graph_is_the_sum_of_lobes(order, exact, channels, albedo):
    transfer = random_zonal(2, lobes=2, order=order, channels=channels, exact=exact, albedo=albedo)
    graph = ShaderGraph(shader(transfer), "light", 4, "point", "frames")
    light, frames = lights(1, order=order), turns(4)
    found = graph(light, torch.eye(3)[None], pose=frames)[0]
    assert same(found, by_definition(transfer, light[0], frames), order)


@pytest.mark.parametrize("l", [0, 1, 2, 5, 31])
def test_leading_coefficients_are_those_of_the_basis(l):
    # The polynomials that begin with z^(l - m), in exact arithmetic, at one direction.
    for m in range(min(l, 6) + 1):
        polynomials = [[Fraction(1)], [Fraction(0), Fraction(1)]]
        for k in range(m + 2, l + 1):
            beta = Fraction((k - 1) ** 2 - m * m, 4 * (k - 1) ** 2 - 1)
            risen = [Fraction(0), *polynomials[-1]]
            before = polynomials[-2] + [Fraction(0)] * (len(risen) - len(polynomials[-2]))
            polynomials.append([a - beta * b for a, b in zip(risen, before, strict=True)])
        x, y, z = 0.48, 0.6, 0.64
        value = float(sum(c * Fraction(z) ** k for k, c in enumerate(polynomials[l - m])))
        power = complex(x, y) ** m
        values = sh.basis(torch.tensor([x, y, z], dtype=torch.float64), l + 1)
        assert abs(leading(l, m) * value * power.real - float(values[l * l + l + m])) < 1e-12
        if m:
            assert abs(leading(l, m) * value * power.imag - float(values[l * l + l - m])) < 1e-12

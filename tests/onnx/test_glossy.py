"""Does an exported file show glossy surfaces to an eye as they are defined?"""

import math
import re
from types import SimpleNamespace

import onnx
import onnxruntime
import pytest
import torch
from contents import contents
from transfers import KINDS, by_definition, frame_of, gloss, random_glossy, replaced, stored

from torchprt import sh
from torchprt.errors import InputError
from torchprt.onnx import compare, describe, export
from torchprt.onnx.hard_cases import conditions, random_eyes, receivers
from torchprt.onnx.operators import ALLOWED
from torchprt.onnx.parity import tolerance
from torchprt.onnx.plan import plan
from torchprt.shade import EnvironmentShader, shader

pytestmark = pytest.mark.usefixtures("untyped")

# Low orders are traced faster. Seven receivers, of which four are glossy: the others must stay as they are.
ORDER = 3
EXPONENTS = torch.tensor([0.0, 3.0, 40.0, 1000.0])


def exponent_of(kind):
    return EXPONENTS if kind == "incident" else None


def run(path, **inputs):
    """Radiance [B, V, 3] in ONNX Runtime; rotation is the identity unless given."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    batch = len(next(iter(inputs.values())))
    if "rotation" in [value.name for value in session.get_inputs()] and "rotation" not in inputs:
        inputs["rotation"] = torch.eye(3).expand(batch, 3, 3)
    return torch.from_numpy(session.run(["radiance"], {key: value.numpy() for key, value in inputs.items()})[0])


def assert_same(found, wanted, allowed):
    # Relative to the largest radiance of each light.
    largest = wanted.abs().amax((1, 2), keepdim=True)
    assert ((found.double() - wanted).abs() <= allowed * largest).all()


def random_lights(count, order, seed=1):
    return torch.randn(count, order**2, 3, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A file of each kind with its transfer and report, for the tests that only read it."""
    from jaxtyping import config

    config.update("jaxtyping_disable", True)
    folder, made = tmp_path_factory.mktemp("glossy"), {}
    for kind in KINDS:
        transfer = random_glossy(kind, glossy=4, order=ORDER, output_order=2, materials=["phong:8"], rays=64)
        path = folder / f"{kind}.onnx"
        made[kind] = SimpleNamespace(
            path=path, transfer=transfer, report=export(transfer, path, exponent=exponent_of(kind))
        )
    config.update("jaxtyping_disable", False)
    return made


@pytest.fixture(params=KINDS)
def file(request, written):
    return written[request.param]


# Misuse


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        ("exit", {"eye": "left"}, "eye 'left' is unknown: use 'point' or 'direction'"),
        ("exit", {"exponent": 4.0}, r"kind 'diffuse \+ exit' has its reflectance baked in"),
        ("incident", {}, r"kind 'diffuse \+ incident' has no reflectance: give exponent"),
        ("incident", {"exponent": -1.0}, "exponent must be finite and zero or more"),
        ("exit", {"fix_eye": [1.0, 2.0]}, "fix_eye must be three finite numbers"),
        ("exit", {"fix_eye": [1.0, 2.0, math.nan]}, "fix_eye must be three finite numbers"),
        ("exit", {"fix_eye": [0.0, 0.0, 0.0], "eye": "direction"}, "view is a zero vector"),
        ("exit", {"fix_light": torch.zeros(9, 3)}, r"fix_light has shape \[9, 3\]: .* \[16, 3\] of order 4"),
        ("exit", {"fix_light": torch.full((16, 3), math.inf)}, "one finite light"),
        ("exit", {"fix_light": torch.zeros(16, 3), "source": "environment"}, "takes no environment"),
        ("exit", {"fix_light": torch.zeros(16, 3), "fix_eye": [1.0, 2.0, 3.0]}, "nothing is left to change"),
    ],
)
def test_refuses_arguments_that_do_not_fit(tmp_path, kind, arguments, message):
    with pytest.raises(InputError, match=message):
        export(random_glossy(kind), tmp_path / "a.onnx", **arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [("eye", "direction"), ("fix_eye", [1.0, 2.0, 3.0]), ("fix_light", torch.zeros(16, 3)), ("exponent", 4.0)],
)
def test_diffuse_transfer_has_neither_eye_nor_lobe(make_transfer, tmp_path, name, value):
    why = "has its reflectance baked in" if name == "exponent" else "does not depend on the eye"
    with pytest.raises(InputError, match=f"{name} is given, but transfer of kind 'diffuse' {why}"):
        export(make_transfer(), tmp_path / "a.onnx", **{name: value})


@pytest.mark.parametrize("name", ["exit.signal.values", "diffuse.signal.values", "exit.tangents"])
def test_refuses_values_that_are_not_finite(tmp_path, name):
    transfer = random_glossy()
    contents(transfer)[name].view(-1)[5] = math.nan
    with pytest.raises(InputError, match=f"'{re.escape(name)}' of the transfer holds 1 NaN"):
        export(transfer, tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []


def large(count):
    """Transfer of order 5 and `count` receivers that takes little memory."""
    one = random_glossy(vertices=1, order=5, output_order=5, diffuse=False, specular=(1, 1), albedo=(1, 1))
    return replaced(
        one,
        values=stored(one).expand(1, count, 25, 25),
        positions=one.positions.expand(count, 3),
        normals=one.normals.expand(count, 3),
        tangents=gloss(one).tangents.expand(count, 3),
        receivers=torch.arange(count),
    )


def test_refuses_more_than_two_gigabytes_before_it_writes(tmp_path):
    with pytest.raises(InputError, match=r"weights are 2\.4 GB, .* fix the eye or the light or split the scene"):
        export(large(1_000_000), tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fixed", [{"fix_eye": [1.0, 2.0, 3.0]}, {"fix_light": torch.zeros(25, 3)}])
def test_what_is_too_large_fits_when_the_eye_or_the_light_is_fixed(fixed):
    rest = {"source": "light", "size": 32, "eye": "point", "fix_eye": None, "fix_light": None, "exponent": None}
    assert plan(large(1_000_000), **rest | fixed).vertices == 1_000_000


# What is in the file


def test_the_inputs_are_a_light_its_rotation_and_an_eye(file):
    assert file.report.inputs == {"light": ("B", ORDER**2, 3), "rotation": ("B", 3, 3), "eye": ("B", 3)}
    assert file.report.outputs == {"radiance": ("B", 7, 3)}
    assert "seen" in onnx.load(file.path).graph.input[2].doc_string


def test_uses_plain_operators_and_holds_its_weights_once(file):
    assert set(file.report.operators) <= ALLOWED
    model = onnx.load(file.path)
    assert all(not tensor.external_data for tensor in model.graph.initializer)
    names = [name for node in model.graph.node for name in node.input]
    assert all(tensor.name in names for tensor in model.graph.initializer)
    if gloss(file.transfer).kind != "visibility":
        size = stored(file.transfer).numel()
        assert [math.prod(tensor.dims) for tensor in model.graph.initializer].count(size) == 1


def test_parity_has_been_checked(file):
    assert file.report.parity.passed
    assert file.report.parity.cases == 96


def test_describes_itself(file):
    about = describe(file.path)
    transfer = file.transfer
    assert (about["kind"], about["order"], about["vertices"], about["glossy"]) == (transfer.kind, ORDER, 7, 4)
    assert (about["eye"], about["fixed"], about["source"], about["rays"]) == ("point", None, "light", 64)
    assert about["materials"] == ["phong:8"]
    assert about["specular"] == "applied, one a receiver"
    assert about["inputs"] == file.report.inputs
    for name in ("projection", "output_order", "degree"):
        assert about.get(name) == getattr(gloss(transfer), name, None)
    assert about.get("exponent") == ("one a receiver" if gloss(transfer).kind == "incident" else None)


# What it computes


def eyes_of(transfer):
    """Near, far, at a glossy receiver, under its tangent plane, in the middle, at a receiver that is not glossy."""
    place, (tangent, _, normal) = transfer.positions[gloss(transfer).receivers[1]], frame_of(transfer, 1).float()
    other = next(v for v in range(transfer.vertices) if v not in gloss(transfer).receivers.tolist())
    rows = [
        torch.tensor([0.3, -0.2, 3.0]),
        torch.tensor([1e4, 2e4, -1e4]),
        place,
        place - normal + 0.5 * tangent,
        transfer.positions.mean(0),
        transfer.positions[other],
    ]
    return torch.stack(rows)


def test_is_what_each_kind_is_defined_as(file):
    transfer, eyes = file.transfer, eyes_of(file.transfer)
    lights = random_lights(len(eyes), ORDER)
    wanted = torch.stack(
        [
            by_definition(transfer, *case, exponent=exponent_of(gloss(transfer).kind))
            for case in zip(lights, eyes, strict=True)
        ]
    )
    module = shader(transfer, exponent=exponent_of(gloss(transfer).kind))
    assert_same(run(file.path, light=lights, eye=eyes), wanted, tolerance(ORDER, module))


def test_turning_the_light_turns_it_in_the_file(file):
    lights, eyes = random_lights(6, ORDER), eyes_of(file.transfer)
    rotation = sh.yaw_pitch_roll(360 * torch.rand(6, 3, generator=torch.Generator().manual_seed(2)))
    wanted = run(file.path, light=sh.rotate(lights.double(), rotation.double()).float(), eye=eyes).double()
    # Both sides are rounded.
    assert_same(run(file.path, light=lights, rotation=rotation, eye=eyes), wanted, 2 * tolerance(ORDER))


def test_any_batch_gives_each_case_what_it_gets_alone(file):
    eyes = torch.randn(17, 3, generator=torch.Generator().manual_seed(3))
    lights = random_lights(17, ORDER)
    whole = run(file.path, light=lights, eye=eyes).double()
    for count in (1, 2, 5):
        # Products of another size are summed in another order.
        assert_same(run(file.path, light=lights[:count], eye=eyes[:count]).double(), whole[:count], tolerance(ORDER))


@pytest.mark.parametrize(
    "arguments",
    [
        {"glossy": None, "channels": 3, "specular": (1, 1), "dtype": torch.bfloat16},
        {"diffuse": False, "glossy": 3, "specular": ("G", 1), "dtype": torch.float64, "projection": "reduced"},
        {"vertices": 1, "order": 1, "output_order": 1, "albedo": (1, 3), "specular": (1, 3)},
    ],
    ids=["three-channels", "no-diffuse", "one-vertex"],
)
def test_every_layout_is_what_it_is_defined_as(tmp_path, arguments):
    transfer = random_glossy(**{"order": 2, "output_order": 2} | arguments)
    assert export(transfer, tmp_path / "a.onnx").parity.passed
    eyes, lights = torch.tensor([[0.1, 4.0, 1.0], [-2.0, 0.3, 0.2]]), random_lights(2, transfer.order)
    # The file holds positions and transfer in float32; the eyes are far enough that it does not matter.
    wanted = torch.stack([by_definition(transfer, *case) for case in zip(lights, eyes, strict=True)])
    found = run(tmp_path / "a.onnx", light=lights, eye=eyes)
    assert_same(found, wanted, tolerance(transfer.order, shader(transfer)))


def test_a_distant_eye_is_a_direction_of_any_length(written, tmp_path):
    transfer = written["exit"].transfer
    report = export(transfer, tmp_path / "a.onnx", eye="direction")
    assert list(report.inputs) == ["light", "rotation", "view"]
    assert report.parity.passed
    assert describe(tmp_path / "a.onnx")["eye"] == "direction"
    lights = random_lights(6, ORDER)
    views = torch.randn(6, 3, generator=torch.Generator().manual_seed(4))
    views[5] = -transfer.normals[gloss(transfer).receivers[0]] + 0.3 * gloss(transfer).tangents[0]
    wanted = torch.stack([by_definition(transfer, light, view=view) for light, view in zip(lights, views, strict=True)])
    for length in (1.0, 1e-30, 1e30):
        assert_same(run(tmp_path / "a.onnx", light=lights, view=views * length), wanted, tolerance(ORDER))


def test_a_receiver_without_a_normal_has_its_diffuse_layer_alone_also_from_cube_maps(tmp_path):
    transfer = random_glossy(order=2, output_order=2)
    transfer.normals[gloss(transfer).receivers[1]] = 0
    report = export(transfer, tmp_path / "a.onnx", source="environment", size=4)
    assert report.inputs == {"environment": ("B", 6, 4, 4, 3), "rotation": ("B", 3, 3), "eye": ("B", 3)}
    assert report.parity.passed
    stored(transfer)[:, 1] = 0
    environment = torch.rand(2, 6, 4, 4, 3, generator=torch.Generator().manual_seed(0))
    eyes = torch.tensor([[0.1, 4.0, 1.0], [-2.0, 0.3, 0.2]])
    lights = sh.project_cube(environment.double(), 2)
    wanted = torch.stack([by_definition(transfer, *case) for case in zip(lights, eyes, strict=True)])
    assert_same(run(tmp_path / "a.onnx", environment=environment, eye=eyes), wanted, tolerance(2))


# One of them fixed


def test_with_the_eye_fixed_it_is_a_diffuse_graph(written, tmp_path):
    transfer, eye = written["visibility"].transfer, torch.tensor([0.3, -0.2, 3.0])
    report = export(transfer, tmp_path / "a.onnx", fix_eye=eye)
    assert list(report.inputs) == ["light", "rotation"]
    assert report.parity.passed
    assert sum(report.operators.values()) < 0.6 * sum(written["visibility"].report.operators.values())
    lights = random_lights(3, ORDER)
    wanted = torch.stack([by_definition(transfer, light, eye) for light in lights])
    assert_same(run(tmp_path / "a.onnx", light=lights), wanted, tolerance(ORDER))
    assert describe(tmp_path / "a.onnx")["fixed"] == {"eye": eye.double().tolist()}


def test_with_the_light_fixed_the_eye_is_the_only_input(written, tmp_path):
    transfer, light = written["factored"].transfer, random_lights(1, ORDER)[0]
    report = export(transfer, tmp_path / "a.onnx", fix_light=light)
    assert report.inputs == {"eye": ("B", 3)}
    assert report.parity.passed
    assert set(report.operators) <= ALLOWED
    eyes = eyes_of(transfer)
    wanted = torch.stack([by_definition(transfer, light, eye) for eye in eyes])
    assert_same(run(tmp_path / "a.onnx", eye=eyes), wanted, tolerance(ORDER, shader(transfer)))
    assert describe(tmp_path / "a.onnx")["fixed"] == "light"
    # No longer a file for which any light would do.
    with pytest.raises(InputError, match="takes eye but the module takes light, rotation, eye or light, rotation"):
        compare(tmp_path / "a.onnx", shader(transfer))


def test_where_nothing_is_glossy_the_eye_must_be_fixed(tmp_path):
    transfer = random_glossy(glossy=0, order=1)
    with pytest.raises(InputError, match="no receiver is glossy, so nothing depends on the eye: give fix_eye"):
        export(transfer, tmp_path / "a.onnx")
    assert export(transfer, tmp_path / "a.onnx", fix_eye=[0.0, 0.0, 0.0]).parity.passed


# Parity


def test_parity_sees_one_wrong_coefficient(file):
    wrong = stored(file.transfer).clone()
    # A tenth of one coefficient.
    wrong.view(-1)[len(wrong.view(-1)) // 2] += 0.1 * wrong.abs().max()
    transfer = replaced(file.transfer, values=wrong)
    assert not compare(file.path, shader(transfer, exponent=exponent_of(gloss(transfer).kind))).passed


def test_parity_sees_a_receiver_in_another_place(file):
    places = file.transfer.positions.clone()
    places[gloss(file.transfer).receivers[2]] += 0.01
    transfer = replaced(file.transfer, positions=places)
    assert not compare(file.path, shader(transfer, exponent=exponent_of(gloss(transfer).kind))).passed


def test_parity_sees_a_frame_turned_by_a_degree(file):
    transfer = file.transfer
    tangents = gloss(transfer).tangents.clone()
    _, bitangent, _ = frame_of(transfer, 0).float()
    tangents[0] = math.cos(math.radians(1)) * tangents[0] + math.sin(math.radians(1)) * bitangent
    turned = replaced(transfer, tangents=tangents)
    assert not compare(file.path, shader(turned, exponent=exponent_of(gloss(transfer).kind))).passed


def test_parity_refuses_a_module_with_other_inputs(written):
    module = EnvironmentShader(shader(written["exit"].transfer), 4)
    with pytest.raises(InputError, match="takes light, rotation, eye but the module takes environment, rotation, eye"):
        compare(written["exit"].path, module)
    with pytest.raises(InputError, match=r"but the module takes light, rotation: compare its own"):
        compare(written["exit"].path, shader(written["exit"].transfer).fix_eye(eye=torch.tensor([1.0, 2.0, 3.0])))


def seen_of(transfer):
    module = shader(transfer, dtype=torch.float64)
    return receivers(module, module.layers[gloss(transfer).kind], {})


def test_eyes_are_near_and_far_at_a_receiver_and_behind_it():
    seen = seen_of(random_glossy(vertices=50))
    eyes = random_eyes(seen, "eye", 24, torch.Generator().manual_seed(0)).double()
    assert eyes.isfinite().all()
    distances = torch.linalg.vector_norm(eyes[:, None] - seen.points.T, dim=-1)
    size = torch.linalg.vector_norm(seen.points.amax(1) - seen.points.amin(1))
    assert (distances.amin(1) == 0).sum() == 4
    assert (distances.amin(1) > 1000 * size).sum() == 4
    assert ((distances.amin(1) > 0) & (distances.amin(1) < 0.02 * size)).sum() >= 4
    assert min(float(conditions(seen, eye, None).min()) for eye in eyes) < 0.5


def test_rounding_counts_less_toward_straight_below_alone():
    transfer = random_glossy(vertices=1)
    seen = seen_of(transfer)
    tangent, _, normal = frame_of(transfer, 0)
    for angle in (0.0, 1e-3, 0.5, math.pi / 2):
        below = math.sin(angle) * tangent - math.cos(angle) * normal
        # Rounding of the frame, which is float32.
        expected = pytest.approx(math.sin(angle), abs=1e-6)
        assert float(conditions(seen, None, 7 * below)) == expected
        assert float(conditions(seen, seen.points[:, 0] + 7 * below, None)) == expected
        assert float(conditions(seen, None, 0.1 * tangent + math.cos(angle) * normal)) == 1
    assert float(conditions(seen, seen.points[:, 0], None)) == 1


def test_tolerance_grows_with_what_magnifies_rounding():
    optimal = shader(random_glossy(order=5, output_order=5))
    reduced = shader(random_glossy(order=5, output_order=5, projection="reduced"))
    assert tolerance(5, optimal) == tolerance(5)
    assert tolerance(5, reduced) == pytest.approx(57 * tolerance(5), rel=0.02)
    assert tolerance(5, shader(random_glossy(order=5, output_order=9))) == tolerance(9)
    assert tolerance(5, shader(random_glossy("factored", order=5))) == tolerance(32)

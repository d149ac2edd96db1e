"""Do receivers read what an object does to light as the definition says, wherever object, light and receivers go?"""

import copy
import math

import pytest
import torch
from every_shader import asked, every_transfer
from every_shader import lights as lights_of_all
from neighbourhoods import ORDER, OUT, box_mesh, lights, posed, random_neighbourhood, receivers, slab, slab_around
from torch.nn.functional import normalize

from torchprt import InputError, brdf, light, sh
from torchprt.compression import compress
from torchprt.measure import relative_rms
from torchprt.scene import Material, Object, Points, Scene
from torchprt.shade import BrdfReceiving, NeighbourhoodShader, PhongReceiving, by_ratio, shader, under_field
from torchprt.transport import bake

EPS = {torch.float32: 1.2e-7, torch.float64: 2.3e-16}


def close(found, wanted, factor=200):
    torch.testing.assert_close(found, wanted, rtol=0, atol=factor * EPS[found.dtype] * float(wanted.abs().max()))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"positions": torch.full((50, 3), math.nan)}, "NaN or infinity"),
        ({"normals": torch.full((50, 3), 0.9)}, "unit length"),
        ({"pose": torch.eye(3)}, "pose has shape"),
        ({"pose": 2 * torch.eye(4)}, "last row"),
        ({"pose": torch.diag(torch.tensor([2.0, 1.0, 1.0, 1.0]))}, "pose must be orthogonal"),
        ({"pose": (torch.eye(3), torch.full((3,), math.inf))}, "moves by NaN"),
        ({"pose": (torch.eye(3), torch.zeros(2))}, "translation of shape"),
        ({"eye": torch.zeros(3)}, "omit it"),
    ],
)
def test_refuses_what_makes_no_sense(wrong, words):
    shade = NeighbourhoodShader(random_neighbourhood())
    with pytest.raises(InputError, match=words):
        shade(lights(), **receivers() | wrong)


def test_refuses_another_light_an_eye_that_is_missing_and_what_is_no_neighbourhood():
    transfer = random_neighbourhood()
    shade = NeighbourhoodShader(transfer)
    with pytest.raises(InputError, match="of order 4"):
        shade(lights(order=3), **receivers())
    with pytest.raises(InputError, match="convert the light"):
        shade(lights(dtype=torch.float64), **receivers())
    with pytest.raises(InputError, match="neither is given"):
        NeighbourhoodShader(transfer, receiving=PhongReceiving(10))(lights(), **receivers())
    with pytest.raises(InputError, match="exponent of a Phong lobe"):
        PhongReceiving(-1.0)
    with pytest.raises(InputError, match="not around an object"):
        NeighbourhoodShader(next(iter(every_transfer().values())))
    with pytest.raises(InputError, match="no parts"):
        by_ratio([])


def read_slowly(transfer, place):
    """The matrices at a point `[C, M, N]`, float64, corner by corner, and how much of the change is left there."""
    grid, values = transfer.receivers, transfer.layers["neighbourhood"].signal.dense().values.double()
    at = [(p - o) / s for p, o, s in zip(place, grid.origin, grid.spacing, strict=True)]
    within = min(min(a, n - 1 - a) for a, n in zip(at, grid.shape, strict=True))
    kept = min(max(within, 0.0), 1.0)
    kept = kept * kept * (3 - 2 * kept)
    low = [min(max(math.floor(a), 0), n - 2) for a, n in zip(at, grid.shape, strict=True)]
    total = torch.zeros_like(values[:, 0])
    for i in (0, 1):
        for j in (0, 1):
            for k in (0, 1):
                number = ((low[0] + i) * grid.shape[1] + low[1] + j) * grid.shape[2] + low[2] + k
                weight = 1.0
                for step, a, first in zip((i, j, k), at, low, strict=True):
                    part = min(max(a, 0.0), first + 1.0) - first
                    weight *= part if step else 1 - part
                total += weight * values[:, number]
    return total, kept


def twin(transfer, coefficients, places, pose, rows_of):
    """Radiance by quadrature: no turned coefficients, no table, one receiver after the other. `rows_of(index)` gives
    directions, and reflectance times cosine times solid angle there."""
    turned, moved = pose[:3, :3], pose[:3, 3]
    still = sh.rotate(coefficients, turned.T)
    found = []
    for index, place in enumerate(places):
        matrix, kept = read_slowly(transfer, ((place - moved) @ turned).tolist())
        count = matrix.shape[1]
        arriving = torch.einsum("cmn,nd->cmd", matrix, still)
        arriving = torch.stack([arriving[c % len(arriving), :, c] for c in range(3)], -1)
        change = kept * (arriving - still[:count])
        directions, weights = rows_of(index)
        plain = weights @ sh.evaluate(coefficients, directions)
        found.append(plain + weights @ sh.evaluate(change, directions @ turned))
    return torch.stack(found)


@pytest.mark.parametrize("channels", [1, 3])
def test_agrees_with_the_definition_receiver_by_receiver(channels):
    transfer, given = random_neighbourhood(channels, dtype=torch.float64), receivers(24, torch.float64)
    pose = posed(at=(0.3, -0.2, 0.5), turn=(40.0, -25.0, 70.0), dtype=torch.float64)
    given["positions"] = given["positions"] @ pose[:3, :3].T + pose[:3, 3]
    coefficients = lights(dtype=torch.float64)
    directions, weights = sh.gauss_legendre_hemisphere(40)

    def cosine(index):
        frame = normalize(torch.randn(2, 3, generator=torch.Generator().manual_seed(index)).double(), dim=-1)
        normal = given["normals"][index]
        first = normalize(torch.linalg.cross(normal, frame[0]), dim=0)
        axes = torch.stack([first, torch.linalg.cross(normal, first), normal])
        return directions @ axes, weights * directions[:, 2] / math.pi

    found = NeighbourhoodShader(transfer)(coefficients, **given, pose=pose)
    wanted = twin(transfer, coefficients, given["positions"], pose, cosine)
    # Both are exact but for rounding; the quadrature adds some thousand numbers.
    close(found, wanted, 5000)
    assert float((found - NeighbourhoodShader(transfer)(coefficients, **given)).abs().max()) > 1e-3


def test_a_phong_lobe_and_a_brdf_are_integrated_against_what_arrives():
    transfer, given = random_neighbourhood(dtype=torch.float64, order=4, output_order=4), receivers(10, torch.float64)
    pose, eye = posed(turn=(10.0, 20.0, 30.0), dtype=torch.float64), torch.tensor([0.4, 3.0, 1.0]).double()
    coefficients = lights(dtype=torch.float64)
    sphere, area = sh.gauss_legendre(120)

    def lobe(index):
        toward, normal = normalize(eye - given["positions"][index], dim=0), given["normals"][index]
        mirrored = 2 * (toward @ normal) * normal - toward
        return sphere, area * (11 / (2 * math.pi)) * (sphere @ mirrored).clamp(min=0) ** 10

    shade = NeighbourhoodShader(transfer, receiving=PhongReceiving(10.0))
    assert shade.needs == {"eye"}
    found = shade(coefficients, **given, pose=pose, eye=eye)
    close(found, twin(transfer, coefficients, given["positions"], pose, lobe), 1e10)
    # Lambert's reflectance as any other: exit functions hold a constant exactly, its cosine has no eye.
    glossy = BrdfReceiving(brdf.Lambert(), 4, output_order=3)
    matte = NeighbourhoodShader(transfer, receiving=glossy)(coefficients, **given, pose=pose, eye=eye)
    wanted = NeighbourhoodShader(transfer)(coefficients, **given, pose=pose)
    torch.testing.assert_close(matte, wanted, rtol=0, atol=2e-4 * float(wanted.abs().max()))


def test_a_brdf_that_has_an_eye_is_integrated_in_the_frame_of_each_receiver():
    """Within what nine bands of exit functions hold of the lobe."""
    transfer, given = random_neighbourhood(dtype=torch.float64, order=4, output_order=4), receivers(12, torch.float64)
    pose = posed(turn=(50.0, 20.0, -70.0), at=(0.2, 0.0, 0.1), dtype=torch.float64)
    eye, gloss = torch.tensor([0.4, 9.0, 1.0]).double(), brdf.parse("phong:4")
    coefficients = lights(dtype=torch.float64)
    directions, weights = sh.gauss_legendre_hemisphere(60)
    above = (given["normals"] * (eye - given["positions"])).sum(-1) > 2
    given = {name: value[above] for name, value in given.items()}

    def lobe(index):
        toward, normal = normalize(eye - given["positions"][index], dim=0), given["normals"][index]
        first = normalize(torch.linalg.cross(normal, toward), dim=0)
        axes = torch.stack([first, torch.linalg.cross(normal, first), normal])
        return directions @ axes, weights * directions[:, 2] * gloss((axes @ toward)[None], directions)

    glossy = BrdfReceiving(gloss, 4, output_order=9)
    found = NeighbourhoodShader(transfer, receiving=glossy)(coefficients, **given, pose=pose, eye=eye)
    assert len(found) > 3
    assert relative_rms(found, twin(transfer, coefficients, given["positions"], pose, lobe)) < 0.03


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_all_turned_and_moved_together_is_the_same(dtype):
    transfer, given = random_neighbourhood(dtype=dtype), receivers(dtype=dtype)
    shade, pose = NeighbourhoodShader(transfer), posed(at=(0.2, 0.1, -0.3), turn=(30.0, 0.0, 10.0), dtype=dtype)
    whole = posed(at=(1.0, 2.0, -3.0), turn=(-100.0, 50.0, 20.0), dtype=dtype)
    wanted = shade(lights(dtype=dtype), **given, pose=pose)
    turn = whole[:3, :3]
    moved = {"positions": given["positions"] @ turn.T + whole[:3, 3], "normals": given["normals"] @ turn.T}
    close(shade(lights(dtype=dtype), turn, **moved, pose=whole @ pose), wanted, 400)
    apart = (pose[:3, :3], pose[:3, 3])
    assert torch.equal(shade(lights(dtype=dtype), **given, pose=apart), wanted)


def test_linear_in_the_light_and_channels_do_not_mix():
    shade, given = NeighbourhoodShader(random_neighbourhood(dtype=torch.float64)), receivers(dtype=torch.float64)
    one, other = lights(dtype=torch.float64), lights(dtype=torch.float64, seed=9)
    close(shade(2 * one - other, **given), 2 * shade(one, **given) - shade(other, **given), 1000)
    red = one * torch.tensor([1.0, 0.0, 0.0])
    assert float(shade(red, **given)[:, 1:].abs().max()) == 0


def test_outside_of_the_grid_there_is_the_plain_light_and_nothing_jumps_on_the_way():
    transfer = random_neighbourhood(dtype=torch.float64)
    shade, coefficients = NeighbourhoodShader(transfer), lights(dtype=torch.float64)
    low, high = (torch.tensor(corner).double() for corner in transfer.receivers.box)
    up = torch.tensor([0.0, 1.0, 0.0]).double()
    plain = sh.evaluate(sh.convolve(coefficients, sh.clamped_cosine(ORDER) / math.pi), up[None])
    outside = torch.stack([low - 1, high + 1, low, high, torch.stack([low[0], *((low + high) / 2)[1:]]), 1e6 * up])
    found = shade(coefficients, positions=outside, normals=up.expand(6, 3))
    close(found, plain.expand(6, 3), 1000)
    ticks = torch.linspace(-0.1, 1.1, 4001, dtype=torch.float64)[:, None]
    way = low + ticks * (high - low)
    steps = shade(coefficients, positions=way, normals=up.expand(4001, 3)).diff(dim=0).abs().max()
    assert float(steps) < 0.02 * float(plain.abs().max())


def test_a_receiver_without_a_normal_is_black_and_there_may_be_none():
    shade = NeighbourhoodShader(random_neighbourhood())
    given = receivers(4)
    given["normals"][1] = 0
    found = shade(lights(), **given)
    assert float(found[1].abs().max()) == 0
    assert float(found[0].abs().max()) > 0
    none = {name: value[:0] for name, value in given.items()}
    assert shade(lights(), **none).shape == (0, 3)
    assert shade(lights(0), **given).shape == (0, 4, 3)


def test_batches_of_lights_poses_and_receivers_broadcast():
    shade, given = NeighbourhoodShader(random_neighbourhood(3)), receivers(6)
    poses = torch.stack([posed(), posed(at=(0.5, 0.0, 0.0)), posed(turn=(90.0, 0.0, 0.0))])
    found = shade(lights(2, 1), **given, pose=poses, albedo=torch.tensor([0.5, 0.25, 1.0]))
    assert found.shape == (2, 3, 6, 3)
    for number in range(2):
        for pose in range(3):
            wanted = shade(lights(2, 1)[number, 0], **given, pose=poses[pose]) * torch.tensor([0.5, 0.25, 1.0])
            close(found[number, pose], wanted)
    moving = given["positions"] + torch.arange(4.0).view(4, 1, 1) / 10
    along = shade(lights(), positions=moving, normals=given["normals"], pose=poses[2])
    close(along[3], shade(lights(), positions=moving[3], normals=given["normals"], pose=poses[2]))


def test_clustered_reads_as_the_dense_one_it_stands_for():
    clustered = compress(random_neighbourhood(dtype=torch.float64), clusters=4, components=3)
    layer = clustered.layers["neighbourhood"]
    dense = clustered.with_layers(neighbourhood=layer.replace(signal=layer.signal.dense()))
    pose, given = posed(turn=(20.0, 30.0, 40.0), dtype=torch.float64), receivers(dtype=torch.float64)
    one, other = (
        NeighbourhoodShader(each)(lights(dtype=torch.float64), **given, pose=pose) for each in (clustered, dense)
    )
    close(one, other, 2000)


def test_gradients_flow_to_light_rotation_pose_positions_normals_and_albedo():
    shade = NeighbourhoodShader(random_neighbourhood(dtype=torch.float64, shape=(3, 3, 3)))
    given = receivers(4, torch.float64)
    # Off the faces of cells, where the gradient with respect to positions jumps.
    turn = posed(turn=(10.0, 20.0, 30.0), dtype=torch.float64)[:3, :3]
    inputs = (
        lights(dtype=torch.float64), torch.zeros(3).double(), torch.zeros(3).double(),
        given["positions"] * 0.3, given["normals"], torch.full((3,), 0.5).double(),
    )  # fmt: skip

    def whole(coefficients, spin, shift, positions, normals, albedo):
        x, y, z = spin
        zero = torch.zeros((), dtype=torch.float64)
        skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
        pose = (torch.matrix_exp(skew) @ turn, shift)
        return shade(
            coefficients,
            torch.matrix_exp(2 * skew),
            positions=positions,
            normals=normalize(normals, dim=-1),
            pose=pose,
            albedo=albedo,
        )

    assert torch.autograd.gradcheck(whole, [each.clone().requires_grad_() for each in inputs], atol=1e-6)


@pytest.mark.usefixtures("untyped")
def test_compiled_it_is_the_same():
    shade, given = NeighbourhoodShader(random_neighbourhood()), receivers(8)
    pose = posed(turn=(20.0, 30.0, 40.0))
    compiled = torch.compile(shade, backend="eager", fullgraph=True)
    close(compiled(lights(2), **given, pose=pose), shade(lights(2), **given, pose=pose))


def test_converted_and_copied_it_is_the_same():
    shade, given = NeighbourhoodShader(random_neighbourhood()), receivers(8)
    wide = copy.deepcopy(shade).double()
    wanted = wide(lights().double(), **{name: value.double() for name, value in given.items()})
    close(shade(lights(), **given), wanted.float())
    assert "nodes=4x3x5" in repr(shade)


@pytest.mark.parametrize("name", [name for name in every_transfer() if name.endswith("1")])
def test_a_field_that_is_the_same_everywhere_is_a_light(name):
    transfer = every_transfer(torch.float64)[name]
    shade = shader(transfer, **({"exponent": 5.0} if "reflectance" in transfer.needs else {}))
    look, one = asked(shade.needs, shade.vertices, dtype=torch.float64), lights_of_all(2, dtype=torch.float64)
    field = one[:, None].expand(2, shade.vertices, -1, 3)
    close(under_field(shade, field, **look), shade(one, **look), 2000)


def test_a_field_puts_every_receiver_under_a_light_of_its_own():
    transfer = every_transfer(torch.float64)["exit dense 3"]
    shade = shader(transfer)
    field = lights_of_all(shade.vertices, dtype=torch.float64).requires_grad_()
    view = torch.tensor([[0.0, 1.0, 0.3], [1.0, 0.2, 0.1]]).double()
    found = under_field(shade, field, view=view)
    assert found.shape == (2, shade.vertices, 3)
    for index in (0, 5):
        close(found[1, index].detach(), shade(field[index].detach(), view=view[1])[index], 2000)
    found.sum().backward()
    assert bool((field.grad != 0).any((-1, -2)).all())
    for wrong, words in (
        (field[:-1], "a light for each"),
        (field[:, :9], "order 4"),
        (field.float(), "convert it"),
    ):
        with pytest.raises(InputError, match=words):
            under_field(shade, wrong, view=view)
    with pytest.raises(InputError, match="neither is given"):
        under_field(shade, field)


def test_receivers_with_transfer_of_their_own_read_the_light_that_arrives():
    transfer = random_neighbourhood(dtype=torch.float64)
    around, given = NeighbourhoodShader(transfer), receivers(6, torch.float64)
    pose = torch.stack([posed(turn=(50.0, 10.0, 0.0), at=(0.1, 0.2, 0.3), dtype=torch.float64), torch.eye(4).double()])
    field = around.light_at(lights(dtype=torch.float64), positions=given["positions"], pose=pose)
    assert field.shape == (2, 6, ORDER**2, 3)
    # A clamped cosine is transfer too; it has nothing in the band above the output order, which the field leaves plain.
    rows = sh.zonal(sh.clamped_cosine(ORDER) / math.pi, given["normals"])
    found = torch.einsum("rn,prnc->prc", rows, field)
    close(found, around(lights(dtype=torch.float64), **given, pose=pose), 2000)
    assert OUT < ORDER


def test_the_shadow_on_a_plane_is_that_of_plane_and_object_baked_together():
    """Within 5 % of radiance (RMS), and a fifth of what leaving the shadow out would be: the grid is small."""
    ticks = torch.linspace(-1.2, 1.2, 15, dtype=torch.float64)
    x, z = torch.meshgrid(ticks, ticks, indexing="ij")
    places = torch.stack([x.flatten(), torch.full((225,), -0.6, dtype=torch.float64), z.flatten()], -1)
    up = torch.tensor([0.0, 1.0, 0.0]).expand(225, 3)
    sun = light.disc((0.4, 1.0, 0.3), math.radians(10), 1.0, order=ORDER, normalise=True)
    shines = torch.stack([sun, light.constant(1.0, order=ORDER)]).float()
    direct = bake(slab(), order=ORDER, rays=512, receivers=Points(places, up.double(), 1.0), progress=False)
    wanted = shader(direct)(shines)
    found = NeighbourhoodShader(slab_around())(shines, positions=places.float(), normals=up)
    alone = NeighbourhoodShader(random_neighbourhood())(shines, positions=100 + places.float(), normals=up)
    for each in range(2):
        missed = relative_rms(alone[each], wanted[each])
        assert relative_rms(found[each], wanted[each]) < min(0.05, missed / 5)
        assert missed > 0.05


def test_two_objects_are_multiplied_and_one_is_exact():
    shade = NeighbourhoodShader(slab_around())
    ticks = torch.linspace(-1.0, 1.0, 11)
    x, z = torch.meshgrid(ticks, ticks, indexing="ij")
    places = torch.stack([x.flatten(), torch.full((121,), -0.9), z.flatten()], -1)
    up = torch.tensor([0.0, 1.0, 0.0]).expand(121, 3)
    sun = light.disc((0.1, 1.0, 0.0), math.radians(10), 1.0, order=ORDER, normalise=True)
    shines = (sun + light.constant(0.2, order=ORDER)).float()
    shifts = ((-0.3, 0.0, 0.0), (0.2, 0.3, 0.1))
    parts = [shade.parts(shines, positions=places, normals=up, pose=posed(at=shift)) for shift in shifts]
    close(by_ratio(parts[:1]), sum(parts[0]), 20)
    boxes = [
        box_mesh(
            *([c + s for c, s in zip(corner, shift, strict=True)] for corner in ((-0.4, -0.05, -0.4), (0.4, 0.05, 0.4)))
        )
        for shift in shifts
    ]
    both = Scene([Object(mesh, Material(0.5)) for mesh in boxes])
    direct = bake(both, order=ORDER, rays=512, receivers=Points(places.double(), up.double(), 1.0), progress=False)
    wanted = shader(direct)(shines)
    found, added = by_ratio(parts), parts[0][0] + parts[0][1] + parts[1][1]
    assert relative_rms(found, wanted) < 0.1
    assert relative_rms(found, wanted) < 0.6 * relative_rms(added, wanted)
    dark = [(torch.zeros(2, 3), torch.full((2, 3), 0.1))] * 2
    assert float(by_ratio(dark).abs().max()) == 0

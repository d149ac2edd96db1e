"""Does a patch that is read at every point give what it gives at vertices, with a gloss too?"""

import dataclasses
import math

import pytest
import torch
from lobe_maps import random_glossy_map, random_map

from torchprt import sh
from torchprt.errors import InputError
from torchprt.pose import surface_frames
from torchprt.pose.surface_frames import vertex_uv
from torchprt.scene import samples
from torchprt.shade import PatchShader, lay, sample, shader
from torchprt.transfer import load, save

KINDS = ["diffuse", "exit", "incident", "factored"]
EYE = torch.tensor([1.5, 2.0, 3.0], dtype=torch.float64)
REPEAT = torch.tensor([3.0, 2.0], dtype=torch.float64)


def a_map(kind, **options):
    return random_map(**options) if kind == "diffuse" else random_glossy_map(kind, **options)


def a_light(*batch, order=4, seed=3):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def a_turn(seed=1):
    return sh.yaw_pitch_roll(360 * torch.rand(3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64))


def a_cylinder(mirrored=False):
    """Positions, faces, texture coordinates of corners and normals, and of each vertex coordinates and frame."""
    mesh = samples.cylinder(8).objects[0].mesh
    uv = mesh.uv.double() * torch.tensor([-1.0 if mirrored else 1.0, 1.0], dtype=torch.float64)
    pairs = vertex_uv(mesh.faces, uv, len(mesh.positions))
    frames = surface_frames(mesh.positions, mesh.faces, uv, mesh.normals)
    return mesh.positions, mesh.faces, uv, mesh.normals, pairs * REPEAT, frames


def seen(kind):
    return {} if kind == "diffuse" else {"eye": EYE}


def test_refuses_what_is_no_patch_or_does_not_fit():
    patch, frames = PatchShader(random_map()), torch.eye(3, dtype=torch.float64).expand(2, 3, 3)
    with pytest.raises(InputError, match=r"uv have shape \[3, 2\] and frames \[2, 3, 3\]"):
        patch(a_light(), torch.zeros(3, 2), frames)
    with pytest.raises(InputError, match="uv of the points are not finite"):
        patch(a_light(), torch.full((2, 2), math.nan), frames)
    with pytest.raises(InputError, match="looks alike from everywhere"):
        patch(a_light(), torch.zeros(2, 2), frames, eye=EYE)
    with pytest.raises(InputError, match="order 4"):
        patch(a_light(order=3), torch.zeros(2, 2), frames)
    with pytest.raises(InputError, match="recorded at vertices"):
        PatchShader(lay(random_map(), *a_cylinder()[:3]))


def test_a_glossy_patch_wants_an_eye_and_places_to_see_it_from():
    patch, frames = PatchShader(random_glossy_map()), torch.eye(3, dtype=torch.float64).expand(2, 3, 3)
    with pytest.raises(InputError, match="neither is given"):
        patch(a_light(), torch.zeros(2, 2), frames)
    with pytest.raises(InputError, match="give the positions"):
        patch(a_light(), torch.zeros(2, 2), frames, eye=EYE)


def test_a_patch_whose_layer_is_not_in_lobes_or_not_of_all_texels_is_refused():
    patch = random_glossy_map()
    some = patch.layers["exit"].take(torch.arange(5), torch.arange(5))
    for call in (PatchShader, lambda each: lay(each, *a_cylinder()[:3])):
        with pytest.raises(InputError, match="exit layer of the patch is about some of its texels"):
            call(dataclasses.replace(patch, layers={**patch.layers, "exit": some}))
    with pytest.raises(InputError, match="no diffuse layer"):
        sample(dataclasses.replace(patch, layers={"exit": patch.layers["exit"]}), torch.zeros(1, 2))


def test_no_points_have_no_radiance():
    none = torch.zeros(0, 3, 3, dtype=torch.float64)
    assert PatchShader(random_map())(a_light(2), torch.zeros(0, 2, dtype=torch.float64), none).shape == (2, 0, 3)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_at_vertices_it_gives_what_the_laid_patch_gives(kind, smooth):
    patch = a_map(kind, smooth=smooth)
    positions, faces, uv, normals, pairs, frames = a_cylinder()
    laid = lay(patch, positions, faces, uv, repeat=(3, 2), normals=normals)
    laid.check()
    wanted = shader(laid)(a_light(2), **seen(kind))
    found = PatchShader(patch)(a_light(2), pairs, frames, positions=positions, **seen(kind))
    # Frames are read in float64 in one of the two and mixed before they are turned in the other.
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-10 * float(wanted.abs().max()))


@pytest.mark.parametrize("kind", ["diffuse", "exit", "incident"])
def test_on_mirrored_coordinates_too(kind):
    patch = a_map(kind)
    positions, faces, uv, normals, pairs, frames = a_cylinder(mirrored=True)
    assert bool((torch.linalg.det(frames) < 0).all())
    wanted = shader(lay(patch, positions, faces, uv, repeat=(3, 2), normals=normals))(a_light(), **seen(kind))
    found = PatchShader(patch)(a_light(), pairs, frames, positions=positions, **seen(kind))
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-10 * float(wanted.abs().max()))


def test_factors_without_a_mirror_image_are_refused_at_vertices_and_read_at_points():
    patch = random_glossy_map("factored")
    positions, faces, uv, normals, pairs, frames = a_cylinder(mirrored=True)
    with pytest.raises(InputError, match="factored layer of the patch have no mirror image"):
        lay(patch, positions, faces, uv, normals=normals)
    found = PatchShader(patch)(a_light(), pairs, frames, view=EYE)
    # What a mirror shows: the surface, the light and the eye on its other side, coordinates unmirrored.
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64))
    order = torch.tensor([m for band in range(4) for m in range(-band, band + 1)])
    odd = ((order > 0) & (order % 2 == 1)) | ((order < 0) & (order % 2 == 0))
    light = a_light() * torch.where(odd, -1.0, 1.0)[:, None]
    wanted = PatchShader(patch)(light, pairs, flip @ frames, view=flip @ EYE)
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-9 * float(wanted.abs().max()))


@pytest.mark.parametrize("kind", KINDS)
def test_frames_light_and_eye_turned_together_change_nothing(kind):
    patch, turn = PatchShader(a_map(kind)), a_turn()
    positions, _, _, _, pairs, frames = a_cylinder()
    wanted = patch(a_light(), pairs, frames, positions=positions, **seen(kind))
    turned = {name: turn @ each for name, each in seen(kind).items()}
    found = patch(a_light(), pairs, turn @ frames, turn, positions=positions @ turn.mT, **turned)
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-9 * float(wanted.abs().max()))


@pytest.mark.parametrize("kind", KINDS)
def test_at_the_centres_of_texels_it_is_the_patch_itself(kind):
    patch = a_map(kind)
    rows, columns = patch.receivers.rows, patch.receivers.columns
    v, u = torch.meshgrid(*((torch.arange(n, dtype=torch.float64) + 0.5) / n for n in (rows, columns)), indexing="ij")
    uv, frames = torch.stack([u, v], -1).view(-1, 2), torch.eye(3, dtype=torch.float64).expand(rows * columns, 3, 3)
    wanted = shader(patch)(a_light(), **seen(kind))
    found = PatchShader(patch)(a_light(), uv, frames, positions=patch.positions.double(), **seen(kind))
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-6 * float(wanted.abs().max()))


def test_many_eyes_and_lights_are_those_of_each():
    patch = PatchShader(random_glossy_map("factored"))
    positions, _, _, _, pairs, frames = a_cylinder()
    eyes = EYE + torch.randn(2, 1, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    found = patch(a_light(3), pairs, frames, eye=eyes, positions=positions)
    assert found.shape == (2, 3, len(pairs), 3)
    for i, j in ((0, 2), (1, 0)):
        one = patch(a_light(3)[j], pairs, frames, eye=eyes[i, 0], positions=positions)
        torch.testing.assert_close(found[i, j], one, rtol=0, atol=1e-10 * float(one.abs().max()))


def test_a_point_without_a_frame_gets_no_light():
    positions, _, _, _, pairs, frames = a_cylinder()
    frames = frames.clone()
    frames[3] = 0
    for kind in ("diffuse", "exit"):
        found = PatchShader(a_map(kind))(a_light(), pairs, frames, positions=positions, **seen(kind))
        assert bool((found[3] == 0).all())
        assert bool(found.isfinite().all())


def test_gradients_flow_to_the_map_the_place_and_the_eye():
    patch = PatchShader(random_glossy_map(rows=2, columns=3, order=3), learn=["axis", "coefficients", "specular"])
    place = torch.tensor([[0.4, 0.3], [0.9, 0.1]], dtype=torch.float64, requires_grad=True)
    frames = torch.stack([a_turn(2), a_turn(3)])
    positions = torch.zeros(2, 3, dtype=torch.float64)
    # An eye above both relieves.
    eye = (3 * frames[:, :, 2].sum(0)).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda eye, place: patch(a_light(order=3), place, frames, eye=eye, positions=positions), (eye, place)
    )
    patch(a_light(order=3), place, frames, eye=eye, positions=positions).square().sum().backward()
    assert all(bool(each.grad.abs().max() > 0) for each in patch.parameters())


def test_a_glossy_patch_is_written_and_read(tmp_path):
    patch = random_glossy_map("factored")
    save(patch, tmp_path / "map.safetensors")
    again = load(tmp_path / "map.safetensors")
    assert torch.equal(again.receivers.relief, patch.receivers.relief)
    assert torch.equal(again.normals, patch.normals)
    with pytest.raises(InputError, match=r"relief.* 3 normals for 6 x 8 texels"):
        patch.receivers.replace(relief=patch.receivers.relief[:3])


def test_a_laid_gloss_follows_a_pose():
    patch, turn = random_glossy_map("exit"), a_turn(4)
    positions, faces, uv, normals, *_ = a_cylinder()
    rest = lay(patch, positions, faces, uv, normals=normals)
    wanted = shader(rest)(a_light(), eye=EYE)
    frames = turn.expand(len(positions), 3, 3)
    found = shader(rest)(a_light(), turn, eye=turn @ EYE, frames=frames, positions=positions @ turn.mT)
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-9 * float(wanted.abs().max()))


@pytest.mark.usefixtures("untyped")
def test_it_is_traced_for_any_number_of_points_and_lights():
    patch = PatchShader(random_map(3, 2, lobes=1, order=3, dtype=torch.float32))

    def given(lights, points):
        frames = torch.eye(3).expand(points, 3, 3).contiguous()
        return torch.randn(lights, 9, 3), torch.rand(points, 2), frames

    batch, points = torch.export.Dim("B"), torch.export.Dim("V", min=2)
    sizes = ({0: batch}, {0: points}, {0: points})
    program = torch.export.export(patch, given(2, 5), dynamic_shapes=sizes, strict=False)
    other = given(3, 11)
    torch.testing.assert_close(program.module()(*other), patch(*other), rtol=1e-5, atol=1e-5)


def test_a_texture_colours_a_patch():
    patch = random_map(dtype=torch.float64)
    texture = torch.rand(48, 3, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    layer = patch.layers["diffuse"]
    white, painted = (
        patch.with_layers(diffuse=layer.replace(albedo=each)) for each in (torch.ones(1, 1).double(), texture)
    )
    uv, frames = torch.tensor([[2.5 / 8, 1.5 / 6]]).double(), torch.eye(3).double()[None]
    one, other = (PatchShader(each)(a_light(), uv, frames) for each in (white, painted))
    torch.testing.assert_close(other[0], one[0] * texture[1 * 8 + 2])

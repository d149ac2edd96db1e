"""Do texels record what vertices in their places would, and seams what a whole surface would?"""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
import trimesh
from texel_scenes import SQUARE, card, column, cube, halves, plane

from torchprt import memory
from torchprt.errors import InputError
from torchprt.scene import Lightmap, Material, Object, Points, Scene, make_mesh, samples
from torchprt.scene.seams import LEVELS, seams
from torchprt.shade import shader
from torchprt.transfer import Atlas, Sight, Transfer, bilinear
from torchprt.transport import bake

quiet = pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning")


def at_texels(scene: Scene, size: int | tuple[int, int], **options: Any) -> Transfer:
    own = {name: options.pop(name) for name in ("samples", "gutter", "uv") if name in options}
    return bake(scene, lightmap=Lightmap(size, **{"uv": 0, **own}), progress=False, **options)


def vectors(transfer: Transfer) -> torch.Tensor:
    return transfer.layers["diffuse"].signal.values


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"size": 0}, "0 x 0 texels"),
        ({"size": (64, 99999)}, "64 x 99999"),
        ({"samples": 5}, "square number"),
        ({"gutter": -1}, "gutter is -1"),
        ({"uv": -1}, "uv is -1"),
    ],
)
def test_what_no_map_has_is_refused(given: dict[str, Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        Lightmap(**given)


def test_a_word_that_is_no_set_is_refused(untyped: None) -> None:
    with pytest.raises(InputError, match="'unwrap'"):
        Lightmap(uv="chart")  # type: ignore[arg-type]


def test_what_does_not_go_together_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene([Object(plane())])
    points = Points(torch.zeros(1, 3), torch.tensor([[0.0, 1.0, 0.0]]))
    with pytest.raises(InputError, match="receivers and a lightmap"):
        bake(scene, lightmap=Lightmap(8, uv=0), receivers=points, progress=False)
    with pytest.raises(InputError, match="3 rays a texel cannot start from 4 samples"):
        at_texels(scene, 8, rays=3)
    leaf = Scene([Object(plane(), Material(0.5, two_sided=True, translucency=0.3))])
    with pytest.raises(InputError, match="translucent, which is recorded at vertices"):
        at_texels(leaf, 8)
    monkeypatch.setattr(memory, "available", lambda: 1 << 20)
    with pytest.raises(InputError, match=r"map of 512 x 512 texels.* needs about .* give fewer texels"):
        at_texels(scene, 512)


def test_texels_are_as_vertices_in_their_places() -> None:
    # 32 texels across, each in the middle of one cell of a grid of vertices.
    texels = at_texels(Scene([Object(plane()), card()]), 40, samples=1, rays=64)
    inner = 1 - 1 / 32
    vertices = bake(Scene([Object(plane(31, -inner, inner)), card()]), rays=64, progress=False)
    apart, nearest = torch.cdist(texels.positions.double(), vertices.positions.double()).min(1)
    assert texels.vertices == 32 * 32
    assert float(apart.max()) < 1e-6
    difference = (vectors(texels) - vectors(vertices)[:, :, nearest]).abs().max()
    # The same rays; their starts differ by rounding, which may turn one ray of 64 at the rim of the shadow.
    assert float(difference) < 1 / 64
    assert float((vectors(texels) - vectors(vertices)[:, :, nearest]).square().mean().sqrt()) < 1e-4


def test_several_samples_are_the_mean_over_a_texel() -> None:
    scene = Scene([Object(plane()), card()])
    coarse = at_texels(scene, 10, samples=16, rays=4096)
    fine = at_texels(scene, 40, samples=1, rays=4096)
    assert coarse.vertices == 64
    mean = vectors(fine).view(1, 25, 8, 4, 8, 4).mean((3, 5)).view(1, 25, 64)
    spread = float((vectors(coarse) - mean).square().mean().sqrt())
    # A sixteenth of the rays from each place: the error of 256.
    assert spread < 2 * bake(scene, rays=256, progress=False).error


def test_unshadowed_texels_are_the_closed_form() -> None:
    scene = Scene([Object(plane())])
    open_, closed = at_texels(scene, 16, rays=16), at_texels(scene, 16, shadows=False)
    torch.testing.assert_close(vectors(open_), vectors(closed), atol=1e-6, rtol=0)


@pytest.mark.parametrize("move", [1e-6, 1.0, 1e6])
def test_scale_does_not_matter(move: float) -> None:
    def scene(scale: float) -> Scene:
        one, other = plane(), card().mesh
        bigger = make_mesh(one.positions * scale, one.faces, uv=one.uv, name="plane")
        above = make_mesh(other.positions * scale, other.faces)
        return Scene([Object(bigger), Object(above, Material(0.0), "blocker")])

    expected, found = (at_texels(scene(each), 10, rays=64, seed=3) for each in (1.0, move))
    assert torch.equal(found.receivers.texel, expected.receivers.texel)
    torch.testing.assert_close(vectors(found), vectors(expected), atol=2 / 64, rtol=0)


def test_both_sides_of_a_seam_are_read_alike() -> None:
    atlas = at_texels(Scene([Object(halves())]), 64, samples=16, rays=16).receivers
    assert isinstance(atlas, Atlas)
    along = torch.linspace(0.1, 0.9, 101, dtype=torch.float64)
    value = (atlas.positions[:, :1] + 2 * atlas.positions[:, 2:]).double()
    zero = torch.zeros_like(along)
    left = atlas.at(value, torch.zeros(101).long(), torch.stack([zero, along, 1 - along], -1))
    right = atlas.at(value, torch.full((101,), 3), torch.stack([1 - along, along, zero], -1))
    truth = 1 + 2 * along[:, None]
    # A texel is .06 wide: the nearest of the same chart would be off by half of that.
    assert float((left - truth).abs().max()) < 1e-3
    assert float((right - truth).abs().max()) < 1e-3


def test_a_seam_of_faces_narrower_than_a_texel_is_read_alike_from_both_sides() -> None:
    mesh = column()
    atlas = at_texels(Scene([Object(mesh)]), 64, rays=4).receivers
    assert isinstance(atlas, Atlas)
    faces, uv = mesh.faces.numpy(), mesh.uv.numpy()
    normals = mesh.normals.numpy()[faces]
    found = seams(mesh.positions.numpy(), faces, normals, uv, 1e-9)
    count = len(found.face) // (4 * LEVELS)
    # Two edges, from either side.
    assert count == 4
    share = torch.linspace(0.1, 0.9, 33, dtype=torch.float64)[:, None, None]
    here, there = (
        ((1 - share) * a + share * b).flatten(0, 1)
        for a, b in (
            (torch.from_numpy(each[:count, 0]), torch.from_numpy(each[:count, 1])) for each in (found.uv, found.place)
        )
    )
    image = atlas.image(atlas.positions.double())
    apart = (bilinear(image, here) - bilinear(image, there)).norm(dim=-1)
    # A texel is 1 / (.7 * 64) high at least: faces that were extended, not left, put places tenfold that apart.
    assert float(apart.max()) < 0.3 / 45


def test_a_facet_does_not_shade_itself() -> None:
    round = trimesh.creation.icosphere(subdivisions=2)
    ball = make_mesh(round.vertices, round.faces, normals=round.vertices, name="ball")
    transfer = at_texels(Scene([Object(ball)]), 128, rays=256, uv="unwrap")
    open_ = at_texels(Scene([Object(ball)]), 128, shadows=False, uv="unwrap")
    lost = 1 - float(vectors(transfer)[0, 0].mean() / vectors(open_)[0, 0].mean())
    # Rays from the facets themselves lose 2 % of the light to their neighbours.
    assert abs(lost) < 5e-3


def test_light_goes_from_texel_to_texel_as_between_many_vertices() -> None:
    # An open box, white on the left, of two faces a side; and the same of many.
    def box(count: int) -> Scene:
        floor = plane(count, uv=(0.05, 0.05, 0.45, 0.45))
        wall = floor.positions[:, [1, 0, 2]] + torch.tensor([-1.0, 1.0, 0.0])
        pairs = floor.uv + torch.tensor([0.5, 0.0])
        side = make_mesh(wall, floor.faces.flip(-1), uv=pairs, name="wall")
        return Scene([Object(floor, Material((0.6, 0.5, 0.4))), Object(side, Material((0.9, 0.2, 0.1)))])

    found = at_texels(box(1), 40, samples=1, rays=1024, bounces=2)
    # Texels as vertices, at the middles.
    fine = bake(box(32), rays=1024, bounces=2, progress=False)
    there = fine.receivers.at(vectors(fine).flatten(0, 1).T, *_places(found, fine)).T.view(vectors(found).shape)
    error = float((vectors(found) - there).norm() / there.norm())
    assert found.channels == 3
    # That of the rays, of the interpolation between vertices, and of texels that are constant to each other.
    assert error < 0.02
    alone = at_texels(box(1), 40, samples=1, rays=1024)
    assert float((vectors(alone).expand(3, -1, -1) - there).norm() / there.norm()) > 0.1


def _places(found: Transfer, fine: Transfer) -> tuple[torch.Tensor, torch.Tensor]:
    """Faces of `fine` nearest to the texels, and the weights of their corners there."""
    corners = fine.positions[fine.faces.long()].double()
    place = found.positions.double()
    face, weights = torch.zeros(len(place)).long(), torch.zeros(len(place), 3).double()
    for at, point in enumerate(place):
        a, b, c = corners.unbind(1)
        normal = torch.linalg.cross(b - a, c - a)
        area = normal.norm(dim=-1)
        unit = normal / area[:, None]
        parts = torch.stack(
            [(torch.linalg.cross(q - p, point - p) * unit).sum(-1) / area for p, q in ((b, c), (c, a), (a, b))], -1
        )
        outside = (-parts).clamp(min=0).amax(-1) + ((point - a) * unit).sum(-1).abs()
        face[at] = outside.argmin()
        weights[at] = parts[face[at]]
    return face, weights


def test_texels_under_a_box_are_filled_and_leave_no_rim() -> None:
    box = cube(0.85)
    lifted = make_mesh(box.positions + torch.tensor([0.0, 0.425, 0.0]), box.faces, uv=box.uv, name="box")
    scene = Scene([Object(plane()), Object(lifted, Material(0.0), "blocker")])
    transfer, dark = at_texels(scene, 50, rays=64), at_texels(scene, 50, rays=64, raw=True)
    atlas = transfer.receivers
    assert isinstance(atlas, Atlas)
    assert atlas.sight is not None
    place = atlas.positions[:, [0, 2]].abs().amax(-1)
    buried = place < 0.4
    assert bool((atlas.sight[buried] == Sight.FILLED).all())
    assert float(vectors(dark)[0, 0, buried].abs().max()) == 0
    # Texels that the rim cuts: of their samples outside alone.
    cut = (place - 0.425).abs() < 0.02
    beside = (place - 0.475).abs() < 0.02
    assert bool(cut.any())
    assert float(vectors(transfer)[0, 0, cut].min()) > 0.8 * float(vectors(transfer)[0, 0, beside].min())
    assert float(vectors(dark)[0, 0, cut].min()) < 0.6 * float(vectors(dark)[0, 0, beside].min())


@quiet
@pytest.mark.parametrize("kind", [{}, {"frame": "incident"}, {"frame": "visibility"}, {"factors": 3}])
def test_glossy_texels_are_as_vertices_in_their_places(kind: dict[str, Any]) -> None:
    paint = Material(0.2, gloss="ggx:0.5,0.04")
    bounces = 0 if kind.get("frame") == "visibility" else 1
    common = {"rays": 64, "order": 3, "bounces": bounces, **kind}
    texels = at_texels(Scene([Object(plane(), paint), card()]), 10, samples=1, **common)
    inner = 1 - 1 / 8
    vertices = bake(Scene([Object(plane(7, -inner, inner), paint), card()]), progress=False, **common)
    _, nearest = torch.cdist(texels.positions.double(), vertices.positions.double()).min(1)
    (name, layer), other = next(iter(texels.eye_layers.items())), next(iter(vertices.eye_layers.values()))
    assert name in vertices.layers
    axis = 2 if layer.signal.values.ndim == 3 else 1
    there = other.signal.values.index_select(axis, nearest)
    assert float((layer.signal.values - there).norm() / there.norm()) < 0.02


def test_light_comes_by_way_of_mirrors_to_texels_as_to_vertices() -> None:
    upright = torch.tensor([[1.2, 0.1, -1.0], [1.2, 0.1, 1.0], [1.2, 2.0, 1.0], [1.2, 2.0, -1.0]])
    glass = make_mesh(upright, SQUARE, name="glass")
    mirror = Object(glass, Material(mirror=(0.9, 0.5, 0.3)))
    texels = at_texels(Scene([Object(plane()), mirror]), 10, samples=1, rays=256, order=3)
    inner = 1 - 1 / 8
    vertices = bake(Scene([Object(plane(7, -inner, inner)), mirror]), rays=256, order=3, progress=False)
    _, nearest = torch.cdist(texels.positions.double(), vertices.positions.double()).min(1)
    assert texels.channels == 3
    # One ray of 256 or two may turn at the rim of the mirror.
    assert float((vectors(texels) - vectors(vertices)[:, :, nearest]).abs().max()) < 2 / 256 * 1.5
    black = Object(glass, Material(0.0), "blocker")
    blocked = at_texels(Scene([Object(plane()), black]), 10, samples=1, rays=256, order=3)
    assert float((vectors(texels) - vectors(blocked)).abs().max()) > 0.05
    with pytest.raises(InputError, match="not followed through a volume"):
        at_texels(Scene([Object(plane()), mirror]), 10, rays=16, volume=samples.cloud(4))


def test_the_same_bits_for_any_threads_and_after_an_interruption(tmp_path: Any) -> None:
    scene = Scene([Object(plane()), card()])
    expected = at_texels(scene, 50, rays=16, bounces=1, threads=1)
    assert torch.equal(vectors(expected), vectors(at_texels(scene, 50, rays=16, bounces=1, threads=2)))

    class Stop:
        left = 2

        def start(self, *_: Any) -> None: ...

        def advance(self, *_: Any) -> None:
            self.left -= 1
            if not self.left:
                raise KeyboardInterrupt

    options = {"rays": 16, "bounces": 1, "checkpoint": tmp_path / "partial"}
    with pytest.raises(KeyboardInterrupt):
        bake(scene, lightmap=Lightmap(50, uv=0), progress=Stop(), **options)
    assert (tmp_path / "partial").exists()
    assert torch.equal(vectors(expected), vectors(at_texels(scene, 50, **options)))


def test_light_from_one_side_stays_on_its_side_of_a_cube() -> None:
    transfer = at_texels(Scene([Object(cube())]), 96, rays=64, order=1, gutter=4)
    atlas = transfer.receivers
    assert isinstance(atlas, Atlas)
    lit = (atlas.normals[:, 0] > 0.9).float()[:, None]
    image = atlas.image(lit)[..., 0]
    # Gutters show their own chart.
    for number in range(6):
        own = atlas.chart == number
        value = float(lit[own].mean())
        near = torch.isin(atlas.gutter_sources[:, 0].long(), torch.nonzero(own)[:, 0])
        assert bool((image.flatten()[atlas.gutter.long()[near]] == value).all())
    assert math.isclose(float(image.max()), 1.0)


def test_objects_of_a_map_can_be_taken_alone() -> None:
    box, other = cube(name="box"), cube(name="other")
    moved = make_mesh(other.positions + torch.tensor([2.0, 0.0, 0.0]), other.faces, uv=other.uv, name="other")
    whole = at_texels(Scene([Object(box), Object(moved)]).on_ground(), 128, uv=None, rays=4, order=2)
    atlas, light = whole.receivers.as_atlas(), torch.rand(4, 3)
    ground = atlas.ground()
    assert 0 < int(ground.sum()) < atlas.count / 2
    for part, kept in ((whole.without_ground(), ~ground), (whole.only("other"), atlas.of_objects(["other"]))):
        part.check()
        place = part.receivers.as_atlas()
        assert part.vertices == int(kept.sum())
        assert len(place.mesh_faces) == 12 * len(place.objects)
        radiance = shader(whole)(light)
        assert torch.equal(shader(part)(light), radiance[kept])
        # Its texels and its gutters show what they did.
        shown, before = place.image(radiance[kept]), atlas.image(radiance)
        assert torch.equal(shown[shown != 0], before[shown != 0])
        assert float(place.mesh_positions[:, 1].min()) >= -0.5
    assert whole.only("other").receivers.as_atlas().objects[0]["charts"] == [0, 6]
    with pytest.raises(InputError, match="no object 'third': it has box, other, ground"):
        whole.only("third")

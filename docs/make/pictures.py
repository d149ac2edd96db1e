"""Makes every picture of the documentation from the project itself.

    python docs/make/pictures.py [NAME ...]

All of them without a name; "window" needs Open3D and a display, which `xvfb-run -a` can be. The same pixels every time,
as long as the versions of matplotlib and Embree are the same.
"""

from __future__ import annotations

import functools
import math
import sys
import warnings
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image
from torch import Tensor
from trimesh.creation import icosphere

from torchprt import demo, light, preview, sh
from torchprt.compression import compress
from torchprt.light import windowed as windowed_by
from torchprt.preview.lobe import sphere
from torchprt.scene import Material, Mesh, Object, Scene, TangentWarning, make_mesh, samples
from torchprt.shade import display, shader
from torchprt.trace import Tracer
from torchprt.transfer import Clustered, Transfer
from torchprt.transport import bake

FOLDER = Path(__file__).parents[1] / "images"
# Of the studio, as `automatic_exposure` gives it.
EXPOSURE = -1.7
WARM, COOL = "#d1495b", "#30638e"


def ground(squares: int = 110, half: float = 2.3) -> Mesh:
    """A square sheet at y = 0, facing up."""
    ticks = torch.linspace(-half, half, squares + 1, dtype=torch.float64)
    z, x = torch.meshgrid(ticks, ticks, indexing="ij")
    corner = (torch.arange(squares)[:, None] * (squares + 1) + torch.arange(squares)).reshape(-1)
    quads = torch.stack([corner, corner + squares + 1, corner + squares + 2, corner + 1], -1)
    faces = torch.cat([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return make_mesh(torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3), faces, name="ground")


@functools.cache
def stage() -> Scene:
    """The sculpture of the samples on a coloured ground."""
    sculpture = samples.organic(40_000).objects[0].mesh
    return Scene([Object(sculpture, Material(0.7)), Object(ground(), Material((0.75, 0.22, 0.07)))])


@functools.cache
def staged(bounces: int) -> Transfer:
    return bake(stage(), rays=1024, bounces=bounces, progress=False)


def vectors(transfer: Transfer, vertex: int) -> Tensor:
    """The transfer vector of a vertex, the mean of its channels."""
    return transfer.layers["diffuse"].signal.dense().values[..., vertex].mean(0)


def still(transfer: Transfer, size: tuple[int, int]) -> preview.Still:
    # The camera frames the sculpture, not the ground that goes on behind it.
    shape = stage().objects[0].mesh.positions
    camera = preview.frame(shape, (0.35, 0.45, 1.0), aspect=size[0] / size[1])
    return preview.Still(transfer.positions, transfer.faces, size=size, camera=camera, samples=9)


def shaded(transfer: Transfer, lamps: Tensor) -> Tensor:
    with torch.no_grad():
        return shader(transfer)(lamps)


def painted() -> Tensor:
    """The painted vase on a ground under three lights: one bake, one product a picture."""
    vase = samples.painted_vase(160, polished=True).on_ground(0.0, (0.42, 0.4, 0.37))
    transfer = bake(vase, rays=1024, bounces=2, progress=False)
    shade, size = shader(transfer), (420, 500)
    # A little farther than would just hold it.
    camera = preview.frame(1.1 * transfer.receivers.subject, (0.25, 0.4, 1.0), aspect=size[0] / size[1], field=28.0)
    pictures = []
    for name, yaw in (("sunset", 300.0), ("sky", 60.0), ("studio", 180.0)):
        seen = preview.built_in_environment(name, transfer.order)
        turn = sh.yaw_pitch_roll(torch.tensor([yaw, 0.0, 0.0])).float()
        pictures.append(preview.Studio(transfer, shade, seen, size=size, samples=16).picture(camera, turn))
    return preview.strip(pictures, 3)


def crumpled() -> Mesh:
    """A bumpy ball of which some vertices are pushed over a neighbour and some faces carry fins, as scans have them."""
    ball = icosphere(subdivisions=4)
    points, faces = torch.from_numpy(ball.vertices).double(), torch.from_numpy(ball.faces)
    bumps = 1 + 0.08 * (3 * points[:, 0]).sin() * (3 * points[:, 1] + 1).sin() + 0.05 * (5 * points[:, 2]).sin()
    places = points * bumps[:, None]
    generator = torch.Generator().manual_seed(3)
    chosen = torch.randperm(len(faces), generator=generator)[:70]
    pushed, fins = faces[chosen[:50]].long(), faces[chosen[50:]].long()
    moved = places.clone()
    moved[pushed[:, 0]] += 1.7 * (places[pushed[:, 1]] - places[pushed[:, 0]]) - 0.02 * points[pushed[:, 0]]
    tips = 1.05 * places[fins].mean(1)
    number = torch.arange(len(tips)) + len(places)
    a, b = fins[:, 0], fins[:, 1]
    both = torch.cat([torch.stack([a, b, number], 1), torch.stack([b, a, number], 1)])
    return make_mesh(torch.cat([moved, tips]), torch.cat([faces.long(), both]), name="crumpled ball")


def sight() -> Tensor:
    """A crumpled ball as its rays have it, mended, and which vertices were."""
    scene, size = Scene([Object(crumpled(), Material(0.8))]), (320, 320)
    raw, made = (bake(scene, rays=512, raw=raw, progress=False) for raw in (True, False))
    seen = preview.built_in_environment("overcast", made.order)
    camera = preview.frame(made.positions, (0.3, 0.35, 1.0), aspect=1.0)
    pictures = []
    for each, colours in ((raw, None), (made, None), (made, preview.sight_colours(made.receivers))):
        studio = preview.Studio(each, shader(each), seen, size=size, samples=16, colours=colours)
        pictures.append(studio.picture(camera, torch.eye(3)))
    return preview.sheet(pictures, ["--raw", "as baked", "--show sight"], columns=3)


def transport() -> Tensor:
    """The stage unshadowed, shadowed and interreflected."""
    lamps = light.project(light.studio(256), 5)
    bakes = {
        "unshadowed": bake(stage(), shadows=False, progress=False),
        "shadowed": staged(0),
        "interreflected, 3 bounces": staged(3),
    }
    seen = still(staged(0), (420, 380))
    pictures = [seen.picture(shaded(each, lamps), exposure=EXPOSURE) for each in bakes.values()]
    return preview.sheet(pictures, list(bakes), columns=3)


def ringing() -> Tensor:
    """A small lamp at order 5 under each window: the light it becomes, and the shadow it casts."""
    order, direction = 5, (0.35, 1.0, 0.2)
    transfer = bake(samples.plane_and_blocker(128), order=order, rays=2048, progress=False)
    camera = preview.frame(transfer.positions, (0.0, 1.0, 0.35), aspect=1.0)
    seen = preview.Still(transfer.positions, transfer.faces, size=(240, 240), camera=camera)
    lamp = light.disc(direction, math.radians(5), 1.0, order, normalise=True).float()
    single = {"dtype": torch.float32}
    windowed = {
        "no window": lamp,
        "Lanczos": sh.window(lamp, sh.lanczos(order, **single)),
        "Hann": sh.window(lamp, sh.hann(order, **single)),
        "least": sh.least_window(lamp)[0],
    }
    table = sh.basis(sh.latlong_directions(120, 240, dtype=torch.float32), order)
    peak = float((table @ lamp).max())
    lights, shadows, labels = [], [], []
    for name, each in windowed.items():
        value = (table @ each)[..., 0] / peak
        above, below = value.clamp(min=0), -5 * value.clamp(max=0)
        lights.append(display(torch.stack([above, above, above + below], -1), tone="none"))
        shadows.append(seen.picture(shaded(transfer, each), tone="none", exposure=0.5))
        labels.append(f"{name}: least {round(100 * float(value.min()))} % of the peak")
    return torch.cat([preview.sheet(lights, labels, 4), preview.sheet(shadows, list(windowed), 4)])


def ringing_sun() -> Tensor:
    """A sun over the sculpture at two orders, without a window and under auto; blue is negative radiance."""
    sculpture = samples.organic(20_000).objects[0].mesh
    scene = Scene([Object(sculpture, Material(0.7)), Object(ground(80), Material((0.75, 0.42, 0.25)))])
    whole = bake(scene, order=10, rays=1024, progress=False)
    size = (380, 330)
    camera = preview.frame(sculpture.positions, (0.35, 0.6, 1.0), aspect=size[0] / size[1])
    seen = preview.Still(whole.positions, whole.faces, size=size, camera=camera, samples=9)
    pictures, labels = [], []
    for order in (5, 10):
        lamp = light.disc((0.9, 0.75, 0.1), math.radians(2), 1.0, order, normalise=True) + light.constant(0.02, order)
        for name in ("none", "auto"):
            radiance = shaded(whole.to_order(order), windowed_by(lamp.float(), name))
            share = float((radiance < 0).any(-1).double().mean())
            blue = torch.tensor([0.0, 0.0, -8.0]) * radiance.clamp(max=0)
            pictures.append(seen.picture(radiance.clamp(min=0) + blue, exposure=0.2))
            labels.append(f"order {order}, {name}: {share:.1%} of the vertices negative")
    return preview.sheet(pictures, labels, columns=2)


def seen_from(transfer: Transfer, lamps: Tensor, camera: preview.Camera) -> Tensor:
    """Radiance of a glossy bake toward a camera."""
    with torch.no_grad():
        return shader(transfer)(lamps, eye=torch.tensor(camera.eye))


def windowed(lamp: Tensor, order: int) -> Tensor:
    """A light of float64 coefficients that rings less."""
    return sh.window(lamp.float(), sh.lanczos(order, dtype=torch.float32))


def teapot() -> Tensor:
    """Copper under one lamp: unshadowed, with the shadows of knob and spout, and with the spout in the body."""
    order, size = 8, (420, 290)
    copper = Material(0.06, gloss="ggx:0.2", specular=(0.9, 0.62, 0.5))
    scene = samples.teapot(40_000, copper)
    options: dict[str, Any] = {"order": order, "rays": 512, "progress": False}
    bakes = [bake(scene, **options, shadows=False), bake(scene, **options), bake(scene, **options, bounces=1)]
    lamp = light.disc((-0.8, 0.75, -0.25), math.radians(14), (1.0, 0.8, 0.6), order, normalise=True)
    sky = light.hemisphere((0.0, 1.0, 0.0), (0.05, 0.08, 0.13), 0.0, order)
    lamps = windowed(lamp + sky, order)
    points, faces = bakes[0].positions, bakes[0].faces
    camera = preview.frame(points, (0.7, 0.9, 1.0), aspect=size[0] / size[1], field=25.0)
    still = preview.Still(points, faces, size=size, camera=camera, samples=9)
    radiance = [seen_from(each, lamps, camera) for each in bakes]
    radiance.append(4 * (radiance[2] - radiance[1]).clamp(min=0))
    labels = ["unshadowed", "shadows", "shadows and one bounce", "what the bounce adds, four times as bright"]
    pictures = [still.picture(each, exposure=0.5, background=0.01) for each in radiance]
    return preview.sheet(pictures, labels, columns=2)


def streaks() -> Tensor:
    """A brushed dish: highlights that follow the tangents around, lie across them, or do neither."""
    order, size = 8, (340, 300)
    materials = {
        "ward:0.12,0.5, brushed around": "ward:0.12,0.5",
        "ward:0.5,0.12, brushed outward": "ward:0.5,0.12",
        "ward:0.25,0.25, polished": "ward:0.25,0.25",
    }
    lamp = light.disc((1.0, 0.9, -0.45), math.radians(15), (1.0, 0.85, 0.6), order, normalise=True)
    pictures = []
    for material in materials.values():
        transfer = bake(samples.dish(120, material), order=order, rays=512, progress=False)
        camera = preview.frame(transfer.positions, (0.0, 1.0, 0.45), aspect=size[0] / size[1], field=25.0)
        still = preview.Still(transfer.positions, transfer.faces, size=size, camera=camera, samples=9)
        radiance = seen_from(transfer, windowed(lamp, order), camera)
        # Highlights of different size have different peaks: each fills the range of the picture.
        peak = float(still.radiance(radiance, 0.0).quantile(0.99))
        pictures.append(still.picture(radiance / peak, background=0.01))
    return preview.sheet(pictures, list(materials), columns=3)


def projections() -> Tensor:
    """The exit functions of three projections on one teapot, and what each gets wrong."""
    order, size, most = 5, (340, 240), 12
    scene = samples.teapot(12_000, "ggx:0.4")
    turn = sh.yaw_pitch_roll(torch.tensor([-20.0, 0.0, 0.0]))
    lamps, _ = sh.least_window(sh.rotate(light.project(light.studio(256), order), turn))
    options: dict[str, Any] = {"order": order, "rays": 512, "progress": False}
    reference = bake(scene, **options, output_order=most)
    camera = preview.frame(reference.positions, (0.5, 0.45, 1.0), aspect=size[0] / size[1], field=25.0)
    still = preview.Still(reference.positions, reference.faces, size=size, camera=camera, samples=9)
    wanted = seen_from(reference, lamps, camera)
    shown = still.radiance(wanted, 0.0)
    scale, exposure = float(shown.square().mean().sqrt()), -math.log2(float(shown.quantile(0.99))) - 0.3
    pictures, maps, labels, errors = [], [], [], []
    for rows, projection in ((25, "zero"), (25, "optimal"), (16, "optimal")):
        found = bake(scene, **options, output_order=math.isqrt(rows), projection=projection)
        radiance = seen_from(found, lamps, camera)
        error = still.radiance(radiance - wanted, 0.0)
        pictures.append(still.picture(radiance, exposure=exposure, background=0.01))
        maps.append(1 - display(error.abs().mean(-1, keepdim=True).expand(-1, -1, 3) / scale, tone="none"))
        labels.append(f"{rows} rows, projection '{projection}'")
        errors.append(f"error {float(error.square().mean().sqrt()) / scale:.1%} (RMS; black is 100 %)")
    return torch.cat([preview.sheet(pictures, labels, 3), preview.sheet(maps, errors, 3)])


@functools.cache
def brushed() -> Transfer:
    """A brushed teapot: exit matrices for compression."""
    with warnings.catch_warnings():
        # The smooth field of tangents is what is asked for.
        warnings.simplefilter("ignore", TangentWarning)
        scene = samples.teapot(30_000, Material(0.03, gloss="ward:0.2,0.4", specular=(1.0, 0.85, 0.65)))
        return bake(scene, order=5, rays=512, progress=False)


def packed(**options: Any) -> tuple[Transfer, Clustered]:
    """The brushed teapot compressed, and the signal of that."""
    made = compress(brushed(), layer="exit", **options)
    signal = made.layers["exit"].signal
    assert isinstance(signal, Clustered)
    return made, signal


def teapot_still(size: tuple[int, int]) -> tuple[preview.Still, preview.Camera]:
    camera = preview.frame(brushed().positions, (0.5, 0.5, 1.0), aspect=size[0] / size[1], field=25.0)
    return preview.Still(brushed().positions, brushed().faces, size=size, camera=camera, samples=9), camera


def clusters() -> Tensor:
    """Exit matrices by plain PCA, plain vector quantisation and clustered PCA, all for the time of a frame."""
    still, camera = teapot_still((400, 270))
    turn = sh.yaw_pitch_roll(torch.tensor([-20.0, 0.0, 0.0]))
    lamps, _ = sh.least_window(sh.rotate(light.project(light.studio(256), 5), turn))
    sizes: dict[str, dict[str, Any]] = {
        "plain PCA, 20 vectors": {"clusters": 1, "components": 20, "method": "pca"},
        "vector quantisation, 1792 clusters": {"clusters": 1792, "components": 0, "method": "vq"},
        "clustered PCA, 256 clusters of 8": {"clusters": 256, "components": 8},
    }
    found: list[Transfer] = []
    labels = []
    for name, size in sizes.items():
        made, signal = packed(**size)
        found.append(made)
        labels.append(f"{name}: error {signal.compression_error:.1%}")
    radiance = [seen_from(each, lamps, camera) for each in [*found, brushed()]]
    exposure = -math.log2(float(still.radiance(radiance[-1], 0.0).quantile(0.99))) - 0.3
    pictures = [still.picture(each, exposure=exposure, background=0.01) for each in radiance]
    return preview.sheet(pictures, [*labels, "uncompressed"], columns=2)


def clusters_error() -> Tensor:
    """Squared error of every vertex with 256 clusters of 8 PCA vectors, by method, on one scale."""
    still, _ = teapot_still((340, 240))
    methods = ("static", "iterative", "adaptive")
    found = [packed(clusters=256, components=8, method=method)[1] for method in methods]
    most = float(found[0].squared_error.quantile(0.98))
    maps = [still.radiance(preview.error_colours(each.squared_error, most), background=1.0) for each in found]
    labels = [f"{method}: error {each.compression_error:.1%}" for method, each in zip(methods, found, strict=True)]
    return preview.sheet(maps, labels, columns=3)


def lamp() -> plt.Figure:
    """A lamp toward (+x, a little up, a little front), as latitude-longitude map and as cube."""
    lamps = {
        "+x": ((1, 0.25, 0.3), (1.0, 0.25, 0.2)),
        "+y": ((0.1, 1, 0), (0.9, 0.8, 0.2)),
        "-z": ((0, 0, -1), (0.2, 0.5, 1.0)),
    }

    def scene(directions: Tensor) -> Tensor:
        directions = torch.nn.functional.normalize(directions.float(), dim=-1)
        picture = torch.full(directions.shape, 0.12)
        picture[directions[..., 1] < 0] = 0.04
        for middle, colour in lamps.values():
            axis = torch.nn.functional.normalize(torch.tensor([float(v) for v in middle]), dim=0)
            picture[directions @ axis > math.cos(math.radians(14))] = torch.tensor(colour)
        return picture

    figure = plt.figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    left.imshow(display(scene(sh.latlong_directions(180, 360)), tone="none"), extent=(0, 360, 180, 0))
    left.set_xticks([0, 90, 180, 270, 360], ["+z", "-x", "-z", "+x", "+z"])
    left.set_yticks([0, 90, 180], ["+y", "horizon", "-y"])
    left.set_title("latitude-longitude [H, 2H, 3]: row 0 is up, the middle looks along -z", fontsize=10)
    faces = display(scene(sh.cube_directions(90)), tone="none")
    # The unfolded cross as it is usually drawn; each face as it lies in memory.
    places = {"+x": (1, 2), "-x": (1, 0), "+y": (0, 1), "-y": (2, 1), "+z": (1, 1), "-z": (1, 3)}
    cross = torch.ones(3 * 90, 4 * 90, 3)
    for number, (name, (row, column)) in enumerate(places.items()):
        cross[90 * row : 90 * row + 90, 90 * column : 90 * column + 90] = faces[number]
        right.text(90 * column + 5, 90 * row + 14, f"{number}: {name}", color="white", fontsize=9)
    right.imshow(cross)
    right.axis("off")
    right.set_title("cube map [6, H, W, 3]: each face as it lies in memory", fontsize=10)
    return figure


def basis() -> plt.Figure:
    """|y_lm| as lobes, order 3, on the axes; warm where positive, cool where negative."""
    # matplotlib shades a face by its first corners, which must not all be the pole.
    theta = torch.linspace(0.01, math.pi - 0.01, 61, dtype=torch.float64)
    phi = torch.linspace(0, 2 * math.pi, 91, dtype=torch.float64)
    t, p = torch.meshgrid(theta, phi, indexing="ij")
    directions = torch.stack([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()], -1)
    values = sh.basis(directions, 3)
    figure = plt.figure(figsize=(11, 7.2))
    names = ["", "-y", "+z", "-x", "+xy", "-yz", "3z²-1", "-xz", "x²-y²"]
    for index in range(9):
        band = math.isqrt(index)
        m = index - band * (band + 1)
        plot = figure.add_subplot(3, 5, 5 * band + 3 + m, projection="3d")
        lobe = values[..., index].abs()[..., None] * directions
        # y is up in the world, and matplotlib's third axis is up on the page.
        x, y, z = lobe.unbind(-1)
        positive = values[..., index] >= 0
        colours = [[WARM if one else COOL for one in row] for row in positive[:-1, :-1].tolist()]
        plot.plot_surface(z, x, y, facecolors=colours, rstride=1, cstride=1, linewidth=0, antialiased=False)
        reach = 0.7
        for axis, name in (((1, 0, 0), "z"), ((0, 1, 0), "x"), ((0, 0, 1), "y")):
            plot.plot(*[(-reach * v, reach * v) for v in axis], color="#888888", linewidth=0.8)
            plot.text(*[1.12 * reach * v for v in axis], name, fontsize=9, ha="center", va="center")
        plot.set(xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), zlim=(-0.6, 0.6))
        plot.set_box_aspect((1, 1, 1), zoom=1.2)
        plot.view_init(elev=22, azim=35)
        plot.set_axis_off()
        title = f"{index}: $y_{{{band},{m}}}$" + (f"  ({names[index]})" if names[index] else "")
        plot.text2D(0.5, -0.02, title, fontsize=10, ha="center", transform=plot.transAxes)
    figure.subplots_adjust(left=0, right=1, top=0.98, bottom=0.05, wspace=0, hspace=0.1)
    return figure


def place_of(transfer: Transfer, camera: preview.Camera, x: float, y: float) -> int:
    """The vertex that is seen at these shares of a square picture, from its upper left corner."""
    ray = camera.through(torch.tensor([[x]]).double(), torch.tensor([[y]]).double(), 1, 1)
    hit = Tracer(transfer.positions, transfer.faces).camera(torch.tensor(camera.eye).double(), ray)
    return int(transfer.faces[int(hit.triangle), 0])


def with_lobe(
    transfer: Transfer, vertex: int, colours: Tensor, camera: preview.Camera, size: int, reach: float
) -> Tensor:
    """The model in sRGB colours, and the transfer function of a vertex upon it, one to `reach` units of length."""
    coefficients = vectors(transfer, vertex)
    directions, _ = sphere(96)
    largest = float((sh.basis(directions, transfer.order) @ coefficients.double()).abs().max())
    function = preview.lobe(coefficients, transfer.positions[vertex].double(), reach * largest, rings=96)
    assert function is not None
    positions = torch.cat([transfer.positions.double(), function.positions])
    faces = torch.cat([transfer.faces.long(), function.faces + transfer.vertices])
    still = preview.Still(positions, faces, size=(size, size), camera=camera, samples=9)
    return still.radiance(torch.cat([colours.double(), function.colours]), background=0.27)


def fisheye(size: int) -> tuple[Tensor, Tensor]:
    """Local directions of an equidistant picture of the hemisphere, and where it has any."""
    ticks = (2 * (torch.arange(size, dtype=torch.float64) + 0.5) / size - 1) * 1.02
    y, x = torch.meshgrid(-ticks, ticks, indexing="ij")
    radius = torch.hypot(x, y)
    angle = radius * math.pi / 2
    directions = torch.stack([x / radius * angle.sin(), y / radius * angle.sin(), angle.cos()], -1)
    return directions, radius < 1


def signed(values: Tensor, inside: Tensor) -> Tensor:
    """White where a function is one, blue where it is negative, paper outside."""
    above, below = values.clamp(0, 1), -4 * values.clamp(max=0)
    shown = display(torch.stack([above, above, above + below], -1).float(), tone="none")
    return torch.where(inside[..., None], shown, 1.0)


def transfer_functions() -> Tensor:
    """What a vertex makes of light: as lobes on the model, and as pictures of its hemisphere."""
    size = 330
    shadowed, bounced = staged(0), staged(3)
    plain = bake(stage(), shadows=False, progress=False)
    shape = stage().objects[0].mesh.positions
    camera = preview.frame(shape, (0.35, 0.45, 1.0), aspect=1.0)
    vertex = place_of(shadowed, camera, 0.30, 0.92)
    lamps = light.project(light.studio(256), 5)
    colours = display(0.9 * shaded(bounced, lamps), exposure=EXPOSURE)
    named = {"unshadowed": plain, "shadowed": shadowed, "interreflected": bounced}
    lobes = [with_lobe(each, vertex, colours, camera, size, 2.2) for each in named.values()]
    # The frame of the picture: up is away from the camera, as far as the surface allows.
    normal = shadowed.normals[vertex].double()
    forward, _, _ = camera.axes()
    up = torch.nn.functional.normalize(forward - (forward @ normal) * normal, dim=0)
    frame = torch.stack([torch.linalg.cross(up, normal), up, normal])
    directions, inside = fisheye(size)
    tracer = Tracer(shadowed.positions, shadowed.faces)
    origin = tracer.origins(shadowed.positions[vertex : vertex + 1], normal[None], 0.05)
    seen = tracer.visibility(origin, frame[None].float(), directions.reshape(-1, 3).float())
    visible = (seen.view(size, size) != 0).double()
    cosine = directions[..., 2].clamp(min=0)
    table = sh.basis(directions @ frame, 5)
    held = [math.pi * (table @ vectors(each, vertex).double()) for each in (shadowed, bounced)]
    maps = [signed(each, inside) for each in (cosine * visible, *held)]
    below = ["what it sees, times the cosine", "shadowed, in 25 coefficients", "interreflected, in 25 coefficients"]
    return torch.cat([preview.sheet(lobes, list(named), 3), preview.sheet(maps, below, 3)])


def projected() -> Tensor:
    """An environment and what is left of it by order, plain and under a window; blue is negative."""
    environment = light.studio(256)
    height = 110
    small = torch.nn.functional.interpolate(environment.movedim(-1, 0)[None], (height, 2 * height), mode="area")
    photograph = small[0].movedim(0, -1)
    directions = sh.latlong_directions(height, 2 * height, dtype=torch.float32)
    exposure = -2.6

    def shown(lamps: Tensor) -> Tensor:
        value = sh.basis(directions, math.isqrt(len(lamps))) @ lamps
        below = -value.mean(-1, keepdim=True).clamp(max=0)
        return display(value.clamp(min=0) * (below == 0) + below * torch.tensor([0.1, 0.3, 1.5]), exposure=exposure)

    rows = []
    for name in ("none", "hann"):
        pictures, labels = [display(photograph, exposure=exposure)], ["the environment"]
        for order in (2, 3, 5, 10):
            lamps = light.project(environment, order)
            pictures.append(shown(windowed_by(lamps, name)))
            labels.append(f"order {order}" + (", Hann" if name == "hann" else ""))
        rows.append(preview.sheet(pictures, labels, 5))
    return torch.cat(rows)


def window() -> Tensor:
    """The window of `torchprt preview` on the stage, the environment behind and a transfer function picked."""
    from torchprt.preview.window import Window

    environment = light.studio(512)
    lights = [preview.Environment("studio", light.project(environment, 5), environment)]
    session = preview.Session({"stage": staged(0), "stage_bounces": staged(3)}, lights)
    session.next_bake()
    session.next_backdrop()
    session.turn_camera(0.2, -0.05)
    session.turn_light(-1.1, 0.25)
    session.zoom(4)
    camera = preview.frame(stage().objects[0].mesh.positions, (0.35, 0.45, 1.0), aspect=1.0)
    session.picked = place_of(staged(0), camera, 0.30, 0.92)
    opened = Window(preview.check_window(), session, (900, 640), "torchprt", FOLDER, print)
    for _ in range(4):
        opened.step()
    shown = torch.from_numpy(np.asarray(opened.viewer.capture_screen_float_buffer(do_render=True)).copy())
    opened.close()
    return shown


PICTURES = {
    "painted": painted,
    "sight": sight,
    "transport": transport,
    "bleeding": demo.bleeding,
    "orders": demo.orders,
    "ringing": ringing,
    "ringing_sun": ringing_sun,
    "projected": projected,
    "transfer_functions": transfer_functions,
    "window": window,
    "teapot": teapot,
    "streaks": streaks,
    "projections": projections,
    "clusters": clusters,
    "clusters_error": clusters_error,
    "basis": basis,
    "lamp": lamp,
}


def main(names: list[str]) -> None:
    unknown = sorted(set(names) - set(PICTURES))
    if unknown:
        sys.exit(f"there is no picture {unknown[0]}: choose from {' '.join(PICTURES)}")
    FOLDER.mkdir(exist_ok=True)
    for name in names or PICTURES:
        path, picture = FOLDER / f"{name}.png", PICTURES[name]()
        if isinstance(picture, Tensor):
            preview.save_png(picture, path)
        else:
            picture.savefig(path, dpi=100, metadata={"Software": None})
            plt.close(picture)
        Image.open(path).convert("RGB").save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])

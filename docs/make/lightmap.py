"""Writes the pictures of docs/lightmaps.md.

    python docs/make/lightmap.py [NAME ...]

All of them without a name: "room", "lights", "noise". The bake of the room takes some minutes and is kept in a folder
for temporary files.
"""

from __future__ import annotations

import functools
import math
import sys
import tempfile
import time
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchprt import light, load_transfer, preview, save_transfer, sh
from torchprt.light import project, windowed
from torchprt.scene import Lightmap, Scene, samples
from torchprt.shade import shader
from torchprt.trace import Tracer
from torchprt.transfer import Transfer
from torchprt.transport import bake

FOLDER = Path(__file__).parents[1] / "images"
KEPT = Path(tempfile.gettempdir()) / "torchprt-room"
ORDER, TEXELS, RAYS, GUTTER = 10, 512, 1536, 2
COARSE = 320
CAMERA = preview.Camera((1.95, 1.55, 2.6), (-0.55, 0.95, -1.2), (0.0, 1.0, 0.0), 58.0)
FLOOR = preview.Camera((0.9, 1.5, 1.5), (-0.75, 0.15, -0.6), (0.0, 1.0, 0.0), 50.0)
EXPOSURE = 2.2


@functools.cache
def room(texels: int = TEXELS) -> Scene:
    return samples.room(texels, GUTTER)


@functools.cache
def baked(bounces: float = math.inf, rays: int = RAYS, texels: int = TEXELS) -> Transfer:
    path = KEPT / f"{texels}-{ORDER}-{rays}-{bounces:g}.safetensors"
    if path.exists():
        return load_transfer(path)
    start = time.perf_counter()
    on = Lightmap(size=texels, gutter=GUTTER, uv=0)
    found = bake(room(texels), order=ORDER, rays=rays, bounces=bounces, lightmap=on, progress=False)
    print(f"{found}, {time.perf_counter() - start:.0f} s")
    KEPT.mkdir(exist_ok=True)
    save_transfer(found, path)
    return found


def day(name: str, elevation: float, azimuth: float, strength: float = 1.0) -> preview.Environment:
    """A clear sky and its sun, a disc of 8 degrees, as high as `elevation` and from where `azimuth` says, from -x
    toward +z, in degrees; with the ground that they light."""
    high, around = math.radians(elevation), math.radians(azimuth)
    level = math.cos(high)
    toward = torch.tensor([-level * math.cos(around), math.sin(high), level * math.sin(around)], dtype=torch.float64)
    directions = sh.latlong_directions(256, 512)
    sky = light.clear_sky_radiance(directions.reshape(-1, 3), toward, 3.0).reshape(256, 512, 3)
    sun = light.sun_radiance(torch.tensor(math.pi / 2 - high, dtype=torch.float64), 3.0)
    disc = strength * sun * (math.sin(math.radians(0.2665)) / math.sin(math.radians(8))) ** 2
    above = directions[..., 1:2] > 0
    radiance = sky + torch.where((directions @ toward > math.cos(math.radians(8)))[..., None] & above, disc, 0.0)
    weights = sh.latlong_weights(256, 512)[..., None] * directions[..., 1:2].clamp(min=0)
    ground = 0.2 / math.pi * (radiance * weights).sum((0, 1))
    image = torch.where(above, radiance, ground).float()
    image = image / image[..., 1].mean()
    return preview.Environment(name, windowed(project(image, ORDER), "least"), image)


def lights() -> dict[str, preview.Environment]:
    overcast = preview.built_in_environment("overcast", ORDER)
    return {
        "sun at 33 degrees": day("sun", 33, 28),
        "low sun": day("low sun", 12, -30),
        "overcast": preview.Environment("overcast", 2.2 * overcast.light, 2.2 * overcast.image),
    }


def picture(
    transfer: Transfer, under: preview.Environment, size: tuple[int, int], exposure: float = EXPOSURE
) -> Tensor:
    studio = preview.Studio(
        *(transfer, shader(transfer), under),
        size=size,
        samples=9,
        exposure=exposure,
        tone="agx",
        background="environment",
    )
    return studio.picture(CAMERA, torch.eye(3))


def hero() -> None:
    """The room, and its map."""
    under = lights()["sun at 33 degrees"]
    preview.save_png(picture(baked(), under, (960, 640)), FOLDER / "lightmap.png")
    with torch.no_grad():
        radiance = shader(baked())(under.light)
    preview.save_map(baked().receivers, radiance, FOLDER / "lightmap_map.png", exposure=EXPOSURE, tone="agx")


def several() -> None:
    """One bake under three lights."""
    found = lights()
    pictures = [picture(baked(), each, (400, 300)) for each in found.values()]
    preview.save_png(preview.sheet(pictures, list(found), columns=3), FOLDER / "lightmap_lights.png")


def noise() -> None:
    """64 and 512 rays a texel, the same for all, and 64 drawn for each, beside 2048."""
    few, some, many = (baked(0, rays, COARSE) for rays in (64, 512, 2048))
    under = lights()["sun at 33 degrees"].light
    with torch.no_grad():
        found = {"64 rays, the same for all": shader(few)(under), "64 rays, random for each": drawn(few, under, 64)}
        found["512 rays, the same for all"] = shader(some)(under)
        found["2048 rays"] = shader(many)(under)
    wanted = found["2048 rays"]
    for name, radiance in found.items():
        print(
            f"{name}: RMS error {float((radiance - wanted).square().mean().sqrt() / wanted.square().mean().sqrt()):.1%}"
        )
    still = preview.Still.of(few.receivers, size=(400, 300), camera=FLOOR, samples=9)
    pictures = [still.picture(each.float(), exposure=EXPOSURE + 0.6, tone="agx") for each in found.values()]
    preview.save_png(preview.sheet(pictures, list(found), columns=2), FOLDER / "lightmap_noise.png")


def drawn(transfer: Transfer, under: Tensor, rays: int) -> Tensor:
    """Direct light by as many rays a texel, each with its own of cosine density, as path tracers have them."""
    generator = torch.Generator().manual_seed(0)
    geometry = room(COARSE).geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    place = transfer.receivers
    normals = place.normals.double()
    origins = tracer.origins(place.positions, normals, 0.02)
    total = torch.zeros(place.count, 3)
    up = torch.tensor([[0.0, 0.0, 1.0]])
    for _ in range(rays):
        # A point of the unit sphere on top of the normal: cosine density about that.
        ball = normalize(torch.randn(place.count, 3, generator=generator, dtype=torch.float64), dim=-1)
        toward = normalize(normals + 0.9999 * ball, dim=-1)
        aside = torch.where(toward[:, :1].abs() < 0.7, torch.tensor([1.0, 0, 0]), torch.tensor([0, 1.0, 0])).double()
        tangent = normalize(torch.linalg.cross(aside, toward), dim=-1)
        frames = torch.stack([tangent, torch.linalg.cross(toward, tangent), toward], 1).float()
        open_ = tracer.visibility(origins, frames, up)[:, 0] > 0
        total += open_[:, None] * (sh.basis(toward.float(), ORDER) @ under)
    return transfer.albedo * total / rays


MADE = {"room": hero, "lights": several, "noise": noise}


def main() -> None:
    for name in sys.argv[1:] or MADE:
        MADE[name]()
        print(name)


if __name__ == "__main__":
    main()

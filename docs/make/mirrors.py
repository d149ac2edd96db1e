"""Writes the pictures of docs/mirrors.md and prints its tables.

    python docs/make/mirrors.py [NAME ...]

All of them without a name: "ring", "turning" (an animation), "path_tracer" (needs Mitsuba).
"""

from __future__ import annotations

import functools
import sys
import time
from pathlib import Path

import torch
from PIL import Image

from torchprt import light, preview, sh
from torchprt.light import windowed
from torchprt.preview.error_colours import error_colours
from torchprt.scene import Scene, mirror_of, samples
from torchprt.shade import display, shader
from torchprt.transfer import Transfer
from torchprt.transport import bake

FOLDER = Path(__file__).parents[1] / "images"
SIZE = (560, 400)
VIEW = (0.25, 0.85, 1.0)
ORDER = 8


@functools.cache
def baked(resolution: int = 256, order: int = ORDER, rays: int = 4096) -> Transfer:
    """The ring of the 2002 paper's figure 9, in gold."""
    start = time.process_time()
    found = bake(samples.ring_on_plane(resolution), order=order, rays=rays, bounces="auto", progress=False)
    print(f"{found}, {time.process_time() - start:.0f} s of CPU, cut off {found.cut:.1e}")
    return found


def environment(name: str, order: int = ORDER) -> preview.Environment:
    image = light.built_in(name, 256)
    return preview.Environment(name, windowed(light.project(image, order), "least"), image)


def studio(transfer: Transfer, lit: preview.Environment, size: tuple[int, int] = SIZE, **options) -> preview.Studio:
    return preview.Studio(transfer, shader(transfer), lit, size=size, samples=9, **options)


def camera(transfer: Transfer, size: tuple[int, int] = SIZE) -> preview.Camera:
    return preview.frame(transfer.positions, VIEW, aspect=size[0] / size[1], distance=4.6, target=(0.0, 0.1, 0.0))


def yaw(degrees: float) -> torch.Tensor:
    return sh.yaw_pitch_roll(torch.tensor([degrees, 0.0, 0.0]))


def ring() -> None:
    """Two turns of one environment, as figure 9."""
    transfer = baked()
    lit = environment("studio")
    shown = studio(transfer, lit, background="environment", exposure=preview.automatic_exposure(lit.light) + 0.2)
    pictures = [shown.picture(camera(transfer), yaw(turn)) for turn in (40.0, 220.0)]
    save(torch.cat([pictures[0], torch.ones(SIZE[1], 8, 3), pictures[1]], 1), "ring.png")


def turning() -> None:
    """The environment goes around once."""
    size = (360, 256)
    transfer = baked()
    lit = environment("studio")
    shown = studio(transfer, lit, size, exposure=preview.automatic_exposure(lit.light) + 0.2)
    pictures = list(shown.light_turntable(30, camera(transfer, size), yaw(40.0)))
    preview.save_movie(pictures, FOLDER / "ring.webp", 12.0)
    print(f"ring.webp: {(FOLDER / 'ring.webp').stat().st_size / 1024:.0f} kB")


def path_tracer() -> None:
    """One light, ours beside Mitsuba's path tracer, and where they differ."""
    import mitsuba as mi
    import numpy as np

    sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
    from path_tracer import scene, variant

    if fault := variant(mi):
        raise SystemExit(fault)
    plane = samples.ring_on_plane(256).objects[0]
    # A mirror that reflects all light: a metal's Fresnel is another formula there.
    shiny = Scene([plane, mirror_of(samples.ring(256))])
    transfer = bake(shiny, order=ORDER, rays=4096, bounces=6, progress=False)
    lamp = light.disc((0.75, 0.75, 0.2), 0.45, 6.0, ORDER)
    lit = sh.window(lamp + light.constant(0.35, ORDER), sh.hann(2 * ORDER)[:ORDER]).float()
    size = (420, 300)
    view = camera(transfer, size)
    eye = torch.tensor(view.eye, dtype=torch.float64)
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7] * 3}}
    world = scene(mi, shiny.geometry(), lit.double(), white, {"type": "conductor"})
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": view.field,
            "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(origin=view.eye, target=view.target, up=view.up),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}},
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": 12, "rr_depth": 64})
    start = time.perf_counter()
    theirs = torch.from_numpy(np.array(mi.render(world, integrator=integrator, sensor=sensor, spp=400))[..., :3])
    traced = time.perf_counter() - start
    around = preview.environment.photograph(lit, 512)
    still = preview.Still(
        transfer.positions, transfer.faces, size=size, camera=view, samples=9, mirrors=transfer.receivers.mirrors
    )
    start = time.perf_counter()
    radiance = shader(transfer)(lit)
    shaded = time.perf_counter() - start
    sky = preview.environment.seen_along(around, still.sky).float()
    behind = preview.environment.seen_along(around, view.directions(*size)).float()
    ours = still.radiance(radiance, behind, sky)
    from_above = (still.coverage > 0.999)[..., None]
    error = torch.where(from_above, ours - theirs, 0)
    size_of = float((theirs * from_above).square().mean().sqrt())
    # Blocks of pixels: what is left is less the noise of the paths.
    blurred = torch.nn.functional.avg_pool2d(error.movedim(-1, 0)[None], 5, 1, 2)[0].movedim(0, -1)
    alone, together = (float(each.square().mean().sqrt()) / size_of for each in (error, blurred))
    print(f"RMS difference of what is not sky: {alone:.2%} a pixel, {together:.2%} over 5 x 5 pixels")
    print(
        f"path tracer {traced:.1f} s, {shaded * 1e3:.1f} ms for all {transfer.vertices} receivers; eye {eye.tolist()}"
    )
    exposure = preview.automatic_exposure(lit) + 0.2
    shown = [display(each.clamp(min=0), exposure=exposure) for each in (ours, theirs)]
    worst = 0.1 * size_of
    colours = error_colours(blurred.abs().mean(-1).flatten(), worst).view(*error.shape)
    labels = ["transfer", "path tracer, 400 paths a pixel", "difference over 5 x 5 pixels, red is 10 %"]
    save(preview.sheet([*shown, colours], labels, columns=3), "ring_path_tracer.png")


def save(picture: torch.Tensor, name: str) -> None:
    values = (picture.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    Image.fromarray(values).save(FOLDER / name, optimize=True)
    print(f"{name}: {(FOLDER / name).stat().st_size / 1024:.0f} kB")


MADE = {"ring": ring, "turning": turning, "path_tracer": path_tracer}

if __name__ == "__main__":
    for name in sys.argv[1:] or MADE:
        MADE[name]()

"""Writes the pictures of docs/volumes.md and prints its tables.

    python docs/make/volumes.py [NAME ...]

All of them without a name: "orientations", "phase", "path_tracer" (needs Mitsuba), "cost" (minutes).
"""

from __future__ import annotations

import functools
import math
import resource
import sys
import time
import warnings
from pathlib import Path

import torch
from PIL import Image

from torchprt import light, preview, sh
from torchprt.light import windowed
from torchprt.preview.error_colours import error_colours
from torchprt.scene import samples
from torchprt.shade import VolumeShader, display
from torchprt.transfer import Transfer
from torchprt.transport import VolumeWarning, bake_volume

FOLDER = Path(__file__).parents[1] / "images"
SIZE = (300, 230)
VIEW = (0.15, -0.3, 1.0)
ORDER = 6


@functools.cache
def baked(resolution: int, bounces: float | str, phase: float = 0.0, order: int = ORDER, rays: int = 4096) -> Transfer:
    start = time.process_time()
    cloud = samples.cloud(resolution, phase=phase)
    found = bake_volume(cloud, order=order, rays=rays, bounces=bounces, progress=False)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{resolution}^3, phase {phase}: {found}, {time.process_time() - start:.0f} s of CPU, {most:.1f} GB so far")
    return found


def orientations() -> None:
    """One light from three sides, scattered once and as often as it is."""
    image = light.built_in("sunset", 256)
    lit = preview.Environment("sunset", windowed(light.project(image, ORDER), "least"), image)
    pictures = []
    for bounces in (0, "auto"):
        transfer = baked(64, bounces)
        studio = preview.VolumeStudio(
            transfer,
            lit,
            size=SIZE,
            samples=4,
            background="environment",
            exposure=preview.automatic_exposure(lit.light) - 0.2,
        )
        view = preview.frame(transfer.positions, VIEW, aspect=SIZE[0] / SIZE[1])
        pictures += [studio.picture(view, yaw(degrees)) for degrees in (-24.0, 50.0, 146.0)]
    labels = [f"{passes}, sun {side}" for passes in ("one pass", "all passes") for side in SIDES]
    save(preview.sheet(pictures, labels, columns=3), "cloud.png")


SIDES = ("behind the camera", "to the right", "behind the cloud")


def phase() -> None:
    """Forward scattering makes the rim of a cloud before the sun bright."""
    sun = sh.window(light.disc((0.25, 0.3, -1.0), 0.2, 60.0, ORDER), sh.hann(2 * ORDER)[:ORDER])
    lit = preview.Environment("sun", (sun + light.constant((0.25, 0.35, 0.5), ORDER)).float())
    pictures = []
    for cosine in (0.0, 0.5, 0.85):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VolumeWarning)
            transfer = baked(40, "auto", cosine)
        studio = preview.VolumeStudio(transfer, lit, size=SIZE, samples=4, exposure=-0.7)
        pictures.append(studio.picture(preview.frame(transfer.positions, VIEW, aspect=SIZE[0] / SIZE[1]), yaw(0.0)))
    save(preview.sheet(pictures, [f"mean cosine {each}" for each in (0, 0.5, 0.85)], columns=3), "cloud_phase.png")


def path_tracer() -> None:
    """Beside Mitsuba's volumetric path tracer, in one light of order 5."""
    import mitsuba as mi

    sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
    from path_tracer import positive_light, through_volume, variant

    if fault := variant(mi):
        raise SystemExit(fault)
    lit, size, eye = positive_light(), (100, 80), torch.tensor([2.2, 1.0, 2.8], dtype=torch.float64)
    for cosine in (0.0, 0.5, 0.85, 0.95):
        cloud = samples.cloud(32, phase=cosine)
        transfer = baked(32, math.inf, cosine, order=5)
        module = VolumeShader(transfer, size=size, field=34.0, dtype=torch.float64)
        seen = module(lit, eye=eye)
        directions = preview.Camera(eye.tolist(), tuple(module.target.tolist()), field=34.0).directions(*size)
        directions = torch.nn.functional.normalize(directions.double(), dim=-1)
        behind = sh.basis(directions, 5) @ lit
        ours = seen[..., :3] + (1 - seen[..., 3:]) * behind
        start = time.perf_counter()
        theirs, noise = through_volume(mi, cloud, lit, eye, directions.flatten(0, 1), 1024)
        spent = time.perf_counter() - start
        theirs, noise = theirs.view(*ours.shape), noise.view(*ours.shape)
        inside = seen[..., 3] > 0.01
        whole, off, chance = (float(each[inside].square().mean().sqrt()) for each in (theirs, ours - theirs, noise))
        left = math.sqrt(max(off**2 - chance**2, 0.0))
        print(
            f"mean cosine {cosine}: RMS difference {off / whole:.2%}, of which the paths' noise is {chance / whole:.2%}"
            f", the rest {left / whole:.2%}; path tracer {spent:.0f} s"
        )
        if cosine == 0:
            exposure = preview.automatic_exposure(lit.float())
            shown = [display(each.float().clamp(min=0), exposure=exposure) for each in (ours, theirs)]
            error = ((ours - theirs) * inside[..., None]).float().movedim(-1, 0)[None]
            blurred = torch.nn.functional.avg_pool2d(error, 5, 1, 2)[0].abs().mean(0)
            shown.append(error_colours(blurred.flatten(), 0.1 * whole).view(*ours.shape))
            larger = [each.repeat_interleave(3, 0).repeat_interleave(3, 1) for each in shown]
            labels = ["transfer", "path tracer, 1024 paths a pixel", "difference over 5 x 5 pixels, red is 10 %"]
            save(preview.sheet(larger, labels, columns=3), "cloud_path_tracer.png")


def cost() -> None:
    """What a bake costs, by cells and passes."""
    for resolution in (32, 64, 128):
        for bounces in (0, "auto"):
            baked(resolution, bounces, order=5)
    baked(32, math.inf, order=5)
    baked(32, "auto", 0.85, order=5)


def yaw(degrees: float) -> torch.Tensor:
    return sh.yaw_pitch_roll(torch.tensor([degrees, 0.0, 0.0]))


def save(picture: torch.Tensor, name: str) -> None:
    pixels = (picture.clamp(0, 1) * 255).round().to(torch.uint8)
    Image.fromarray(pixels.numpy()).save(FOLDER / name, optimize=True)
    print(FOLDER / name)


MAKERS = {each.__name__: each for each in (orientations, phase, path_tracer, cost)}

if __name__ == "__main__":
    for name in sys.argv[1:] or MAKERS:
        MAKERS[name]()

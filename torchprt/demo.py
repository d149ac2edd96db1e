"""What the project does, shown on its own samples: bake, relight, export, and pictures of all of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from torchprt import light, preview, sh
from torchprt.files import make_folder
from torchprt.scene import Material, Object, Scene, samples
from torchprt.shade import display, local_light_shader, shader
from torchprt.transfer import Transfer, save
from torchprt.transport import bake, bake_neighbourhood, bake_volume
from torchprt.words import count

SIZE = (420, 420)
EXPOSURE = -1.7
"""Of the studio, as `preview.automatic_exposure` gives it."""
STONE = 0.6
BLUE = (0.38, 0.5, 0.68)
# Order of the glossy part: of the light, and toward the eye.
GLOSS = 6
# Vertices along an edge of the plane under the ring, nodes around the glider, cells along an edge of the cloud, squares
# along one of the land below it.
RING, NODES, CLOUD, LAND = 128, 1 << 14, 32, 96
Say = Callable[[str], None]


def run(folder: Path, say: Say = print) -> None:
    """Writes transfer, pictures, a lit model and ONNX graphs into `folder`; about three minutes of one core.

    Raises InputError if the folder cannot be made.
    """
    make_folder(folder)
    environment = light.studio(256)
    write_environment(environment, folder / "studio.exr")
    lamps = light.project(environment, 5)
    say("An environment of three soft boxes: studio.exr")

    sculpture = samples.organic(50_000, albedo=STONE)
    started = time.perf_counter()
    transfer = bake(sculpture, bounces=3)
    save(transfer, folder / "sculpture.safetensors")
    say(
        f"A sculpture of {count(transfer.vertices, 'vertex')} baked in {time.perf_counter() - started:.1f} s, "
        f"{transfer.bytes / 2**20:.1f} MB, Monte Carlo error {_relative_error(transfer):.2%}: sculpture.safetensors"
    )
    pictures = {
        "transport": transport(transfer, lamps),
        "turning": turning(transfer, environment),
        "orders": orders(),
        "bleeding": bleeding(),
    }
    for name, picture in pictures.items():
        preview.save_png(picture, folder / f"{name}.png")
    say("Unshadowed, shadowed, interreflected: transport.png")
    say("The environment turns, the light turns with it: turning.png")
    say("Shadows by order of the light, as figure 10 of the 2002 paper: orders.png")
    say("Light takes the colour of the walls along: bleeding.png")
    with torch.no_grad():
        radiance = shader(transfer)(lamps)
    preview.save_ply(transfer.positions, transfer.faces, preview.colours(radiance, EXPOSURE), folder / "sculpture.ply")
    say("The sculpture with its light as vertex colours, for any viewer: sculpture.ply")
    _export(transfer, folder / "sculpture.onnx", say)
    _gloss(environment, folder, say)
    _beyond(folder, transfer, say)
    say(f"To turn it with the mouse: torchprt export {folder / 'sculpture.safetensors'} -o page --web")


def _gloss(environment: Tensor, folder: Path, say: Say) -> None:
    """The glossy part of `run`."""
    lamps = light.project(environment, GLOSS)
    teapot = samples.teapot(10_000, Material(0.06, gloss="ggx:0.3", specular=0.8))
    shadowed = bake(teapot, order=GLOSS, rays=256, progress=False)
    started = time.perf_counter()
    transfer = bake(teapot, order=GLOSS, rays=256, bounces=1)
    save(transfer, folder / "teapot.safetensors")
    say(
        f"A glossy teapot of {count(transfer.vertices, 'vertex')} baked in {time.perf_counter() - started:.1f} s, "
        f"{transfer.bytes / 2**20:.1f} MB, Monte Carlo error {_relative_error(transfer):.2%}: teapot.safetensors"
    )
    preview.save_png(reflections([shadowed, transfer], lamps), folder / "gloss.png")
    say("Its spout in its body, without and with a bounce: gloss.png")
    preview.save_png(eyes(transfer, lamps), folder / "eyes.png")
    say("The eye moves, the light stays: eyes.png")
    _export(transfer, folder / "teapot.onnx", say)


def _beyond(folder: Path, sculpture: Transfer, say: Say) -> None:
    """Light by way of mirrors, shadows on what was never seen, lamps nearby: the last part of `run`."""
    ring = bake(samples.ring_on_plane(RING), order=GLOSS, rays=1024, bounces=2)
    save(ring, folder / "ring.safetensors")
    preview.save_png(caustics(ring), folder / "ring.png")
    say(f"A gold ring, whose caustic follows the light, {count(ring.vertices, 'receiver')}: ring.safetensors, ring.png")
    around = bake_neighbourhood(samples.glider(), grid=NODES, rays=512, bounces=1)
    save(around, folder / "glider.safetensors")
    preview.save_png(gliding(around), folder / "glider.png")
    say("A glider drags its shadow over land that it has never seen: glider.safetensors, glider.png")
    over_land, land = clouded()
    save(over_land, folder / "cloud.safetensors")
    save(land, folder / "land.safetensors")
    preview.save_png(under_cloud(over_land, land), folder / "cloud.png")
    say(f"A cloud of {count(over_land.vertices, 'cell')} over land: cloud.safetensors, land.safetensors, cloud.png")
    preview.save_png(nearby(sculpture), folder / "lamps.png")
    say("Two lamps nearby, one light for all and one for each of 16 places: lamps.png")
    preview.save_png(from_behind(), folder / "marble.png")
    say("A small head of plaster, marble and skin, lit from behind: marble.png")


def caustics(transfer: Transfer) -> Tensor:
    """A ring on a plane under three turns of one environment."""
    environment = preview.built_in_environment("studio", transfer.order)
    studio = preview.Studio(transfer, shader(transfer), environment, size=SIZE)
    camera = preview.frame(transfer.positions, (0.25, 0.85, 1.0), target=(0.0, 0.1, 0.0), distance=5.0)
    yaws = [40.0, 160.0, 280.0]
    pictures = [studio.picture(camera, sh.yaw_pitch_roll(torch.tensor([yaw, 0.0, 0.0]))) for yaw in yaws]
    return preview.sheet(pictures, [f"yaw {yaw:.0f}" for yaw in yaws], columns=3)


def gliding(around: Transfer) -> Tensor:
    """A glider at three places over land, after figure 7 of the 2002 paper."""
    sun = light.disc((-0.55, 1.0, 0.35), math.radians(9), (2.3, 1.95, 1.5), around.order, normalise=True)
    sky = light.constant((0.17, 0.22, 0.34), around.order)
    cast = preview.Cast(
        around,
        samples.terrain(100).objects[0].mesh,
        preview.Environment("sun", (sun + sky).float()),
        model=bake(samples.glider(), order=around.order, rays=128, progress=False),
        camera=preview.Camera(eye=(1.6, 3.9, 6.6), target=(-0.1, 0.15, 0.1), field=33.0),
        size=SIZE,
        exposure=-0.3,
    )
    keys = torch.tensor([[-1.9, 0.9, -1.0, 75.0, 0.0, 0.0], [1.2, 0.9, 1.2, 30.0, 0.0, 20.0]])
    pictures = [cast.picture(pose[None]) for pose in preview.along(keys, 3)]
    return preview.sheet(pictures, ["", "", ""], columns=3)


def clouded() -> tuple[Transfer, Transfer]:
    """A cloud above land, which blocks the light of its cells, and the land in its shadow and its light."""
    land = samples.terrain(LAND, extent=8.0, albedo=0.3)
    cloud = samples.cloud(CLOUD).moved((0.0, 1.7, 0.0), scale=1.3)
    over_land = bake_volume(cloud, blockers=land, rays=512, progress=False)
    return over_land, bake(land, rays=512, bounces=1, volume=over_land, progress=False)


def under_cloud(cloud: Transfer, land: Transfer) -> Tensor:
    """A cloud whose shadow goes over land as the sun goes around."""
    sun = light.disc((0.7, 1.0, 0.2), math.radians(12), (2.6, 2.2, 1.75), cloud.order, normalise=True)
    sky = light.constant((0.2, 0.27, 0.42), cloud.order)
    lit = preview.Environment("sun", (sun + sky).float())
    camera = preview.Camera(eye=(0.0, 5.6, 9.0), target=(0.0, 0.7, 0.0), field=34.0)
    studio = preview.VolumeStudio(cloud, lit, surface=land, size=SIZE, exposure=-0.9, background=BLUE)
    yaws = [0.0, 120.0, 240.0]
    pictures = [studio.picture(camera, sh.yaw_pitch_roll(torch.tensor([yaw, 0.0, 0.0]))) for yaw in yaws]
    return preview.sheet(pictures, [f"yaw {yaw:.0f}" for yaw in yaws], columns=3)


def from_behind() -> Tensor:
    """A head as tall as a thumb, with a lamp behind it: plain diffuse, and two media that light diffuses in."""
    mesh = samples.head(6_000).objects[0].mesh
    lamp = light.disc((-0.45, 0.5, -1.0), math.radians(14), (5.0, 4.8, 4.5), GLOSS, normalise=True)
    lit = (sh.window(lamp, sh.hann(2 * GLOSS)[:GLOSS]) + light.constant((0.06, 0.07, 0.09), GLOSS)).float()
    pictures = []
    for material in (
        Material(0.75),
        Material(subsurface="marble", millimetres=25),
        Material(subsurface="skin1", millimetres=25),
    ):
        transfer = bake(Scene([Object(mesh, material)]), order=GLOSS, rays=256, bounces=0, progress=False)
        still = preview.Still(transfer.positions, transfer.faces, size=SIZE)
        pictures.append(still.picture(_shade(transfer, lit).clamp(min=0), exposure=0.0))
    return preview.sheet(pictures, ["plain diffuse", "marble", "skin"], columns=3)


def nearby(transfer: Transfer) -> Tensor:
    """A sculpture between a warm and a cool lamp: one sample of their light, and sixteen."""
    middle = transfer.positions.double().mean(0)
    radius = float((transfer.positions.double() - middle).norm(dim=-1).amax())
    sides = [((-1.5, 0.5, 0.6), (60.0, 32.0, 14.0)), ((1.5, -0.2, 0.7), (16.0, 32.0, 60.0))]
    lamps = [light.SphereEmitter(middle + radius * torch.tensor(to).double(), radius / 6, by) for to, by in sides]
    still = preview.Still(transfer.positions, transfer.faces, size=SIZE)
    pictures = []
    for points, gradients in ((1, False), (16, True)):
        located = light.with_sample_points(transfer, points, gradients=gradients)
        with torch.no_grad():
            radiance = local_light_shader(shader(located), located)(light.local_light(located, lamps).float())
        # Ringing leaves negative radiance in deep shadow, which no eye sees.
        pictures.append(still.picture(radiance.clamp(min=0), exposure=0.7))
    return preview.sheet(pictures, ["one sample in the middle", "16 sample points"], columns=2)


def transport(transfer: Transfer, lamps: Tensor) -> Tensor:
    """What shadows and interreflection add to the closed form: a sheet of three."""
    sculpture = samples.organic(50_000, albedo=STONE)
    bakes = [
        ("unshadowed", bake(sculpture, shadows=False, progress=False)),
        ("shadowed", bake(sculpture, rays=512, progress=False)),
        (f"interreflected, {count(transfer.bounces, 'bounce')}", transfer),
    ]
    still = preview.Still(transfer.positions, transfer.faces, size=SIZE)
    pictures = [still.picture(_shade(each, lamps), exposure=EXPOSURE) for _, each in bakes]
    return preview.sheet(pictures, [name for name, _ in bakes], columns=3)


def turning(transfer: Transfer, environment: Tensor) -> Tensor:
    """Six turns of an environment about the vertical, each beside the turned photograph (its middle is behind)."""
    still = preview.Still(transfer.positions, transfer.faces, size=SIZE)
    lamps = light.project(environment, transfer.order)
    small = environment[::3, ::3]
    pictures, labels = [], []
    for yaw in range(0, 360, 60):
        # The light is turned as coefficients, the inset by moving columns: each shows whether the other is right.
        turned = sh.rotate(lamps, sh.yaw_pitch_roll(torch.tensor([float(yaw), 0.0, 0.0])))
        inset = torch.roll(small, -round(small.shape[1] * yaw / 360), dims=1)
        picture = still.picture(_shade(transfer, turned), exposure=EXPOSURE)
        picture[-inset.shape[0] :, : inset.shape[1]] = display(inset, exposure=EXPOSURE)
        pictures.append(picture)
        labels.append(f"yaw {yaw}")
    return preview.sheet(pictures, labels, columns=3)


def orders() -> Tensor:
    """A disc of light of three sizes over a square above the ground, by order, and order 5 with a window."""
    highest = 16
    transfer = bake(samples.plane_and_blocker(128), order=highest, rays=2048, progress=False)
    camera = preview.frame(transfer.positions, (0.0, 1.0, 0.35), aspect=1.0)
    still = preview.Still(transfer.positions, transfer.faces, size=(200, 200), camera=camera)
    pictures, labels = [], []
    for radius in (5, 20, 50):
        for order in (2, 3, 4, 5, 8, highest, -5):
            count = abs(order)
            lamp = light.disc((0.35, 1.0, 0.2), math.radians(radius), 1.0, count, normalise=True).float()
            if order < 0:
                lamp = sh.window(lamp, sh.hann(count, dtype=torch.float32))
            pictures.append(still.picture(_shade(transfer.to_order(count), lamp), tone="none"))
            labels.append(f"{radius} deg, order {count}" + (", Hann" if order < 0 else ""))
    return preview.sheet(pictures, labels, columns=7)


def bleeding() -> Tensor:
    """A box with a red and a green wall, without and with the light that bounces."""
    scene = samples.coloured_box(48)
    sun = light.disc((0.25, 0.5, 1.0), math.radians(25), 1.6, 5, normalise=True)
    lamps = (sun + light.constant(0.1, 5)).float()
    pictures, labels, still = [], [], None
    for bounces in (0, math.inf):
        transfer = bake(scene, rays=4096, bounces=bounces, progress=False)
        if still is None:
            camera = preview.frame(transfer.positions, (0.0, 0.08, 1.0), aspect=1.0)
            still = preview.Still(transfer.positions, transfer.faces, size=SIZE, camera=camera)
        pictures.append(still.picture(_shade(transfer, lamps), exposure=-0.5))
        labels.append(count(transfer.bounces, "bounce"))
    return preview.sheet(pictures, labels, columns=2)


def reflections(bakes: list[Transfer], lamps: Tensor) -> Tensor:
    """What light that bounced adds to a glossy surface: a sheet of the bakes, and of the last less the first."""
    camera = preview.frame(bakes[0].positions, (0.7, 0.75, 1.0), aspect=1.0)
    still = preview.Still(bakes[0].positions, bakes[0].faces, size=SIZE, camera=camera)
    radiance = [_shade(each, lamps, camera) for each in bakes]
    labels = [count(each.bounces, "bounce") for each in bakes]
    radiance.append(4 * (radiance[-1] - radiance[0]).clamp(min=0))
    pictures = [still.picture(each, exposure=EXPOSURE) for each in radiance]
    return preview.sheet(pictures, [*labels, "the difference, times 4"], columns=3)


def eyes(transfer: Transfer, lamps: Tensor) -> Tensor:
    """A glossy surface from six sides under one light: highlights move over it with the eye."""
    pictures, labels = [], []
    # From one distance, so that nothing jumps.
    orbit = preview.Orbit.around(transfer.positions, (0.0, 0.5, 1.0), sides=6)
    for angle in range(0, 360, 60):
        camera = orbit.turned(-math.radians(angle), 0.0).camera()
        still = preview.Still(transfer.positions, transfer.faces, size=SIZE, camera=camera)
        pictures.append(still.picture(_shade(transfer, lamps, camera), exposure=EXPOSURE))
        labels.append(f"eye at {angle} degrees from +z to +x")
    return preview.sheet(pictures, labels, columns=3)


def write_environment(image: Tensor, path: Path) -> None:
    """Writes linear radiance as half-float OpenEXR."""
    light.write_exr(path, image.numpy())


def _shade(transfer: Transfer, lamps: Tensor, camera: preview.Camera | None = None) -> Tensor:
    eye = {} if camera is None else {"eye": torch.tensor(camera.eye)}
    with torch.no_grad():
        return shader(transfer)(lamps, **eye)


def _relative_error(transfer: Transfer) -> float:
    return transfer.error / transfer.signal if transfer.error is not None and transfer.signal else math.nan


def _export(transfer: Transfer, path: Path, say: Say) -> None:
    try:
        from torchprt.onnx import export
    except ImportError:
        say("No ONNX graph: install torchprt[export] for it")
        return
    report = export(transfer, path)
    say(f"The same as one ONNX graph, compared in ONNX Runtime ({report.parity}): {path.name}")

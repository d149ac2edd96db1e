"""The pictures, the animation and the figures of docs/neighbourhood.md: a glider over land that it has never seen.

    python docs/make/neighbourhood.py [NAME ...]

All of them without a name. Error is RMS relative to the RMS of the reference; times are of one thread.
"""

from __future__ import annotations

import functools
import math
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from rich.console import Console
from torch import Tensor

from torchprt import light, preview
from torchprt.compression import compress
from torchprt.measure import Table, relative_rms, time_it
from torchprt.scene import Material, Object, Points, Scene, make_mesh, samples
from torchprt.shade import NeighbourhoodShader, by_ratio, shader
from torchprt.transfer import Transfer
from torchprt.transport import GridWarning, bake, bake_neighbourhood

FOLDER = Path(__file__).parents[1] / "images"
ORDER = 5
SKY = (0.66, 0.77, 0.88)
FRAMES = 40
SIZE = (420, 300)
# Where the glider goes over the land: x, y, z, yaw, pitch, roll.
KEYS = torch.tensor([
    [-2.9, 0.95, -1.3, 70.0, 0.0, -8.0],
    [-1.1, 0.85, -0.7, 80.0, 2.0, 4.0],
    [0.5, 0.8, 0.1, 62.0, 0.0, 24.0],
    [1.5, 0.95, 1.7, 20.0, -3.0, 16.0],
])  # fmt: skip


@functools.cache
def environment() -> preview.Environment:
    """A low sun of a wide disc, and a sky."""
    sun = light.disc((-0.55, 1.0, 0.35), math.radians(9), (2.3, 1.95, 1.5), order=ORDER, normalise=True)
    sky = light.constant((0.17, 0.22, 0.34), order=ORDER)
    return preview.Environment("sun", (sun + sky).float(), None)


@functools.cache
def glider(bounces: int = 1, grid: int | tuple[int, ...] = 1 << 15, output_order: int = 3) -> Transfer:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GridWarning)
        return bake_neighbourhood(
            samples.glider(), order=ORDER, bounces=bounces, grid=grid, output_order=output_order, progress=False
        )


@functools.cache
def land() -> Transfer:
    """Bumpy land with shadows of its own, greener in the valleys."""
    mesh = samples.terrain(200, 9.0).objects[0].mesh
    height = (mesh.positions[:, 1:2].float() / 0.22 + 1).clamp(0, 2) / 2
    albedo = torch.lerp(torch.tensor([0.30, 0.36, 0.16]), torch.tensor([0.62, 0.54, 0.40]), height)
    return bake(Scene([Object(mesh, Material(albedo))]), order=ORDER, rays=512, bounces=0, progress=False)


@functools.cache
def model() -> Transfer:
    return bake(samples.glider(), order=ORDER, rays=512, bounces=1, progress=False)


def camera() -> preview.Camera:
    return preview.Camera(eye=(1.6, 3.9, 6.6), target=(-0.1, 0.15, 0.1), field=33.0)


def shown(size: tuple[int, int] = SIZE, samples_: int = 9) -> preview.Cast:
    return preview.Cast(
        glider(),
        land(),
        environment(),
        model=model(),
        camera=camera(),
        size=size,
        exposure=-0.3,
        samples=samples_,
        background=SKY,
    )


def gliding() -> list[Tensor]:
    """The glider drags its shadow over the land."""
    pictures = shown((360, 250), 4)
    return [pictures.picture(pose[None]) for pose in preview.along(KEYS, FRAMES)]


def frames() -> Tensor:
    """Three moments: figure 7 of the paper."""
    pictures = shown()
    poses = preview.along(KEYS, 9)[[1, 4, 7]]
    return preview.strip([pictures.picture(pose[None]) for pose in poses], 3)


def moved(scene: Scene, pose: Tensor) -> list[Object]:
    """The objects of a scene where a pose has taken them."""
    turn, shift = pose[:3, :3].double(), pose[:3, 3].double()
    return [
        Object(make_mesh(each.mesh.positions @ turn.T + shift, each.mesh.faces, name=each.mesh.name), each.material)
        for each in scene.objects
    ]


def beside() -> Tensor:
    """What is read from the grid beside a bake of land and glider together, and four times the difference."""
    pose = preview.along(KEYS, 9)[5]
    mesh = samples.terrain(200, 9.0).objects[0].mesh
    lit = environment().light
    found = NeighbourhoodShader(glider())(
        lit, positions=mesh.positions.float(), normals=mesh.normals.float(), pose=pose.float()
    )
    scene = Scene(moved(samples.glider(), pose))
    points = Points(mesh.positions, mesh.normals, 1.0)
    wanted = shader(bake(scene, order=ORDER, rays=1024, bounces=1, receivers=points, progress=False))(lit)
    plain = NeighbourhoodShader(glider())(lit, positions=mesh.positions.float() + 1e3, normals=mesh.normals.float())
    still = preview.Still(mesh.positions, mesh.faces, size=SIZE, camera=camera(), samples=9)
    pictures = [still.picture(each * 0.5, exposure=-0.3) for each in (found, wanted)]
    apart = still.picture((0.25 + 2 * (found - wanted)).clamp(min=0), tone="none")
    print(f"on the land: {relative_rms(found, wanted):.2%}; without the shadow {relative_rms(plain, wanted):.2%}")
    return preview.sheet([*pictures, apart], ["read from the grid", "baked there", "difference, four times"], columns=3)


def plane(height: float, side: int = 96) -> Tensor:
    ticks = torch.linspace(-2, 2, side, dtype=torch.float64)
    x, z = torch.meshgrid(ticks, ticks, indexing="ij")
    return torch.stack([x.flatten(), torch.full((side * side,), height, dtype=torch.float64), z.flatten()], -1)


@functools.cache
def lights() -> dict[str, Tensor]:
    made = {"white": light.constant(1.0, order=ORDER)}
    for height in (90, 60, 35):
        up, out = math.sin(math.radians(height)), math.cos(math.radians(height))
        disc = light.disc((0.6 * out, up, 0.8 * out), math.radians(10), 1.0, order=ORDER, normalise=True)
        made[f"sun at {height}"] = disc + light.constant(0.15, order=ORDER)
    made["studio"] = light.project(light.studio(128), ORDER)
    return {name: each.float() for name, each in made.items()}


def direct(objects: list[Object], places: Tensor) -> Tensor:
    """Radiance of a white plane baked together with the objects, under all lights."""
    up = torch.tensor([0.0, 1.0, 0.0]).double().expand_as(places)
    transfer = bake(
        Scene(objects), order=ORDER, rays=2048, bounces=0, receivers=Points(places, up, 1.0), progress=False
    )
    return shader(transfer)(torch.stack(list(lights().values())))


def on_plane(transfer: Transfer, places: Tensor, poses: Tensor | None = None) -> list[tuple[Tensor, Tensor]]:
    shade, up = NeighbourhoodShader(transfer), torch.tensor([0.0, 1.0, 0.0]).expand(len(places), 3)
    every = torch.stack(list(lights().values()))
    with torch.no_grad():
        given = {"positions": places.float(), "normals": up}
        return [
            shade.parts(every, pose=pose.float(), **given) for pose in (torch.eye(4)[None] if poses is None else poses)
        ]


def planes() -> Table:
    """The shadow on a plane against a bake of plane and glider."""
    table = Table("shadow of the glider on a white plane, 4 wide: relative RMS error of radiance")
    for height in (-0.7, -1.0, -1.5, -2.5):
        places = plane(height)
        wanted = direct(list(samples.glider().objects), places)
        rows = {"no shadow": on_plane(glider(0), places + 1e3)[0]}
        for grid in ((12, 12, 12), (16, 16, 16), (24, 24, 24), 1 << 15, (48, 48, 48), (64, 8, 64)):
            rows[named(grid)] = on_plane(glider(0, grid), places)[0]
        rows["32768 nodes, output order 5"] = on_plane(glider(0, 1 << 15, 5), places)[0]
        for name, (plain, change) in rows.items():
            radiance = plain + change
            columns = {each: f"{relative_rms(radiance[k], wanted[k]):.2%}" for k, each in enumerate(lights())}
            table.add(f"{-height} below, {name}", extra=columns)
    return table


def named(grid: int | tuple[int, ...]) -> str:
    return f"{grid} nodes" if isinstance(grid, int) else "x".join(map(str, grid))


def several() -> Table:
    """Two and three gliders over a plane, put together in three ways."""
    table = Table("gliders over a plane 1.2 below: relative RMS error of radiance")
    keys = {
        "side by side": [[-0.6, 0, 0, 0, 0, 0], [0.7, 0.2, 0.3, 40, 0, 0]],
        "above each other": [[0, 0, 0, 0, 0, 0], [0.1, 0.6, 0.1, 90, 0, 0]],
        "three": [[-0.6, 0, 0, 0, 0, 0], [0.7, 0.2, 0.3, 40, 0, 0], [0, 0.7, -0.4, 70, 10, 0]],
    }
    for name, placed in keys.items():
        poses, places = preview.motions(torch.tensor(placed).double()), plane(-1.2, 64)
        wanted = direct([each for pose in poses for each in moved(samples.glider(), pose)], places)
        parts = on_plane(glider(0), places, poses)
        plain = parts[0][0]
        changes = torch.stack([change for _, change in parts])
        ways = {"no shadow": plain, "ratios multiplied": by_ratio(parts), "changes added": plain + changes.sum(0)}
        ways["strongest change"] = plain + changes.amin(0)
        for way, radiance in ways.items():
            columns = {each: f"{relative_rms(radiance[k], wanted[k]):.2%}" for k, each in enumerate(lights())}
            table.add(f"{name}, {way}", extra=columns)
    return table


def times() -> Table:
    """What a frame costs, by receivers, by nodes, by the object, dense and clustered."""
    torch.set_num_threads(1)
    table = Table("one light, one pose, one thread: milliseconds a frame")
    lit = next(iter(lights().values()))
    plain = {
        "glider, 32768 nodes": glider(0),
        "glider, 16x16x16": glider(0, (16, 16, 16)),
        "glider, 48x48x48": glider(0, (48,) * 3),
    }
    fine = samples.glider(192)
    print(
        f"fine glider: {sum(len(each.mesh.faces) for each in fine.objects)} faces, "
        f"glider: {sum(len(each.mesh.faces) for each in samples.glider().objects)}"
    )
    plain["16 times the triangles"] = bake_neighbourhood(fine, order=ORDER, progress=False)
    coloured = glider(1)
    plain["glider with a bounce, three channels"] = coloured
    plain["the same, 64 clusters of 8"] = clustered(64, 8)
    shaders = {name: NeighbourhoodShader(transfer) for name, transfer in plain.items()}
    columns: dict[str, dict[str, str]] = {name: {"MB": f"{each.bytes / 2**20:.1f}"} for name, each in plain.items()}
    for count in (1_000, 10_000, 100_000):
        places = torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) * 4 - 2
        given = {"positions": places, "normals": torch.tensor([0.0, 1.0, 0.0]).expand(count, 3), "pose": torch.eye(4)}
        with torch.no_grad():
            calls = {name: functools.partial(shade, lit, **given) for name, shade in shaders.items()}
            for name, timing in time_it(calls).items():
                columns[name][f"{count} receivers"] = f"{1000 * timing.median:.1f}"
    for name, found in columns.items():
        table.add(name, extra=found)
    return table


@functools.cache
def clustered(clusters: int, components: int) -> Transfer:
    return compress(glider(1), clusters=clusters, components=components)


def sizes() -> Table:
    """Bytes and what is lost by clusters."""
    table = Table("glider with a bounce, three channels, 32768 nodes, order 5, output order 3")
    places = plane(-1.0)
    whole = sum(on_plane(glider(1), places)[0])
    table.add("dense", extra={"MB": f"{glider(1).bytes / 2**20:.1f}"})
    for clusters, components in ((16, 4), (64, 4), (64, 8), (256, 8)):
        start = time.perf_counter()
        made = clustered(clusters, components)
        seconds = time.perf_counter() - start
        found = sum(on_plane(made, places)[0])
        signal = made.layers["neighbourhood"].signal.metadata()["compression_error"]
        columns = {"MB": f"{made.bytes / 2**20:.1f}", "of matrices": f"{signal:.2%}", "s": f"{seconds:.0f}"}
        table.add(
            f"{clusters} clusters of {components}", extra=columns | {"of radiance": f"{relative_rms(found, whole):.2%}"}
        )
    return table


def flight() -> Tensor:
    """The page in a browser; needs what docs/make/page.py does."""
    import io
    import shutil
    import tempfile
    import threading

    from playwright.sync_api import sync_playwright

    from torchprt import web

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    flags = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--force-color-profile=srgb")
    flies = web.Flight(clustered(64, 8), model(), preview.along(KEYS, 97))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page = web.export(land(), Path(folder) / "page", title="Glider", flight=flies, check=False)
        with web.serve(page.folder) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            browser = playwright.chromium.launch(executable_path=program, args=list(flags))
            tab = browser.new_page(viewport={"width": 1200, "height": 760})
            tab.goto(f"http://127.0.0.1:{server.server_port}/")
            tab.wait_for_selector("body[data-ready]", timeout=90_000)
            tab.click("#environments label:nth-child(3)")
            tab.evaluate("async () => { await torchprt.raced; await torchprt.zoom(0.58); await torchprt.flyTo(0.6); }")
            tab.evaluate("async () => { torchprt.turnCamera(-60, 40); await torchprt.turnLight(-150, 0); }")
            picture = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
            browser.close()
            server.shutdown()
    return torch.from_numpy(np.asarray(picture).astype("float32") / 255)


def animation(name: str, pictures: list[Tensor]) -> None:
    pictures = [*pictures]
    images = [Image.fromarray((picture.numpy() * 255).round().astype("uint8")) for picture in pictures]
    images[0].save(
        path(name, "webp"), save_all=True, append_images=images[1:], duration=80, loop=0, quality=90, method=6
    )


def path(name: str, suffix: str) -> Path:
    return FOLDER / f"{name}.{suffix}"


TABLES = {"planes": planes, "several": several, "times": times, "sizes": sizes}
PICTURES = {"glider": frames, "cast": beside, "flight": flight}
ANIMATIONS = {"gliding": gliding}


def main(names: list[str]) -> None:
    known = [*PICTURES, *ANIMATIONS, *TABLES]
    unknown = sorted(set(names) - set(known))
    if unknown:
        sys.exit(f"there is no {unknown[0]}: choose from {' '.join(known)}")
    FOLDER.mkdir(exist_ok=True)
    console = Console(width=160)
    for name in names or known:
        if name in TABLES:
            console.print(TABLES[name]())
        elif name in PICTURES:
            preview.save_png(PICTURES[name](), path(name, "png"))
            Image.open(path(name, "png")).convert("RGB").save(path(name, "png"), optimize=True)
        else:
            animation(name, ANIMATIONS[name]())
        for written in sorted(FOLDER.glob(f"{name}.*")):
            print(f"{written}: {written.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])

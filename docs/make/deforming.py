"""The figures, pictures and animations of docs/deforming.md: what lobes keep when surfaces bend.

    python docs/make/deforming.py [NAME ...]

All of them without a name. Error is RMS relative to the RMS of the reference.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
from pathlib import Path

import torch
from PIL import Image
from rich.console import Console
from torch import Tensor

from torchprt import light, preview, sh
from torchprt.compression import fit
from torchprt.measure import Table, relative_rms
from torchprt.pose import SkinnedMesh, deformed_frames, surface_frames
from torchprt.scene import Material, Mesh, Object, Scene, bend, make_mesh, samples, twist
from torchprt.shade import lay, sample, shader
from torchprt.shade.lobes import lobe_vectors
from torchprt.transfer import Diffuse, Texels, Transfer, Zonal
from torchprt.transport import bake, bake_patch, membrane_lobes, patch_transfer, wrinkle
from torchprt.transport.patch import texel_centres

FOLDER = Path(__file__).parents[1] / "images"
ORDER = 6
FRAMES = 24


def lamps() -> Tensor:
    """A bright disc from the upper left and a little of everything."""
    disc = light.disc((-0.9, 0.7, 0.3), math.radians(20), 1.1, order=ORDER, normalise=True)
    return (disc + light.constant(0.1, order=ORDER)).float()


@functools.cache
def head() -> Mesh:
    return samples.head().objects[0].mesh


def diffuse(mesh: Mesh, positions: Tensor, shadows: bool = True, rays: int = 1024) -> Transfer:
    """The mesh baked in a pose."""
    scene = Scene([Object(make_mesh(positions, mesh.faces, name=mesh.name), Material(0.6))])
    return bake(scene, order=ORDER, rays=rays, shadows=shadows, progress=False)


def lobes_of(transfer: Transfer) -> Zonal:
    """How its diffuse layer is stored."""
    signal = transfer.layers["diffuse"].signal
    assert isinstance(signal, Zonal)
    return signal


@functools.cache
def lobes(count: int) -> Transfer:
    """Transfer of the head at rest in zonal lobes."""
    return fit(diffuse(head(), head().positions), lobes=count)


def posed_head(bending: float, twisting: float) -> Tensor:
    return bend(twist(head().positions, twisting, 0.2, 1.9), bending, 0.2, 1.9)


def shaded(transfer: Transfer, lights: Tensor, **pose: Tensor) -> Tensor:
    with torch.no_grad():
        return shader(transfer)(lights, **pose)


def turned_vectors(transfer: Transfer, frames: Tensor, lights: Tensor) -> Tensor:
    """Radiance of whole transfer vectors turned by the frames: what any number of lobes tends to."""
    values = transfer.layers["diffuse"].signal.dense().values
    vectors = sh.rotate(values[0].mT[..., None].double(), frames.double())[..., 0]
    return 0.6 * (vectors.float() @ lights)


def truth() -> Table:
    """Error of every way to shade the deformed head, against transfer baked on the deformed head."""
    table = Table("head, order 6, studio from eight sides: relative RMS error against a bake of the pose")
    poses = {"bent .3, twisted .3": (0.3, 0.3), "bent .5, twisted .6": (0.5, 0.6), "bent .8, twisted 1": (0.8, 1.0)}
    project = light.project(light.studio(256), ORDER).float()
    yaws = torch.arange(8) * 45.0
    lights = sh.rotate(project, sh.yaw_pitch_roll(torch.stack([yaws, 0 * yaws, 0 * yaws], -1)))
    rest = diffuse(head(), head().positions)
    names = ["unshadowed", "as baked at rest", *(f"lobes, N = {n}" for n in (1, 2, 3, 4)), "vectors turned whole"]
    rows: dict[str, dict[str, str]] = {name: {} for name in names}
    for pose, angles in poses.items():
        positions = posed_head(*angles)
        wanted = shaded(diffuse(head(), positions), lights)
        frames = deformed_frames(head().positions, head().faces, positions)
        found = [shaded(diffuse(head(), positions, shadows=False), lights), shaded(rest, lights)]
        found += [shaded(lobes(n), lights, positions=positions.float()) for n in (1, 2, 3, 4)]
        found.append(turned_vectors(rest, frames, lights))
        for name, radiance in zip(names, found, strict=True):
            rows[name][pose] = f"{relative_rms(radiance, wanted):.1%}"
    for name, columns in rows.items():
        table.add(name, extra=columns)
    return table


def deformed() -> Tensor:
    """The bent and twisted head by four kinds of transfer: figure 6 c to e of the paper, and unshadowed."""
    positions = posed_head(0.5, 0.6)
    camera = preview.frame(positions, (-0.1, 0.15, 1.0), aspect=0.8)
    still = preview.Still(positions, head().faces, size=(320, 400), camera=camera, samples=9)
    rest = diffuse(head(), head().positions)
    found = {
        "unshadowed": shaded(diffuse(head(), positions, shadows=False), lamps()),
        "as baked at rest": shaded(rest, lamps()),
        "four lobes": shaded(lobes(4), lamps(), positions=positions.float()),
        "baked in the pose": shaded(diffuse(head(), positions), lamps()),
    }
    return preview.sheet([still.picture(each) for each in found.values()], list(found), columns=4)


def swaying(moment: float) -> Tensor:
    """The head at a moment of its movement, from 0 to 1."""
    phase = 2 * math.pi * moment
    return posed_head(0.5 * math.sin(phase), 0.7 * math.sin(phase + 0.9))


def bending() -> list[Tensor]:
    """The head sways under a light that stays; lobes."""
    poses = [swaying(frame / FRAMES) for frame in range(FRAMES)]
    camera = preview.frame(torch.cat(poses), (-0.1, 0.15, 1.0), aspect=1.0)
    pictures = []
    for positions in poses:
        still = preview.Still(positions, head().faces, size=(280, 280), camera=camera, samples=4)
        pictures.append(still.picture(shaded(lobes(4), lamps(), positions=positions.float())))
    return pictures


def popping() -> Table:
    """Whether neighbours, or moments, jump: edges against whole vectors turned, and the largest step of a vertex."""
    faces = head().faces
    edges = torch.cat([faces[:, :2], faces[:, 1:], faces[:, [2, 0]]]).sort(1).values.unique(dim=0)
    rest, before = diffuse(head(), head().positions), None
    jumps, steps = [], []
    for moment in range(60):
        positions = swaying(moment / 960)
        radiance = shaded(lobes(4), lamps(), positions=positions.float())
        if before is not None:
            steps.append(float((radiance - before).abs().max() / radiance.mean()))
        before = radiance
        if moment % 20 == 0:
            frames = deformed_frames(head().positions, faces, positions)
            whole = turned_vectors(rest, frames, lamps())
            found, wanted = (each[edges[:, 0]] - each[edges[:, 1]] for each in (radiance, whole))
            jumps.append(relative_rms(found, wanted))
    table = Table("swaying head, N = 4, steps of a 960th of the movement")
    table.add("differences along edges, relative RMS error", extra={"most": f"{max(jumps):.1%}"})
    table.add("step of a vertex, of the mean radiance", extra={"most": f"{max(steps):.1%}"})
    return table


@functools.cache
def wings() -> tuple[Transfer, SkinnedMesh]:
    """The wings as membranes whose fingers let little through, and their skin."""
    transfer = membrane_lobes(samples.wing(), order=ORDER, translucency=samples.wing_translucency())
    return transfer, SkinnedMesh(transfer.positions, samples.wing_rig().weights.float())


def flapping() -> list[Tensor]:
    """A beat of the wings before a light from behind."""
    transfer, skin = wings()
    beat = samples.wing_rig().pose(samples.flap(torch.arange(FRAMES, dtype=torch.float64) / FRAMES)).float()
    positions, frames = skin(beat)
    disc = light.disc((0.2, 0.75, -0.8), math.radians(15), 1.8, order=ORDER, normalise=True)
    sky = (disc + light.constant(0.12, order=ORDER)).float()
    radiance = shaded(transfer, sky, frames=frames)
    camera = preview.frame(positions.flatten(0, 1), (0.5, 0.15, 1.0), aspect=1.1)
    stills = (preview.Still(each, transfer.faces, size=(330, 300), camera=camera, samples=9) for each in positions)
    return [still.picture(each) for still, each in zip(stills, radiance, strict=True)]


PATCHES = {"bumps": (samples.bumps, 7), "waffle": (samples.waffle, 9), "wrinkles": (samples.wrinkles, 4)}


def on_the_vase(patch: Transfer, around: int, mesh: Mesh, positions: Tensor) -> Tensor:
    """Radiance of the vase in a pose, covered with a patch; repeated so that patches are square at its belly."""
    laid = lay(patch, mesh.positions.float(), mesh.faces, mesh.uv, repeat=(around, 1.27 * around), normals=mesh.normals)
    return shaded(laid, lamps(), positions=positions.float())


def patches() -> Tensor:
    """Three patches on a bent and twisted vase, unshadowed and by four lobes: figures 5 and 7 of the paper."""
    mesh = samples.vase(300).objects[0].mesh
    positions = bend(twist(mesh.positions, 0.6, 0.2, 2.0), 0.4, 0.2, 2.0)
    camera = preview.frame(positions, (-0.05, 0.35, 1.0), aspect=0.8)
    still = preview.Still(positions, mesh.faces, size=(320, 400), camera=camera, samples=9)
    pictures, labels = [], []
    for shadows in (False, True):
        for name, (sample_of, around) in PATCHES.items():
            # A clamped cosine is one lobe about the normal: exact, and smooth.
            count = 4 if shadows else 1
            patch = bake_patch(sample_of(96), size=128, shadows=shadows, albedo=0.7, lobes=count, smooth=not shadows)
            pictures.append(still.picture(on_the_vase(patch, around, mesh, positions)))
            labels.append(f"{name}, {'shadowed' if shadows else 'unshadowed'}")
    return preview.sheet(pictures, labels, columns=3)


INSIDE = {
    "diffuse": {"albedo": (0.6, 0.42, 0.32)},
    "skin, thick": {"subsurface": "skin1", "millimetres": 12.0},
    "skin, .5 mm at its thinnest": {"subsurface": "skin1", "millimetres": 12.0, "thickness": 0.04},
}


def inside() -> Tensor:
    """A waffle that light diffuses in, on a bent vase, from before and from behind: figures 5e and 7c of the paper."""
    mesh = samples.vase(300).objects[0].mesh
    positions = bend(twist(mesh.positions, 0.6, 0.2, 2.0), 0.4, 0.2, 2.0)
    camera = preview.frame(positions, (-0.05, 0.35, 1.0), aspect=0.8)
    still = preview.Still(positions, mesh.faces, size=(320, 400), camera=camera, samples=9)
    behind = light.disc((0.75, 0.35, -0.6), math.radians(20), 1.1, order=ORDER, normalise=True)
    lights = {"lit from before": lamps(), "from behind": (behind + light.constant(0.05, order=ORDER)).float()}
    patches = {name: bake_patch(samples.waffle(48), size=64, rays=512, **how) for name, how in INSIDE.items()}
    pictures, labels = [], []
    for where, lit in lights.items():
        for name, patch in patches.items():
            laid = lay(patch, mesh.positions.float(), mesh.faces, mesh.uv, repeat=(9, 1.27 * 9), normals=mesh.normals)
            pictures.append(still.picture(shaded(laid, lit, positions=positions.float())))
            labels.append(f"{name}, {where}")
    return preview.sheet(pictures, labels, columns=3)


GROOVES, DEEP = 20, 0.35


@functools.cache
def cylinders() -> dict[str, tuple[Mesh, Tensor, Tensor]]:
    """A bent cylinder whose wrinkles deepen toward its middle, four ways: mesh, positions, radiance."""
    mesh = samples.cylinder(150).objects[0].mesh
    assert mesh.uv is not None
    depth = (math.pi * mesh.positions[:, 1] / 3).sin()

    def posed(places: Tensor) -> Tensor:
        # Turned evenly from end to end: where a twist begins, normals break, which would be seen as a line.
        return bend(twist(places, 0.6, 0.0, 3.0), 0.7, 0.3, 2.7)

    positions, deformed = posed(mesh.positions), posed(carved(mesh, depth))
    # u counts grooves, v is their depth; so they are no chart, and frames come from that of the mesh.
    uv = torch.stack([mesh.uv[..., 0] * GROOVES, depth[mesh.faces]], -1)
    frames = surface_frames(mesh.positions, mesh.faces, mesh.uv, mesh.normals).float()
    found = {"smooth": (mesh, positions, shaded(diffuse(mesh, positions, shadows=False), lamps()))}
    for name, patch in (("wrinkles, unshadowed", slopes()), ("wrinkle map", wrinkle(32, depth=DEEP))):
        laid = lay(patch, mesh.positions.float(), mesh.faces, uv, frames=frames)
        found[name] = mesh, positions, 0.6 * shaded(laid, lamps(), positions=positions.float())
    found["relief, baked in the pose"] = mesh, deformed, shaded(diffuse(mesh, deformed, rays=512), lamps())
    return found


def wrinkled() -> Tensor:
    """The wrinkle map beside a relief that is baked: figure 6 a and b of the paper."""
    found = cylinders()
    mesh, positions, _ = found["smooth"]
    camera = preview.frame(positions, (-0.25, 0.2, 1.0), aspect=0.6)
    pictures = []
    for _, points, radiance in found.values():
        still = preview.Still(points, mesh.faces, size=(270, 450), camera=camera, samples=9)
        pictures.append(still.picture(radiance))
    return preview.sheet(pictures, list(found), columns=4)


def grooves() -> Table:
    """Error of the wrinkled cylinder against the relief, baked in the pose."""
    table = Table("wrinkled cylinder: relative RMS error against a relief that is baked in the pose")
    wanted = cylinders()["relief, baked in the pose"][2]
    for name, (_, _, radiance) in list(cylinders().items())[:3]:
        table.add(name, error=relative_rms(radiance, wanted))
    return table


def slopes() -> Transfer:
    """A map of the slopes of the grooves alone: clamped cosines about tilted normals."""
    rows = columns = 64
    v, u = ((torch.arange(64, dtype=torch.float64) + 0.5) / 64 for _ in range(2))
    slope = -math.pi * DEEP * v[:, None] * torch.sin(2 * math.pi * u)
    normal = torch.nn.functional.normalize(torch.stack([-slope, 0 * slope, 1 + 0 * slope]), dim=0)
    cosine = sh.clamped_cosine(ORDER) / math.pi
    signal = Zonal(
        axis=normal.reshape(1, 1, 3, -1),
        coefficients=cosine[None, None, None, :, None].expand(1, 1, 1, ORDER, rows * columns),
        exact=torch.zeros(1, 1, 0, rows * columns, dtype=torch.float64),
        squared_error=torch.zeros(rows * columns, dtype=torch.float64),
        smooth=True,
    )
    texels = Texels(rows=rows, columns=columns, tiles_v=False)
    return Transfer(receivers=texels, layers={"diffuse": Diffuse(albedo=torch.ones(1, 1), signal=signal)})


def carved(mesh: Mesh, depth: Tensor) -> Tensor:
    """The cylinder with grooves cut into it."""
    width = 2 * math.pi * 0.5 / GROOVES
    angle = torch.atan2(-mesh.normals[:, 2], mesh.normals[:, 0])
    cut = DEEP * depth * width / 2 * ((GROOVES * angle).cos() - 1)
    return mesh.positions + cut[:, None] * mesh.normals


def fits() -> Table:
    """What patches of 64 x 64 texels cost and lose."""
    table = Table("patches, 64 x 64 texels, order 6, 1024 rays: relative RMS error of the fit")
    for name, (sample_of, _) in PATCHES.items():
        texels = patch_transfer(sample_of(96), size=64)
        columns: dict[str, str | int] = {}
        for count in (1, 2, 3, 4):
            found = fit(texels, lobes=count)
            columns[f"N = {count}"] = f"{lobes_of(found).fit_error:.2%}"
            columns["kB, N = 4"] = round(found.bytes / 1024)
        table.add(name, extra=columns)
    model = wrinkle(32, depth=DEEP)
    table.add("wrinkle map, 32 x 32", extra={"N = 3": f"{lobes_of(model).fit_error:.2%}"})
    return table


def between() -> Table:
    """What is lost between texels: every map read at nine times as many places, against a bake there."""
    table = Table("patches between texels, N = 4: relative RMS error against 192 x 192 texels")
    fine = 192
    for name, (sample_of, _) in PATCHES.items():
        wanted = patch_transfer(sample_of(96), size=fine).layers["diffuse"].signal.dense().values
        for size in (32, 64, 128):
            texels = patch_transfer(sample_of(96), size=size)
            columns = {}
            for smooth in (False, True):
                fitted = fit(texels, lobes=4, smooth=smooth)
                patch = dataclasses.replace(fitted, receivers=Texels(rows=size, columns=size))
                read, _ = sample(patch, texel_centres(fine, fine))
                vectors = lobe_vectors(read.axis[0].movedim(1, 0), read.coefficients[:, 0], read.exact[:, 0])
                columns["smooth" if smooth else "nearest"] = f"{relative_rms(vectors, wanted):.1%}"
            table.add(f"{name}, {size} x {size}", extra=columns)
    return table


COARSE, FINE, TILES = 16, 14, (6.0, 7.6)


@functools.cache
def covering(gloss: str | None = None) -> Transfer:
    """A waffle to be read at pixels, diffuse or of glossy paint in four factors."""
    if gloss is None:
        return bake_patch(samples.waffle(96), size=128, albedo=0.7)
    return bake_patch(samples.waffle(96), size=96, albedo=0.15, gloss=gloss, specular=0.5, factors=4)


@functools.cache
def coarse() -> Mesh:
    return samples.vase(COARSE).objects[0].mesh


def finer(mesh: Mesh, parts: int) -> Mesh:
    """The same surface, each face in `parts` squared: places, normals and texture coordinates between its corners."""
    steps = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    number = {step: place for place, step in enumerate(steps)}
    weights = torch.tensor([[parts - i - j, i, j] for i, j in steps], dtype=torch.float64) / parts
    up = [[number[i, j], number[i + 1, j], number[i, j + 1]] for i, j in steps if i + j < parts]
    down = [[number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]] for i, j in steps if i + j < parts - 1]
    small, corner = torch.tensor(up + down), mesh.faces
    assert mesh.uv is not None
    between = [torch.einsum("sc,fcd->fsd", weights, each) for each in (mesh.positions[corner], mesh.normals[corner])]
    uv = torch.einsum("sc,fcd->fsd", weights, mesh.uv.double())
    faces = small + len(steps) * torch.arange(len(corner))[:, None, None]
    normals = torch.nn.functional.normalize(between[1], dim=-1)
    return make_mesh(
        between[0].flatten(0, 1),
        faces.flatten(0, 1),
        normals=normals.flatten(0, 1),
        uv=uv[:, small].flatten(0, 1),
    )


@functools.cache
def at_pixels(gloss: str | None = None) -> preview.PatchStudio:
    mesh = coarse()
    return preview.PatchStudio(
        covering(gloss),
        *(mesh.positions, mesh.faces, mesh.uv, preview.Environment("lamps", lamps())),
        repeat=TILES,
        normals=mesh.normals,
        size=(280, 420),
        samples=9,
        exposure=0.0,
    )


def at_vertices(mesh: Mesh, gloss: str | None = None) -> preview.Studio:
    laid = lay(covering(gloss), mesh.positions.float(), mesh.faces, mesh.uv, repeat=TILES, normals=mesh.normals)
    lights = preview.Environment("lamps", lamps())
    return preview.Studio(laid, shader(laid), lights, size=(280, 420), samples=9, exposure=0.0)


def vase_camera() -> preview.Camera:
    return preview.frame(coarse().positions, (-0.05, 0.35, 1.0), aspect=2 / 3)


def pixels() -> Tensor:
    """A patch on few faces, read at their vertices and at pixels, and on many: figure 5 of the paper, by pixel."""
    mesh, shiny = coarse(), "ggx:0.25,0.9"
    studios = {
        f"{len(mesh.positions)} vertices, read there": at_vertices(mesh),
        "the same, read at pixels": at_pixels(),
        f"{FINE**2} times the faces, at vertices": at_vertices(finer(mesh, FINE)),
        "glossy, read at pixels": at_pixels(shiny),
    }
    pictures = [studio.picture(vase_camera(), torch.eye(3)) for studio in studios.values()]
    return preview.sheet(pictures, list(studios), columns=4)


def resolution() -> Table:
    """What reading at vertices costs: radiance of the pixels of a picture against reading at each of its samples."""
    table = Table("a waffle on a vase, read at vertices: relative RMS error of pixels against reading at pixels")
    exact = at_pixels()
    still, radiance = exact.shaded(vase_camera(), lamps())
    wanted = still.radiance(radiance)
    for parts in (1, 2, 4, 8, FINE):
        mesh = finer(coarse(), parts)
        still, radiance = at_vertices(mesh).shaded(vase_camera(), lamps())
        table.add(f"{len(mesh.faces)} faces", error=relative_rms(still.radiance(radiance), wanted))
    return table


def animation(name: str, pictures: list[Tensor]) -> None:
    """A strip of every third frame as PNG, all as GIF."""
    strip = pictures[::3]
    preview.save_png(preview.sheet(strip, [f"frame {3 * k}" for k in range(len(strip))], columns=4), path(name, "png"))
    frames = [Image.fromarray((picture.numpy() * 255).round().astype("uint8")) for picture in pictures]
    # One palette for all frames: its own for each would make colours flicker.
    palette = Image.fromarray(torch.cat(pictures[::3]).mul(255).round().byte().numpy()).quantize(128)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    small[0].save(path(name, "gif"), save_all=True, append_images=small[1:], duration=70, loop=0, optimize=True)


def path(name: str, suffix: str) -> Path:
    return FOLDER / f"{name}.{suffix}"


TABLES = {
    "truth": truth,
    "popping": popping,
    "grooves": grooves,
    "fits": fits,
    "between": between,
    "resolution": resolution,
}
PICTURES = {"deformed": deformed, "patches": patches, "inside": inside, "wrinkled": wrinkled, "pixels": pixels}
ANIMATIONS = {"bending": bending, "flapping": flapping}


def main(names: list[str]) -> None:
    known = [*TABLES, *PICTURES, *ANIMATIONS]
    unknown = sorted(set(names) - set(known))
    if unknown:
        sys.exit(f"there is no {unknown[0]}: choose from {' '.join(known)}")
    FOLDER.mkdir(exist_ok=True)
    console = Console(width=140)
    for name in names or known:
        if name in TABLES:
            console.print(TABLES[name]())
            continue
        if name in PICTURES:
            preview.save_png(PICTURES[name](), path(name, "png"))
        else:
            animation(name, ANIMATIONS[name]())
        Image.open(path(name, "png")).convert("RGB").save(path(name, "png"), optimize=True)
        for written in sorted(FOLDER.glob(f"{name}.*")):
            print(f"{written}: {written.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])

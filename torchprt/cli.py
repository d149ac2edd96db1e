"""The `torchprt` command: one thin function a verb."""

from __future__ import annotations

import math
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from torchprt.errors import InputError
from torchprt.files import atomic, check_writable

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.transfer import DiffuseTransfer

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)

# Edge of a picture in pixels: its rays take 200 bytes each.
LARGEST = 4096
WINDOWS = ("none", "hann", "lanczos", "gauss", "auto")

Output = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]


def main() -> None:
    """Runs the command. Faults of the input are one sentence on standard error and exit code 2."""
    with warnings.catch_warnings():
        # Without the file and the line of the code that warns.
        warnings.showwarning = lambda message, *_, **__: _complain(message)
        try:
            app()
        except InputError as fault:
            _complain(fault)
            sys.exit(2)


@app.command()
def bake(
    mesh: Annotated[list[Path], typer.Argument(help="Meshes that receive light: .ply .obj .glb .gltf .stl .off")],
    output: Output,
    order: Annotated[int, typer.Option(min=1, max=64, help="SH bands of the light that it will answer to.")] = 5,
    rays: Annotated[int, typer.Option(min=1, max=1 << 22, help="Rays a vertex, over its hemisphere.")] = 1024,
    bounces: Annotated[str, typer.Option(help="How often light is reflected on: 0, 1, 2, ... or inf.")] = "0",
    albedo: Annotated[str, typer.Option(help="0.5, or r,g,b, or vertex for the colours in the file.")] = "0.5",
    two_sided: Annotated[bool, typer.Option("--two-sided", help="Surfaces reflect with both sides.")] = False,
    blocker: Annotated[list[Path] | None, typer.Option(help="A mesh that only casts shadows (repeatable).")] = None,
    unshadowed: Annotated[bool, typer.Option("--unshadowed", help="The closed form, without any ray.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Turns the set of directions.")] = 0,
    threads: Annotated[int | None, typer.Option(min=1, help="As many as there are cores by default.")] = None,
    half: Annotated[bool, typer.Option("--half", help="Store transfer in float16.")] = False,
) -> None:
    """Bake how meshes shadow and light themselves. Stopped with Ctrl-C, the same command goes on."""
    import shutil
    import time

    import torch

    import torchprt as prt

    check_writable(output, (".safetensors",))
    count, colour = _bounces(bounces), _albedo(albedo)
    scene = prt.load(mesh, albedo=colour, two_sided=two_sided, blockers=blocker or ())
    _say(scene)
    folder = output.with_name(output.name + ".partial")
    start = time.perf_counter()
    try:
        transfer = prt.bake(
            scene,
            order=order,
            rays=rays,
            bounces=count,
            shadows=not unshadowed,
            seed=seed,
            threads=threads,
            checkpoint=None if unshadowed else folder,
            keep=True,
        )
    except KeyboardInterrupt:
        kept = f"; {folder} keeps what is done, the same command goes on from there" if folder.exists() else ""
        _complain(f"stopped{kept}")
        raise typer.Exit(130) from None
    if half:
        transfer = transfer.to(torch.float16)
    prt.save_transfer(transfer, output)
    if not unshadowed:
        shutil.rmtree(folder, ignore_errors=True)
    _say(f"\n{output}: {_describe(transfer)}, baked in {time.perf_counter() - start:.1f} s")


@app.command()
def shade(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    light: Annotated[Path, typer.Option(help="An environment image, or an .npy of light coefficients.")],
    output: Annotated[Path, typer.Option("-o", "--output", help=".npy of radiance, .ply with colours, or .png.")],
    rotate: Annotated[str, typer.Option(help="Turns the environment: YAW,PITCH,ROLL in degrees.")] = "0,0,0",
    window: Annotated[str, typer.Option(help="Against ringing: none, hann, lanczos, gauss or auto.")] = "none",
    exposure: Annotated[float, typer.Option(help="In stops, for .ply and .png.")] = 0.0,
    tone: Annotated[str, typer.Option(help="filmic or none, for .ply and .png.")] = "filmic",
    size: Annotated[str, typer.Option(help="Of the .png, in pixels.")] = "800x600",
    view: Annotated[str, typer.Option(help="From the model toward the camera of the .png: X,Y,Z.")] = "0.45,0.35,1",
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Light a bake. `.npy` is linear exit radiance, V x 3, in the vertex order of the mesh file."""
    import numpy as np
    import torch

    import torchprt as prt
    from torchprt import preview, sh

    check_writable(output, (".npy", ".ply", ".png"))
    turn = sh.yaw_pitch_roll(torch.tensor(_numbers(rotate, 3, "--rotate"), dtype=torch.float64)).float()
    camera = _view(view), _size(size)
    _check_choices(window=window, tone=tone, exposure=exposure)
    loaded = prt.load_transfer(transfer)
    coefficients = _window(_light(light, loaded.order, repair), window)
    with torch.no_grad():
        radiance = prt.shader(loaded)(coefficients, turn).float()
    dark = int((loaded.normals.abs().sum(-1) == 0).sum())
    if dark:
        _say(f"{dark} of {len(radiance)} vertices have no normal and read 0")
    negative = int((radiance < 0).any(-1).sum())
    if negative:
        _say(
            f"{negative} of {len(radiance)} vertices have negative radiance, down to {float(radiance.min()):.3g}: "
            "the light rings at this order, --window auto takes that away"
        )
    if output.suffix.lower() == ".npy":
        with atomic(output) as temporary, temporary.open("wb") as stream:
            np.save(stream, radiance.contiguous().numpy())
    elif output.suffix.lower() == ".ply":
        preview.save_ply(loaded.positions, loaded.faces, preview.colours(radiance, exposure, tone), output)
    else:
        toward, (width, height) = camera
        framed = preview.frame(loaded.positions, toward, aspect=width / height)
        still = preview.Still(loaded.positions, loaded.faces, size=(width, height), camera=framed)
        preview.save_png(still.picture(radiance, exposure=exposure, tone=preview.tone_map(tone)), output)
    _say(f"{output}: {len(radiance)} vertices, mean radiance {_triple(radiance.mean(0))}")


@app.command()
def light(
    image: Annotated[Path, typer.Argument(help="Latitude-longitude environment: .exr .hdr .png .jpg .tif")],
    output: Annotated[Path, typer.Option("-o", "--output", help=".npy of order^2 x 3 coefficients.")],
    order: Annotated[int, typer.Option(min=1, max=64, help="SH bands.")] = 5,
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Project an environment image to a light."""
    from torchprt.light import write_coefficients

    check_writable(output, (".npy",))
    coefficients = _light(image, order, repair)
    write_coefficients(coefficients, output)
    _say(f"{output}: order {order}, mean radiance {_triple(coefficients[0] / math.sqrt(4 * math.pi))}")


@app.command()
def export(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The .onnx to write.")],
    source: Annotated[str, typer.Option("--from", help="What the graph takes: light or environment.")] = "light",
    size: Annotated[int, typer.Option(help="Texels along an edge of the environment's cube map.")] = 32,
) -> None:
    """Write one self-contained .onnx and compare it with torch in ONNX Runtime."""
    import torchprt as prt

    check_writable(output, (".onnx",))
    if source not in ("light", "environment"):
        raise InputError(f"--from is '{source}': give light or environment")
    kind: Literal["light", "environment"] = "light" if source == "light" else "environment"
    report = prt.onnx.export(prt.load_transfer(transfer), output, source=kind, size=size)
    _say(report)
    if report.parity is not None:
        _say(report.parity)


@app.command()
def info(file: Annotated[Path, typer.Argument(help="A transfer, an .onnx, a light, an image or a mesh.")]) -> None:
    """Say what a file holds."""
    import torchprt as prt

    suffix = file.suffix.lower()
    if suffix == ".safetensors":
        loaded = prt.load_transfer(file)
        _say(f"{file}: {_describe(loaded)}")
        _say(f"{loaded.vertices} receivers, {len(loaded.faces)} faces, albedo {_albedo_of(loaded)}")
        _say(f"{loaded.rays} rays a receiver, seed {loaded.seed}, baked by torchprt {loaded.version}")
    elif suffix == ".onnx":
        for name, value in prt.onnx.describe(file).items():
            _say(f"{name}: {value}")
    elif suffix == ".npy":
        coefficients = prt.light.read_coefficients(file)
        order = math.isqrt(len(coefficients))
        _say(f"{file}: light of order {order}, mean radiance {_triple(coefficients[0] / math.sqrt(4 * math.pi))}")
    elif suffix in (".ply", ".obj", ".glb", ".gltf", ".stl", ".off"):
        _say(prt.load(file))
    else:
        image, report = prt.light.read_with_report(file, repair=True)
        _say(f"{file}: {image.shape[1]} x {image.shape[0]} pixels\n{report}")


@app.command()
def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for what it makes.")] = Path("demo"),
) -> None:
    """Bake, relight and export the project's own samples; write pictures of all of it."""
    from torchprt.demo import run

    run(output, _say)


def _say(what: Any) -> None:
    print(what, flush=True)


def _complain(what: Any) -> None:
    print(f"torchprt: {what}", file=sys.stderr, flush=True)


def _bounces(text: str) -> int | float:
    if text == "inf":
        return math.inf
    try:
        return int(text)
    except ValueError:
        raise InputError(f"--bounces is '{text}': give a whole number or inf") from None


def _albedo(text: str) -> Any:
    if text == "vertex":
        return text
    numbers = _numbers(text, None, "--albedo")
    if len(numbers) not in (1, 3):
        raise InputError(f"--albedo is '{text}': give one number, three (r,g,b), or vertex")
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


def _numbers(text: str, count: int | None, option: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} is '{text}': give numbers with commas between them") from None
    if count is not None and len(numbers) != count:
        raise InputError(f"{option} is '{text}': give {count} numbers with commas between them")
    if not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{option} is '{text}': the numbers must be finite")
    return numbers


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 1 <= int(width) <= LARGEST and 1 <= int(height) <= LARGEST):
        raise InputError(f"--size is '{text}': give WIDTHxHEIGHT in pixels, up to {LARGEST}x{LARGEST}")
    return int(width), int(height)


def _view(text: str) -> tuple[float, float, float]:
    x, y, z = _numbers(text, 3, "--view")
    if not (x or y or z):
        raise InputError(f"--view is '{text}': give a direction, at least one number other than 0")
    return x, y, z


def _check_choices(window: str, tone: str, exposure: float) -> None:
    if window not in WINDOWS:
        raise InputError(f"--window is '{window}': give {', '.join(WINDOWS[:-1])} or {WINDOWS[-1]}")
    if tone not in ("filmic", "none"):
        raise InputError(f"--tone is '{tone}': give filmic or none")
    if not abs(exposure) <= 100:
        raise InputError(f"--exposure is {exposure}: give stops from -100 to 100")


def _light(path: Path, order: int, repair: bool) -> Tensor:
    """A light of `order` from coefficients or an image, whose damage is told."""
    from torchprt import light

    if path.suffix.lower() == ".npy":
        return light.read_coefficients(path, order)
    image, report = light.read_with_report(path, repair=repair)
    if report.damaged:
        _say(f"{path}: {report}")
    if image.shape[1] != 2 * image.shape[0]:
        raise InputError(
            f"{path} is {image.shape[1]} x {image.shape[0]} pixels: an environment is a latitude-longitude map, "
            "twice as wide as high"
        )
    return light.project(image, order)


def _window(coefficients: Tensor, name: str) -> Tensor:
    from torchprt import sh

    order = math.isqrt(len(coefficients))
    if name == "none":
        return coefficients
    if name == "auto":
        windowed, factors = sh.least_window(coefficients)
        _say(f"the least window that keeps the light positive leaves {float(factors[-1]):.0%} of the highest band")
        return windowed
    chosen = {"hann": sh.hann, "lanczos": sh.lanczos, "gauss": sh.gauss}[name]
    return sh.window(coefficients, chosen(order, dtype=coefficients.dtype))


def _describe(transfer: DiffuseTransfer) -> str:
    bounces = f", {transfer.bounces} bounces" if transfer.bounces else ""
    channels = "3 channels" if transfer.channels == 3 else "1 channel"
    dtype = str(transfer.transfer.dtype).removeprefix("torch.")
    text = f"{transfer.kind}, {transfer.transport}{bounces}, order {transfer.order}, {channels}, "
    text += f"{transfer.vertices} vertices, {transfer.bytes / 2**20:.1f} MB of {dtype}"
    if transfer.error is not None and transfer.signal:
        text += f", error {transfer.error / transfer.signal:.2%} (RMS, Monte Carlo estimate)"
    return text


def _albedo_of(transfer: DiffuseTransfer) -> str:
    if len(transfer.albedo) == 1:
        return ", ".join(f"{value:.3g}" for value in transfer.albedo[0].tolist())
    return f"of every vertex, mean {_triple(transfer.albedo.expand(-1, 3).mean(0))}"


def _triple(values: Tensor) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*values.tolist())

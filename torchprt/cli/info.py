"""`torchprt info`: what a file holds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli.report import describe, details, say, triple
from torchprt.words import count


def info(file: Annotated[Path, typer.Argument(help="A transfer, an .onnx, a light, an image or a mesh.")]) -> None:
    """Say what a file holds."""
    import torchprt as prt

    suffix = file.suffix.lower()
    if suffix == ".safetensors":
        loaded = prt.load_transfer(file)
        say(f"{file}: {describe(loaded)}")
        for line in details(loaded):
            say(line)
        say(f"{count(loaded.rays, 'ray')} a receiver, seed {loaded.seed}, baked by torchprt {loaded.version}")
    elif suffix == ".onnx":
        for name, value in prt.onnx.describe(file).items():
            say(f"{name}: {value}")
    elif suffix == ".npy":
        coefficients = prt.light.read_coefficients(file)
        order = math.isqrt(len(coefficients))
        say(f"{file}: light of order {order}, mean radiance {triple(coefficients[0] / math.sqrt(4 * math.pi))}")
    elif suffix in (".ply", ".obj", ".glb", ".gltf", ".stl", ".off", ".toml"):
        say(prt.load(file))
    else:
        image, report = prt.light.read_with_report(file, repair=True)
        say(f"{file}: {image.shape[1]} x {image.shape[0]} pixels\n{report}")

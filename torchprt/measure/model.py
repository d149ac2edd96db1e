"""From a recipe to what runs: the bake, what is stored of it, the light it is put under, a call that shades."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import compression
from torchprt.errors import InputError
from torchprt.files import temporary_folder
from torchprt.light import windowed
from torchprt.measure.recipe import Recipe
from torchprt.progress import Report
from torchprt.scene import Scene
from torchprt.shade import AdaptiveShader, Shader, shader
from torchprt.transfer import Transfer
from torchprt.transport import OrderWarning, bake

# Thresholds of layers that depend on the eye, in those of the others: as `AdaptiveShader` has them.
_GLOSSY = 2.0
Frame = Callable[[], Float[Tensor, "B V 3"]]
"""One frame: the radiance of all receivers under the lights."""
Runner = Callable[[Float[Tensor, "B N 3"], Float[Tensor, "3"] | None], Float[Tensor, "B V 3"]]
"""What shades: lights as the recipe uses them, float32, and the eye if what is stored depends on one."""


def bake_recipe(scene: Scene, recipe: Recipe, **arguments: Any) -> Transfer:
    """What the recipe bakes of the scene, dense. `arguments`: those of `bake` that a recipe leaves open.

    Raises InputError as `bake`, and for a `frame` of a scene without gloss.
    """
    given: dict[str, Any] = recipe.part("bake")
    with warnings.catch_warnings():
        # Its error is what is measured.
        warnings.simplefilter("ignore", OrderWarning)
        return bake(scene, **{**given, **arguments})


def store_recipe(transfer: Transfer, recipe: Recipe, report: Report | None = None) -> Transfer:
    """What the recipe stores of its bake. Clusters are of the layer that takes the most bytes; lobes of all.

    Raises InputError as `compress` and `fit`.
    """
    if recipe.clusters is not None:
        layer = max(transfer.layers, key=lambda name: transfer.layers[name].bytes)
        return compression.compress(
            transfer,
            layer=layer,
            clusters=recipe.clusters,
            components=recipe.components,
            shared=recipe.shared,
            bits=recipe.bits or 32,
            report=report,
        )
    if recipe.lobes is not None:
        transfer = compression.fit(transfer, lobes=recipe.lobes, report=report)
    return transfer if recipe.dtype == "float32" else transfer.to(getattr(torch, recipe.dtype))


def light_under(recipe: Recipe, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B n 3"]:
    """The light as the recipe uses it: its first bands, under the window.

    Raises InputError if it has fewer bands than the recipe.
    """
    if light.shape[-2] < recipe.order**2:
        raise InputError(f"light has {light.shape[-2]} coefficients: order {recipe.order} has {recipe.order**2}")
    return windowed(light[..., : recipe.order**2, :], recipe.window)


def frame_of(
    transfer: Transfer, recipe: Recipe, light: Float[Tensor, "B N 3"], eye: Float[Tensor, "3"] | None = None
) -> Frame:
    """A call that shades what is stored under the lights, toward the eye, as the recipe runs it.

    `light` is of any order from that of the recipe on. Everything that a frame need not do again (compiling, a session
    of ONNX Runtime) is done here. Raises InputError as `shader`, and without an eye if it needs one.
    """
    run = runner_of(transfer, recipe)
    used = light_under(recipe, light).float()
    seen = _seen(transfer, eye)
    return lambda: run(used, seen)


def runner_of(transfer: Transfer, recipe: Recipe) -> Runner:
    """What shades what is stored as the recipe runs it, for any light of the recipe's order and any eye.

    The first call of a compiled one, and of another number of lights, compiles. Raises InputError as `shader`.
    """
    if recipe.runtime == "onnx":
        return _graph(transfer)
    module = shader(transfer, dtype=torch.bfloat16 if recipe.dtype == "bfloat16" else torch.float32)
    call: Callable[..., Tensor] = torch.compile(module) if recipe.runtime == "compiled" else module
    if recipe.adaptive is not None:
        call = _adaptive(module, transfer, recipe.adaptive)
    by_eye = "eye" in transfer.needs

    def run(light: Tensor, eye: Tensor | None = None) -> Tensor:
        seen = _seen(transfer, eye) if by_eye else None
        with torch.no_grad():
            return call(light) if seen is None else call(light, eye=seen)

    return run


def _adaptive(module: Shader, transfer: Transfer, threshold: float) -> Callable[..., Tensor]:
    """A frame without one before it."""
    shade = AdaptiveShader(module, transfer.faces, diffuse=threshold, specular=_GLOSSY * threshold)
    return lambda light, **seen: shade(light, **seen).radiance


def _seen(transfer: Transfer, eye: Float[Tensor, "3"] | None) -> Float[Tensor, "3"] | None:
    """The eye, if what is stored depends on one."""
    if "eye" not in transfer.needs:
        return None
    if eye is None:
        raise InputError("the scene is glossy: give an eye")
    return eye.float()


def _graph(transfer: Transfer) -> Runner:
    import onnxruntime

    from torchprt.onnx import export

    by_eye = "eye" in transfer.needs
    pose: Literal["frames", "positions"] | None = None
    if "pose" in transfer.needs:
        pose = "positions" if by_eye else "frames"
    with temporary_folder() as folder:
        path = Path(folder) / "model.onnx"
        export(transfer, path, check=False, pose=pose)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        options.log_severity_level = 3
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    posed = {}
    if pose == "frames":
        posed = {"frames": torch.eye(3).repeat(transfer.vertices, 1, 1).numpy()}
    if pose == "positions":
        posed = {"positions": transfer.positions.float().numpy()}

    def run(light: Tensor, eye: Tensor | None = None) -> Tensor:
        count = len(light)
        inputs = {"light": light.numpy(), "rotation": torch.eye(3).expand(count, 3, 3).numpy(), **posed}
        seen = _seen(transfer, eye)
        if seen is not None:
            inputs["eye"] = seen.expand(count, 3).numpy()
        return torch.from_numpy(session.run(None, inputs)[0])

    return run

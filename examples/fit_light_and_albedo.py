"""Finds the light and the albedo of a scene from its pictures alone, by gradient descent through a baked shader.

    python examples/fit_light_and_albedo.py --output fit.png

A box with coloured walls is baked without its colours. Under four unknown lights, one environment in four known
orientations, it gives the radiance that a photographer would measure at every vertex. From that both are
recovered: the 25 x 3 coefficients of the light and the RGB albedo of every vertex.

Only the product of the two is seen: a light twice as bright on a surface half as white looks the same. So the scale of
the albedo is fixed, here by its mean in each channel, which is taken as known (a grey card in the picture would do).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

import torchprt as prt
from torchprt import preview, sh
from torchprt.measure import relative_rms

ORDER = 5


def fit(radiance: Tensor, transfer: prt.Transfer, turns: Tensor, mean: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Light `[N, 3]` and albedo `[V, 3]` whose radiance under the rotations `turns [B, 3, 3]` is `radiance [B, V, 3]`.

    `mean [3]` is the mean of the albedo over the vertices that receive light.
    """
    shader = prt.shader(transfer, dtype=torch.float64, learn=["albedo"])
    reflected = shader.layers["diffuse"].albedo
    light = torch.nn.Parameter(prt.light.constant(1.0, ORDER).double())
    turns, radiance = turns.double(), radiance.double()
    size = radiance.square().mean()
    optimiser = torch.optim.LBFGS(
        [light, reflected],
        max_iter=steps,
        history_size=50,
        tolerance_grad=0,
        tolerance_change=0,
        line_search_fn="strong_wolfe",
    )
    errors = []

    def closure() -> Tensor:
        optimiser.zero_grad()
        loss = (shader(light, turns) - radiance).square().mean() / size
        loss.backward()
        errors.append(loss.detach().sqrt().item())
        return loss

    optimiser.step(closure)
    for step in range(0, len(errors), max(1, len(errors) // 5)):
        print(f"evaluation {step}: relative RMS error of the radiance {errors[step]:.3%}")
    # What one factor loses the other takes up: the radiance does not change.
    scale = mean.double() / reflected.detach()[lit(transfer)].mean(0)
    return (light.detach() / scale).float(), (reflected.detach() * scale).float()


def lit(transfer: prt.Transfer) -> Tensor:
    """Which vertices receive light, bool `[V]`."""
    return transfer.layers["diffuse"].signal.dense().values.abs().sum((0, 1)) > 0


def with_albedo(transfer: prt.Transfer, albedo: Tensor) -> prt.Transfer:
    """The same surface in other colours."""
    return transfer.with_layers(diffuse=transfer.layers["diffuse"].replace(albedo=albedo))


def main(arguments: list[str] | None = None) -> dict[str, float]:
    """Runs the example; the errors that are left, relative RMS."""
    parser = argparse.ArgumentParser(description="Find light and albedo of a box from its radiance.")
    parser.add_argument("--output", type=Path, default=Path("fit.png"), help="picture of true, start and found")
    parser.add_argument("--resolution", type=int, default=32, help="squares along each wall")
    parser.add_argument("--rays", type=int, default=512)
    parser.add_argument("--steps", type=int, default=400, help="steps of L-BFGS")
    given = parser.parse_args(arguments)

    # Learning an albedo needs a bake without bounces: with them it is part of what other surfaces receive.
    transfer = prt.bake(prt.samples.coloured_box(given.resolution), order=ORDER, rays=given.rays, progress=False)
    true_albedo, true_light = transfer.albedo, prt.light.project(prt.light.studio(128), ORDER)
    seen = lit(transfer)
    turns = sh.yaw_pitch_roll(torch.tensor([[0.0, 0, 0], [90, 0, 0], [180, 0, 0], [270, 0, 0]]))
    with torch.no_grad():
        radiance = prt.shader(transfer)(true_light, turns)

    grey = torch.full_like(true_albedo, 0.5)
    unknown = with_albedo(transfer, grey)
    light, albedo = fit(radiance, unknown, turns, true_albedo[seen].mean(0), given.steps)

    with torch.no_grad():
        again = prt.shader(with_albedo(transfer, albedo.clamp(0, 1)))(light, turns)
        start = prt.shader(unknown)(prt.light.constant(1.0, ORDER).float())
    errors = {
        "light": relative_rms(light, true_light),
        "albedo": relative_rms(albedo[seen], true_albedo[seen]),
        "radiance": relative_rms(again, radiance),
    }
    for name, error in errors.items():
        print(f"relative RMS error of the {name}: {error:.2%}")

    camera = preview.frame(transfer.positions, (0.0, 0.08, 1.0), aspect=1.0)
    still = preview.Still(transfer.positions, transfer.faces, size=(320, 320), camera=camera)
    pictures = {
        "target": still.picture(radiance[0], exposure=-1.0),
        "start": still.picture(start, exposure=-1.0),
        "found": still.picture(again[0], exposure=-1.0),
        "true albedo": still.picture(true_albedo, tone="none"),
        "albedo at the start": still.picture(grey, tone="none"),
        "albedo found": still.picture(albedo, tone="none"),
    }
    preview.save_png(preview.sheet(list(pictures.values()), list(pictures), columns=3), given.output)
    print(f"wrote {given.output}")
    return errors


if __name__ == "__main__":
    main()

"""The frames of glossy transfer side by side: what each costs and what it loses on one scene."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import words
from torchprt.errors import InputError
from torchprt.measure.error import relative_rms
from torchprt.measure.exit_radiance import exit_radiance, exit_radiance_by_brute_force, random_lights
from torchprt.measure.sample import sample_receivers, sample_transfer
from torchprt.measure.table import Table
from torchprt.measure.time import Timing, time_it
from torchprt.scene import Scene
from torchprt.sh import order_of
from torchprt.shade import Shader, shader
from torchprt.transport import OrderWarning, bake, hemisphere

_REFERENCE_RAYS = 1 << 14


def compare_frames(
    scene: Scene,
    light: Float[Tensor, "B N 3"] | None = None,
    *,
    order: int = 5,
    output_orders: Sequence[int] | None = None,
    factors: Sequence[int] = (),
    visibility_orders: Sequence[int] | None = None,
    rays: int = 1024,
    count: int = 64,
    views: int = 64,
    seed: int = 0,
    rounds: int = 5,
) -> Table:
    """The ways to store the shadowed glossy transfer of `scene`, which has one glossy material, in one table.

    Rows are matrices of every one of `output_orders` (by default `order` and the one below, and `order` under the
    projection "zero"), factored matrices of as many rows as `factors` say, incident matrices of `order` whose
    reflectance is chosen at run time, and visibility of every one of `visibility_orders` (`order` and twice that).
    - error: relative RMS of exit radiance of `count` receivers of the scene toward `views` directions that are uniform
      on the hemisphere, under `light` (8 `random_lights` if omitted), against brute force with 16384 rays. The noise
      of the `rays` of the bake is in it.
    - seconds: CPU time of one light and one eye on all glossy receivers; "eye moves": of another eye under a light that
      is fixed, in milliseconds. Limit torch to one thread first.
    - bytes of all glossy receivers; "numbers": what a receiver stores.
    Only the `count` receivers are baked; times are of their transfer repeated for as many receivers as there are.

    Raises InputError if the scene has not exactly one glossy material, `light` is not of `order`, `count` or `views`
    is below 1, or as `bake` and `brdf.factor`.
    """
    geometry = scene.geometry()
    if len(geometry.gloss) != 1:
        raise InputError(f"the scene has {len(geometry.gloss)} glossy materials: compare frames for one")
    if light is None:
        light = random_lights(8, order, seed)
    if order_of(light.shape[-2]) != order:
        raise InputError(f"light has {light.shape[-2]} coefficients: order {order} has {order**2}")
    if views < 1:
        raise InputError(f"views is {views}: give at least 1")
    brdf = geometry.gloss[0]
    few, chosen = sample_receivers(scene, count, seed)
    directions = hemisphere(views, seed + 1)
    # Another seed than that of the bake: the same directions would share its noise.
    wanted = exit_radiance_by_brute_force(few, chosen, directions, light, rays=_REFERENCE_RAYS, seed=seed + 1)
    repeated = chosen[torch.arange(len(geometry.glossy)) % len(chosen)]
    table = Table(f"{brdf.spec}, order {order}, {words.count(len(geometry.glossy), 'glossy receiver')}")
    for name, options in _ways(order, output_orders, factors, visibility_orders).items():
        with warnings.catch_warnings():
            # The errors are what is asked for here.
            warnings.simplefilter("ignore", OrderWarning)
            transfer = bake(few, order=order, rays=rays, seed=seed, progress=False, **options)
        chain = brdf if "reflectance" in transfer.needs else None
        exact = shader(sample_transfer(transfer, chosen), dtype=torch.float64, brdf=chain)
        full = sample_transfer(transfer, repeated)
        error = relative_rms(exit_radiance(exact, directions, light), wanted)
        times = _times(shader(full, brdf=chain), full.positions, light[:1].float(), rounds)
        _, _, matrix_rows, columns = list(full.layers.values())[-1].signal.shape
        extra = {"numbers": matrix_rows * columns * full.channels, "eye moves, ms": 1e3 * times["eye moves"].median}
        table.add(name, error=error, seconds=times["all"], bytes=full.bytes, extra=extra)
    return table


def _times(
    module: Shader, positions: Float[Tensor, "G 3"], light: Float[Tensor, "1 N 3"], rounds: int
) -> dict[str, Timing]:
    # An eye outside the scene, as most are.
    eye = 2 * positions.abs().amax(0) + 1
    with torch.no_grad():
        fixed = module.fix_light(light)
        return time_it({"all": lambda: module(light, eye=eye), "eye moves": lambda: fixed(eye=eye)}, rounds=rounds)


def _ways(
    order: int,
    output_orders: Sequence[int] | None,
    factors: Sequence[int],
    visibility_orders: Sequence[int] | None,
) -> dict[str, dict[str, Any]]:
    """Options of `bake` by the name of a row."""
    ways: dict[str, dict[str, Any]] = {}
    for output_order in output_orders if output_orders is not None else (order, max(1, order - 1)):
        ways[f"exit, output order {output_order}"] = {"output_order": output_order}
    ways[f"exit, output order {order}, zero"] = {"projection": "zero"}
    for rows in factors:
        ways[f"exit, factored, {rows} rows"] = {"factors": rows}
    ways[f"incident, output order {order}"] = {"frame": "incident"}
    for bands in visibility_orders if visibility_orders is not None else (order, 2 * order):
        ways[f"visibility, order {bands}"] = {"frame": "visibility", "visibility_order": bands}
    return ways

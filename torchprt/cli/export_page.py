"""What `torchprt export --web` and `--three` write: the folder of a page, that of a scene."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from torchprt.cli.environments import environment_of
from torchprt.cli.report import say
from torchprt.errors import InputError

# Of a flight, between which the page goes straight on.
POSES = 97

if TYPE_CHECKING:
    from torchprt.brdf import Brdf
    from torchprt.transfer import Transfer


def export_page(
    transfer: Transfer,
    folder: Path,
    lights: Sequence[str] | None,
    compressed: Path | None,
    title: str,
    gloss: Brdf | None,
    with_ground: bool = False,
    exact: bool = False,
    flight: tuple[Path, Path, str] | None = None,
    gpu: bool = False,
) -> None:
    """Writes the page of `--web` and says how to look at it; `gloss` is what `transfer` left open.

    `compressed` is shown without its ground, as `transfer` is, unless it is to be `with_ground`. `flight`: the
    neighbourhood of an object, its bake and its path.
    """
    from torchprt import web
    from torchprt.shade import with_material
    from torchprt.transfer import load

    start = time.perf_counter()
    packed = None if compressed is None else load(compressed)
    if packed is not None and not with_ground:
        packed = packed.without_ground()
    if packed is not None and gloss is not None and "reflectance" in packed.needs:
        packed = with_material(packed, gloss)
    environments = None if lights is None else [environment_of(each, transfer.order, repair=False) for each in lights]
    flies = None
    if flight is not None:
        from torchprt import preview
        from torchprt.cli.cast import keys_of

        keys = keys_of(flight[2])
        poses = preview.along(keys, POSES if len(keys) > 1 else 1)
        flies = web.Flight(load(flight[0]), load(flight[1]), poses)
    report = web.export(
        transfer, folder, environments=environments, compressed=packed, title=title, exact=exact, flight=flies, gpu=gpu
    )
    say(f"{report}, written in {time.perf_counter() - start:.1f} s")
    if report.parity is not None:
        say(report.parity)
    if report.losses():
        say(report.losses())
    say(f"look at it with: torchprt serve {folder}")


def export_scene(
    transfer: Transfer,
    folder: Path,
    lights: Sequence[str] | None,
    title: str,
    exact: bool,
    order: int | None,
    given: Path | None,
    near: Path,
) -> None:
    """Writes the folder of `--three` and says how it is used; `given`, or what lies `near`, is the glTF of the bake."""
    from torchprt import web
    from torchprt.preview import find_asset

    environments = None if lights is None else [environment_of(each, transfer.order, repair=False) for each in lights]
    asset, why = None, "a plain mesh, whose texture coordinates are its places on the map"
    if transfer.receivers.kind == "vertices":
        asset, why = find_asset(transfer, given, near)
    elif given is not None:
        raise InputError("--source is given, but a map is drawn on a plain mesh: leave it out")
    report = web.export_three(
        transfer, folder, environments=environments, order=order, asset=asset, title=title, exact=exact
    )
    say(report)
    what = f"{web.three.MODEL}: {why}"
    if order is not None:
        say(f"{what}; transfer of order {order} in its attributes, for any shader")
    else:
        say(f"{what}; {web.three.TRANSFER}: {count_bytes(report.transfer_bytes, transfer.vertices)}")
    if transfer.receivers.mirrors is not None:
        say("its mirrors are left out: a scene of three.js has its own")
    say(f"look at it with: torchprt serve {folder}")


def count_bytes(size: int, receivers: int) -> str:
    """Bytes as megabytes, and of each receiver."""
    return f"{size / 2**20:.2f} MB, {size / max(receivers, 1):.0f} bytes a receiver"

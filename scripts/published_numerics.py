"""Writes docs/numerics.md: what every kernel loses, in epsilons of its type, at the worst of its arguments.

    python scripts/published_numerics.py [PAGE] [--only NAME ...]

The kernels are those of tests/numerics/kernels.py, the arguments those of tests/numerics/extremes.py.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import torch

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from numerics import kernels, measured  # noqa: E402
from numerics.kernels import Kernel  # noqa: E402

from torchprt.errors import InputError  # noqa: E402

USABLE = 1e-3
HEAD = """# Numbers at their limits

Written by `scripts/published_numerics.py`, which `scripts/reproduce` runs; not by hand. Torch {torch}, on a CPU.

Every figure is the largest difference, relative to the largest value of the result, in epsilons of the type:
{epsilons}.

It is that of the worst of the arguments tried: plain ones, and each argument in turn at its extremes. Those are lights
of 0, 1e-30, 1e30, of denormal numbers, and one hot texel of 1e6 in a dark map; directions on the axes and poles, 1e-4,
an epsilon, 1e-20 and a denormal number off them; vectors as long and as short as the type holds; rotations by nothing,
by half turns, 1e-8 from both, where angles lock; poses 1e-15 and 1e15 in size; what the type cannot hold is left out.
`tests/numerics` tries the same arguments, and that gradients there are finite and those of float64.

The reference is what the very numbers that were given lead to, in the way that "against" says; where it says float64,
the kernel itself in float64, and nothing is known of its own digits. The rotation that a narrow type cannot hold is the
one nearest to it.
"""
BY_ORDER = """## By order of the light

"ends" is the first of these orders at which the error exceeds {usable:g} of the largest value; in bfloat16 half an
epsilon is more than that. What is refused stands below; all else goes on, with the errors that the rows say.
"""
ONCE = """No more than half an epsilon, the rounding of the result, is lost in float16 and bfloat16 at any of these
orders by {names}.
"""
AT_ONCE = """## {title}

{about}
"""
REFUSED = """## What is refused

| kernel | says |
|---|---|
"""


def short(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


def types(kernel: Kernel) -> list[torch.dtype]:
    """Those it takes; float64 only if something else says what is right."""
    return [
        dtype
        for dtype in measured.DTYPES
        if (kernel.narrow or torch.finfo(dtype).bits >= 32) and (kernel.reference or dtype != torch.float64)
    ]


def figure(epsilons: float) -> str:
    return "0" if epsilons < 5e-4 else f"{epsilons:.2g}" if epsilons < 99.5 else f"{epsilons:.0f}"


def worst(kernel: Kernel, order: int, dtype: torch.dtype) -> tuple[float, str]:
    lost = measured.losses(kernel, order, dtype)
    name = max(lost, key=lambda each: lost[each])
    return lost[name], name


def by_order(chosen: Sequence[Kernel], tell: Callable[[str], None]) -> str:
    once = []
    lines = [
        f"| kernel | against | type | {' | '.join(map(str, kernels.ORDERS))} | ends | worst at the highest |",
        "|---|---|---" + "|---" * (len(kernels.ORDERS) + 2) + "|",
    ]
    for kernel in chosen:
        largest = 0.0
        for dtype in types(kernel):
            tell(f"{kernel.name} {short(dtype)}")
            found = {order: worst(kernel, order, dtype) for order in kernel.orders}
            beyond = [order for order, (eps, _) in found.items() if not eps * torch.finfo(dtype).eps <= USABLE]
            cells = [figure(found[order][0]) if order in found else "" for order in kernels.ORDERS]
            ends = str(beyond[0]) if beyond else f"not to {kernel.orders[-1]}"
            against = kernel.against or "float64"
            row = [f"`{kernel.name}`", against, short(dtype), *cells, ends, found[kernel.orders[-1]][1]]
            lines.append(f"| {' | '.join(row)} |")
            if torch.finfo(dtype).bits < 32:
                largest = max(largest, *(eps for eps, _ in found.values()))
        if kernel.narrow and largest <= 0.5:
            once.append(f"`{kernel.name}`")
    said = "\n" + ONCE.format(names=", ".join(once)) if once else ""
    return "\n".join(lines) + "\n" + said


def at_once(chosen: Sequence[Kernel], tell: Callable[[str], None]) -> str:
    shown = [dtype for dtype in measured.DTYPES if any(dtype in types(kernel) for kernel in chosen)]
    lines = [
        f"| kernel | {' | '.join(map(short, shown))} | worst of float32 at |",
        "|---" * (len(shown) + 2) + "|",
    ]
    for kernel in chosen:
        tell(kernel.name)
        order = kernel.orders[-1]
        found = {dtype: worst(kernel, order, dtype) for dtype in types(kernel)}
        cells = [figure(found[dtype][0]) if dtype in found else "" for dtype in shown]
        lines.append(f"| {' | '.join([f'`{kernel.name}`', *cells, found[torch.float32][1]])} |")
    return "\n".join(lines) + "\n"


def refusals(chosen: Sequence[Kernel]) -> str:
    lines = []
    for kernel in chosen:
        for call in kernel.ends:
            try:
                call()
            except InputError as fault:
                lines.append(f"| `{kernel.name}` | {fault} |")
            else:
                raise AssertionError(f"{kernel.name} refuses less than its entry says")
    return REFUSED + "\n".join(lines) + "\n"


ABOUT = {
    "Reflectance": (kernels.REFLECTANCE, "Every pair of directions up to a thousandth above the horizon."),
    "Poses": (kernels.POSES, "Nine vertices of a bumpy square."),
    "Tone maps": (kernels.TONES, "Radiance from 0 to 1e30."),
    "Shaders": (
        kernels.SHADERS,
        f"Each layer with each signal, order {kernels.SHADERS[0].orders[0]}, one or three channels, over a diffuse\n"
        "layer. Factored layers read a table of random numbers, which changes as functions of order 32.",
    ),
}


def page(only: Sequence[str] = (), tell: Callable[[str], None] = lambda line: None) -> str:
    """The page, of the kernels that are named or of all."""

    def some(group: Sequence[Kernel]) -> list[Kernel]:
        return [kernel for kernel in group if not only or kernel.name in only]

    epsilons = ", ".join(f"{torch.finfo(dtype).eps:.2g} in {short(dtype)}" for dtype in measured.DTYPES)
    parts = [HEAD.format(torch=torch.__version__.split("+")[0], epsilons=epsilons)]
    orders = some((*kernels.ALGEBRA, *kernels.LIGHTS))
    if orders:
        parts.append(BY_ORDER.format(usable=USABLE) + "\n" + by_order(orders, tell))
    for title, (group, about) in ABOUT.items():
        if chosen := some(group):
            parts.append(AT_ONCE.format(title=title, about=about) + "\n" + at_once(chosen, tell))
    if any(kernel.ends for kernel in some(kernels.KERNELS)):
        parts.append(refusals(some(kernels.KERNELS)))
    return "\n".join(parts)


def run() -> None:
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description="Writes what every kernel loses.")
    parser.add_argument("page", nargs="?", type=Path, default=ROOT / "docs" / "numerics.md")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME")
    given = parser.parse_args()
    unknown = set(given.only) - {kernel.name for kernel in kernels.KERNELS}
    if unknown:
        parser.error(f"there is no kernel {', '.join(sorted(unknown))}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = page(given.only, lambda line: print(line, file=sys.stderr, flush=True))
    given.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    run()

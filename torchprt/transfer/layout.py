"""What the tensors of a transfer must look like: parts that say it of themselves, and the checks of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.pieces import pieces

FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
REAL = (torch.float32, torch.float64)
WHOLE = (torch.int32, torch.int64)
# Numbers that are checked at a time.
_NUMBERS = 1 << 20


@dataclass(frozen=True)
class Layout:
    """Shape letters and dtypes that a tensor must have; equal letters of one part mean equal sizes.

    A letter with an alternative, as `V|1`, also accepts the literal size behind the bar, which then says nothing of
    other tensors. An `optional` tensor may be None.
    """

    shape: tuple[str, ...]
    dtypes: tuple[torch.dtype, ...] = FLOATS
    optional: bool = False


P = TypeVar("P", bound="Part")


@dataclass(kw_only=True, repr=False)
class Part:
    """A dataclass of tensors, which `layouts` describe by name, and of plain metadata, which JSON can hold.

    `kind` names it in a file, among those of its family (receivers, layers or signals): a class that has a `kind` is
    entered there when it is defined, and can then be read and written.
    Raises InputError when it is made if a tensor does not have its layout.
    """

    kind: ClassVar[str]
    layouts: ClassVar[dict[str, Layout]] = {}
    family: ClassVar[dict[str, type[Any]]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "kind" in cls.__dict__:
            cls.family[cls.kind] = cls

    def __post_init__(self) -> None:
        self.sizes()

    def tensors(self) -> dict[str, Tensor]:
        """Its tensors by name, without those that are None."""
        found = {name: getattr(self, name) for name in self.layouts}
        return {name: value for name, value in found.items() if value is not None}

    def metadata(self) -> dict[str, Any]:
        """Its other fields, but for parts of their own."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: v for name, v in fields.items() if name not in self.layouts and not isinstance(v, Part)}

    def __repr__(self) -> str:
        """What it is: shapes and dtypes of its tensors, and its other fields, not all its numbers."""
        shapes = [
            f"{name}={str(value.dtype).removeprefix('torch.')}{list(value.shape)}"
            for name, value in self.tensors().items()
        ]
        fields = (getattr(self, field.name) for field in dataclasses.fields(self))
        parts = [repr(value) for value in fields if isinstance(value, Part)]
        known = [f"{name}={value!r}" for name, value in self.metadata().items() if value is not None]
        return f"{type(self).__name__}({', '.join([*parts, *shapes, *known])})"

    def sizes(self) -> dict[str, int]:
        """Size of every shape letter; InputError where a tensor does not have its layout."""
        sizes: dict[str, int] = {}
        for name, layout in self.layouts.items():
            value = getattr(self, name)
            if value is None and layout.optional:
                continue
            if value.dtype not in layout.dtypes:
                expected = " or ".join(str(dtype).removeprefix("torch.") for dtype in layout.dtypes)
                found = str(value.dtype).removeprefix("torch.")
                raise InputError(f"tensor '{name}' of the transfer is {found}: it must be {expected}")
            wanted = f"tensor '{name}' of the transfer has shape {list(value.shape)}: it must be "
            wanted += f"[{', '.join(layout.shape)}]"
            if value.ndim != len(layout.shape):
                raise InputError(wanted)
            for size, letters in zip(value.shape, layout.shape, strict=True):
                options = {int(each) if each.isdigit() else sizes.get(each, size) for each in letters.split("|")}
                if size not in options:
                    known = ", ".join(f"{letter} = {count}" for letter, count in sizes.items())
                    raise InputError(f"{wanted} with {known}" if known else wanted)
                letter, *literal = letters.split("|")
                if letter.isalpha() and str(size) not in literal:
                    sizes[letter] = size
        return sizes

    def check(self, of: str = "") -> None:
        """InputError naming the first tensor that holds NaN or infinity, after what it is `of`."""
        for name, value in self.tensors().items():
            bad = _not_finite(value) if value.is_floating_point() else 0
            if bad:
                raise InputError(
                    f"tensor '{of}{name}' of the transfer holds {bad} NaN or infinite values: bake it again"
                )

    def replace(self: P, **changes: Any) -> P:
        """The same with other values in some fields."""
        return dataclasses.replace(self, **changes)


def _not_finite(value: Tensor) -> int:
    """How many are NaN or infinite. Some at a time: it may be a map of a file that is larger than memory."""
    bad = 0
    for place in pieces(value, _NUMBERS):
        some = value[place]
        # A tenth of the time of `isfinite`, and no other tensor; NaN is the least and the greatest of all.
        least, most = some.aminmax()
        if not bool(least.isfinite() & most.isfinite()):
            bad += int((~some.isfinite()).sum())
    return bad


def bytes_of(*tensors: Tensor) -> int:
    return sum(each.numel() * each.element_size() for each in tensors)


def check_indices(name: str, index: Tensor, count: int) -> None:
    """InputError if one of them names none of `count` vertices."""
    if index.numel() and (index.min() < 0 or index.max() >= count):
        raise InputError(f"{name} of the transfer name vertices that it does not have: bake it again")

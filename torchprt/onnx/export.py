"""Writing a shader as one self-contained ONNX file."""

from __future__ import annotations

import contextlib
import logging
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import onnx
import torch

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.onnx.describe import INPUTS, metadata, shape
from torchprt.onnx.graph import DiffuseGraph, Source, make_graph
from torchprt.onnx.operators import OPSET, check_operators, count_operators
from torchprt.onnx.parity import ParityError, ParityReport, compare
from torchprt.shade import DiffuseShader, EnvironmentShader, shader
from torchprt.transfer import DiffuseTransfer
from torchprt.version import VERSION

# protobuf cannot hold 2 GB; a megabyte is left for the nodes. Above it the weights would go to a second file.
LIMIT = 2**31 - 2**20


@dataclass(frozen=True)
class ExportReport:
    """What was written: `inputs` and `outputs` map names to shapes as read back from the file.

    `operators` counts the nodes of the graph; `parity` is None if the check was not wanted.
    """

    path: Path
    bytes: int
    opset: int
    inputs: dict[str, tuple[int | str, ...]]
    outputs: dict[str, tuple[int | str, ...]]
    operators: dict[str, int]
    parity: ParityReport | None

    def __str__(self) -> str:
        return f"{self.path}: {self.bytes / 2**20:.1f} MB, opset {self.opset}, {sum(self.operators.values())} nodes"


def export(
    transfer: DiffuseTransfer,
    path: str | os.PathLike[str],
    *,
    source: Source = "light",
    size: int = 32,
    check: bool = True,
) -> ExportReport:
    """Writes the shader of `transfer` to one `.onnx` file that any ONNX runtime, also one in a browser, can run.

    Inputs `light [B, N, 3]` (or `environment [B, 6, size, size, 3]` if `source` is "environment") and
    `rotation [B, 3, 3]`; output `radiance [B, V, 3]`, linear, albedo applied; float32, any B. Opset 18, weights
    inside, operators of `operators.ALLOWED` alone. The metadata say what the file is; `describe` reads them.

    With `check` the file is run in ONNX Runtime and compared with torch (see `compare`) before it takes its name;
    ParityError if they differ, and then no file is left.

    Raises InputError, before anything is written, if the transfer is empty or holds a value that is not finite, the
    weights exceed the 2 GB that one file can hold, or an argument cannot be used.
    """
    path = Path(path)
    _check_arguments(transfer, path, source, size)
    transfer.check()
    with atomic(path) as temporary:
        model = _trace(make_graph(transfer, source, size), source, size)
        onnx.helper.set_model_props(model, metadata(transfer, source, size))
        onnx.save(model, temporary)
        onnx.checker.check_model(temporary, full_check=True)
        # Read back: what the exporter was asked for is not always what it wrote.
        model = onnx.load(temporary)
        check_operators(model)
        inputs = {value.name: shape(value) for value in model.graph.input}
        outputs = {value.name: shape(value) for value in model.graph.output}
        _check_shapes(transfer, source, size, inputs, outputs)
        parity = compare(temporary, _reference(transfer, source, size)) if check else None
        if parity is not None and not parity.passed:
            raise ParityError(f"{path} was not written: ONNX Runtime and torch are {parity}")
    return ExportReport(path, path.stat().st_size, OPSET, inputs, outputs, count_operators(model), parity)


def _check_arguments(transfer: DiffuseTransfer, path: Path, source: str, size: int) -> None:
    if path.suffix != ".onnx":
        raise InputError(f"{path} must end in .onnx")
    if source not in ("light", "environment"):
        raise InputError(f"source '{source}' is unknown: use 'light' or 'environment'")
    if source == "environment" and size < 2:
        raise InputError(f"size {size} of the cube map is too small: give at least 2")
    if transfer.vertices == 0:
        raise InputError("the transfer has no vertices: there is nothing to export")
    texels = 6 * size * size if source == "environment" else 0
    separate = transfer.albedo.numel() if transfer.channels == 1 and transfer.albedo.shape[1] == 3 else 0
    total = 4 * (transfer.transfer.numel() + separate + texels * transfer.order**2)
    if total > LIMIT:
        raise InputError(
            f"the weights are {total / 2**30:.1f} GB, more than the 2 GB that one ONNX file can hold: "
            "lower the order or split the scene"
        )


def _trace(graph: DiffuseGraph, source: Source, size: int) -> onnx.ModelProto:
    # An example batch of one would be baked in silently.
    entry = (6, size, size, 3) if source == "environment" else (graph.coefficients, 3)
    batch = torch.export.Dim("B")
    with _quiet(), torch.no_grad():
        program = torch.onnx.export(
            graph.eval(),
            (torch.zeros(2, *entry), torch.eye(3).repeat(2, 1, 1)),
            dynamo=True,
            verbose=False,
            opset_version=OPSET,
            input_names=[source, "rotation"],
            output_names=["radiance"],
            dynamic_shapes=({0: batch}, {0: batch}),
        )
    assert program is not None
    model = program.model_proto
    # The exporter leaves source paths of this machine and traces of the stack in every node.
    for entry in (model.graph, *model.graph.node, *model.graph.input, *model.graph.output, *model.graph.initializer):
        entry.ClearField("metadata_props")
    model.graph.ClearField("value_info")
    model.graph.name = "torchprt"
    model.producer_name, model.producer_version = "torchprt", VERSION
    for value in (*model.graph.input, *model.graph.output):
        value.doc_string = INPUTS[value.name]
    return model


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silences what torch's exporter says about itself, and nothing else."""
    registration = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = registration.level
    with warnings.catch_warnings():
        # Both inputs share the dynamic size B; the exporter names it once and warns of the second.
        warnings.filterwarnings("ignore", message=r"# The axis name: B will not be used", category=UserWarning)
        # torch 2.13 copies its own deprecated tree specifications.
        warnings.filterwarnings("ignore", message=r".*LeafSpec.* is deprecated", category=FutureWarning)
        # One line for each torchvision operator, if torchvision is not installed.
        registration.setLevel(logging.ERROR)
        try:
            yield
        finally:
            registration.setLevel(level)


def _check_shapes(
    transfer: DiffuseTransfer,
    source: Source,
    size: int,
    inputs: dict[str, tuple[int | str, ...]],
    outputs: dict[str, tuple[int | str, ...]],
) -> None:
    first = (6, size, size, 3) if source == "environment" else (transfer.order**2, 3)
    wanted = {source: ("B", *first), "rotation": ("B", 3, 3)}, {"radiance": ("B", transfer.vertices, 3)}
    if (inputs, outputs) != wanted:
        raise RuntimeError(f"the exported graph has inputs {inputs} and outputs {outputs}: {wanted} were asked for")


def _reference(transfer: DiffuseTransfer, source: Source, size: int) -> DiffuseShader | EnvironmentShader:
    module = shader(transfer, dtype=torch.float64)
    return EnvironmentShader(module, size) if source == "environment" else module

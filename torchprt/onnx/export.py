"""Writing a shader as one self-contained ONNX file."""

from __future__ import annotations

import contextlib
import logging
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.onnx.contract import ParityError, Shapes, check_numbers, check_signature, promised, signature
from torchprt.onnx.describe import INPUTS, LOCAL, metadata
from torchprt.onnx.graph import Pose, Source
from torchprt.onnx.operators import OPSET, check_operators, count_operators
from torchprt.onnx.parity import ParityReport, compare
from torchprt.onnx.plan import Plan, plan
from torchprt.onnx.toward_eye import Eye
from torchprt.transfer import Transfer
from torchprt.version import VERSION
from torchprt.words import count

# The arguments of a graph whose input has another name in the file.
ARGUMENTS = {"environment": "light", "view": "eye", "frames": "pose", "positions": "pose"}


@dataclass(frozen=True)
class ExportReport:
    """What was written: `inputs` and `outputs` map names to shapes as read back from the file.

    `operators` counts the nodes of the graph; `parity` is None if the check was not wanted.
    """

    path: Path
    bytes: int
    opset: int
    inputs: Shapes
    outputs: Shapes
    operators: dict[str, int]
    parity: ParityReport | None

    def __str__(self) -> str:
        nodes = count(sum(self.operators.values()), "node")
        return f"{self.path}: {self.bytes / 2**20:.1f} MB, opset {self.opset}, {nodes}"


def export(
    transfer: Transfer,
    path: str | os.PathLike[str],
    *,
    source: Source = "light",
    size: int = 32,
    eye: Eye = "point",
    fix_eye: Sequence[float] | Tensor | None = None,
    fix_light: Tensor | None = None,
    exponent: float | int | Tensor | None = None,
    pose: Pose | None = None,
    orders: Mapping[str, Tensor] | None = None,
    local: bool = False,
    check: bool = True,
) -> ExportReport:
    """Writes the shader of `transfer` to one `.onnx` file that any ONNX runtime, also one in a browser, can run.

    Inputs `light [B, N, 3]` (or `environment [B, 6, size, size, 3]` if `source` is "environment") and
    `rotation [B, 3, 3]`; output `radiance [B, V, 3]`, linear, albedo and specular applied; float32, any B. Opset 18,
    weights inside, operators of `operators.ALLOWED` alone. The metadata say what the file is; `describe` reads them.

    For transfer that depends on the eye there is a third input: `eye [B, 3]`, a point in the unit of the scene, or, if
    `eye` is "direction", `view [B, 3]`, directions toward a distant eye, of any length above zero. Receivers below
    whose tangent plane it lies are seen at the horizon, as by the shaders. Two graphs are smaller and faster:
    - `fix_eye [3]`, a point or a direction as `eye` says: no third input, a graph as large as that of diffuse transfer.
    - `fix_light [N, 3]`: `eye` (or `view`) is the only input. A turned light is `sh.rotate(light, rotation)`.
    `exponent`: the Phong lobe for transfer of kind "incident", which needs one, as for `shader`; for another
    reflectance export what `shade.with_material` makes of it.

    For transfer in zonal lobes the third input is a pose, without a batch: all B lights shine on it. `pose` "frames"
    (if omitted) takes `frames [V, 3, 3]`, the rotation of every vertex from the rest pose; "positions" takes
    `positions [V, 3]` of the deformed mesh, and the graph estimates the frames as `pose.DeformedFrames`. Glossy lobes
    take an eye and then a pose; a point needs "positions", which is then what they take if `pose` is omitted.

    `orders`: at which order of the light each receiver of a layer stands, by the name of the layer, as
    `shade.fixed_orders` takes them: adaptive shading with regions that are fixed. Receivers of one order are a product.

    `local`: the light of every receiver is the blend that is stored with the transfer (`light.with_sample_points`):
    the input is `light [B, K, N, 3]`, or `environment [B, K, 6, size, size, 3]`, K a sample point or, with gradients,
    four, and the metadata tell where the points are. It computes what `shade.LocalLightShader` does.

    ParityError, and no file is left, if names, dtypes or shapes in the file are not those above or, with `check`, ONNX
    Runtime and torch differ (see `compare`).

    Raises InputError, before anything is written, if the transfer is empty or holds a value that is not finite, the
    weights exceed the 2 GB that one file can hold, or an argument cannot be used.
    """
    path = Path(path)
    if path.suffix != ".onnx":
        raise InputError(f"{path} must end in .onnx")
    planned = plan(
        transfer,
        source=source,
        size=size,
        eye=eye,
        fix_eye=fix_eye,
        fix_light=fix_light,
        exponent=exponent,
        pose=pose,
        orders=orders,
        local=local,
    )
    transfer.check()
    with atomic(path) as temporary:
        model = _trace(planned)
        onnx.helper.set_model_props(model, metadata(transfer, planned.about))
        onnx.save(model, temporary)
        onnx.checker.check_model(temporary, full_check=True)
        # Read back: what the exporter was asked for is not always what it wrote.
        model = onnx.load(temporary)
        check_operators(model)
        inputs, outputs = _check_contract(f"the graph for {path}", planned, transfer.order, model)
        parity = compare(temporary, planned.reference()) if check else None
        if parity is not None and not parity.passed:
            raise ParityError(f"{path} was not written: ONNX Runtime and torch are {parity}")
    return ExportReport(path, path.stat().st_size, OPSET, inputs, outputs, count_operators(model), parity)


def _trace(planned: Plan) -> onnx.ModelProto:
    # An example batch of one would be baked in silently.
    examples = {
        name: torch.zeros(*([] if name in planned.single else [2]), *shape) for name, shape in planned.inputs.items()
    }
    if "rotation" in examples:
        examples["rotation"] += torch.eye(3)
    batch = torch.export.Dim("B")
    free = {name: None if name in planned.single else {0: batch} for name in examples}
    about = INPUTS if planned.lights is None else INPUTS | LOCAL
    return traced(planned.graph().eval(), examples, free, about)


def traced(
    module: nn.Module,
    examples: dict[str, Tensor],
    free: dict[str, dict[int, Any] | None],
    about: Mapping[str, str] = INPUTS,
    arguments: Mapping[str, str] = ARGUMENTS,
    output: str = "radiance",
) -> onnx.ModelProto:
    """The graph of `module`, called with `examples` by name, whose `free` dimensions have a name; `about`: what inputs
    and outputs are; `arguments`: those of the module whose input has another name; `output`: its name."""
    with _quiet(), torch.no_grad():
        program = torch.onnx.export(
            module,
            kwargs={arguments.get(name, name): value for name, value in examples.items()},
            dynamo=True,
            verbose=False,
            opset_version=OPSET,
            input_names=list(examples),
            output_names=[output],
            dynamic_shapes={arguments.get(name, name): sizes for name, sizes in free.items()},
        )
    assert program is not None
    # The exporter names values after operators of torch, of which `view` is one.
    for node in program.model.graph:
        for value in node.outputs:
            if value.name in examples:
                value.name = f"{value.name}_inside"
    model = program.model_proto
    # The exporter leaves source paths of this machine and traces of the stack in every node.
    for entry in (model.graph, *model.graph.node, *model.graph.input, *model.graph.output, *model.graph.initializer):
        entry.ClearField("metadata_props")
    model.graph.ClearField("value_info")
    model.graph.name = "torchprt"
    model.producer_name, model.producer_version = "torchprt", VERSION
    for value in (*model.graph.input, *model.graph.output):
        value.doc_string = about[value.name]
    return model


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silences what torch's exporter says about itself, and nothing else."""
    registration = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = registration.level
    with warnings.catch_warnings():
        # All inputs share the dynamic size B; the exporter names it once and warns of the others.
        warnings.filterwarnings("ignore", message=r"# The axis name: [BR] will not be used", category=UserWarning)
        # torch 2.13 copies its own deprecated tree specifications.
        warnings.filterwarnings("ignore", message=r".*LeafSpec.* is deprecated", category=FutureWarning)
        # One line for each torchvision operator, if torchvision is not installed.
        registration.setLevel(logging.ERROR)
        try:
            yield
        finally:
            registration.setLevel(level)


def _check_contract(what: str, planned: Plan, order: int, model: onnx.ModelProto) -> tuple[Shapes, Shapes]:
    """ParityError unless the file has what docs/onnx.md promises; the shapes of its inputs and outputs."""
    inputs, outputs = signature(list(model.graph.input)), signature(list(model.graph.output))
    if list(inputs) != list(planned.inputs):
        raise ParityError(f"{what} takes {', '.join(inputs)}: {', '.join(planned.inputs)} were asked for")
    check_signature(what, inputs, outputs, promised(order, planned.vertices, planned.about["size"], planned.lights))
    check_numbers(what, model)
    first, second = ({name: shape for name, (_, shape) in values.items()} for values in (inputs, outputs))
    return first, second

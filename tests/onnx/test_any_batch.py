"""Does every graph take a batch of any size, none included, and what it cannot take is an error?"""

import numpy as np
import onnxruntime
import pytest
import torch
from transfers import KINDS, random_glossy, replaced
from zonal_transfers import bumpy, random_zonal_factored

from torchprt.compression import compress
from torchprt.onnx import describe, export
from torchprt.onnx.parity import tolerance
from torchprt.shade import EnvironmentShader, shader
from torchprt.transfer import Exit, Incident

pytestmark = pytest.mark.usefixtures("untyped")

ORDER, SIDE, GLOSSY, SIZE, EXPONENT = 2, 3, 5, 4, 5.0
BATCHES = (0, 1, 2, 7)
FIXED = torch.tensor([[1.0, 2.0, 3.0], [0.5, -0.2, 0.1], [0.2, 0.2, 0.2], [-1.0, 0.0, 0.4]])
PLACE = [1.0, 2.0, 0.5]
STILL = {
    "all": {},
    "environment": {"source": "environment", "size": SIZE, "eye": "direction"},
    "eye": {"fix_eye": PLACE, "source": "environment", "size": SIZE},
    "light": {"fix_light": FIXED, "eye": "direction"},
}
POSED = {"all": {}, "environment": STILL["environment"] | {"pose": "frames"}}
# Sources, eyes, numbers of channels and what is fixed meet every signal, though not all of them each other.
CASES = [
    *((signal, *other) for signal in ("dense", "clustered") for other in (
        (3, "all"), (1, "environment"), (1, "eye"), (3, "light")
    )),
    ("lobes", 3, "all"),
    ("lobes", 1, "environment"),
]  # fmt: skip


def every_layer(signal, channels):
    """Transfer with a layer of every kind, about some of the receivers each; a fault of one kills the whole graph."""
    if signal == "lobes":
        made = random_zonal_factored(SIDE**2, GLOSSY, rows=4, lobes=1, order=ORDER, channels=channels, exact=False)
        factored = made.layers["factored"]
        common = {name: getattr(factored, name) for name in ("signal", "receivers", "tangents", "specular")}
        return made.with_layers(exit=Exit(**common, output_order=2), incident=Incident(**common))
    layers = {}
    for kind in KINDS:
        one = random_glossy(kind, SIDE**2, GLOSSY, ORDER, 2, channels)
        one = one if signal == "dense" else compress(one, clusters=2, components=1)
        layers |= one.layers
    positions, faces = bumpy(SIDE)
    return replaced(one.with_layers(**layers), positions=positions.float(), faces=faces)


def inputs_of(path, batch):
    """Random values of every input, rotations and frames quarter turns, from what the file says it takes."""
    random = np.random.default_rng(batch)
    quarter = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "f4")
    feed = {}
    for name, shape in describe(path)["inputs"].items():
        sizes = [batch if size == "B" else size for size in shape]
        turned = name in ("rotation", "frames")
        feed[name] = np.broadcast_to(quarter, sizes) if turned else random.normal(size=sizes).astype("f4")
    return feed


def module_of(transfer, arguments):
    choices = {"exponent": EXPONENT} if "reflectance" in transfer.needs else {}
    made = shader(transfer, dtype=torch.float64, **choices)
    if "fix_eye" in arguments:
        made = made.fix_eye(eye=torch.tensor(PLACE, dtype=torch.float64))
    if "fix_light" in arguments:
        return made.fix_light(FIXED.double())
    return EnvironmentShader(made, SIZE) if arguments.get("source") == "environment" else made


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Exports a graph of all layers when it is first asked for."""
    folder, made = tmp_path_factory.mktemp("batches"), {}

    def export_once(case):
        if case not in made:
            signal, channels, name = case
            arguments = (POSED if signal == "lobes" else STILL)[name]
            transfer = every_layer(signal, channels)
            path = folder / f"{signal}-{channels}-{name}.onnx"
            choices = {"exponent": EXPONENT} if "reflectance" in transfer.needs else {}
            export(transfer, path, check=False, **choices, **arguments)
            made[case] = path, transfer, arguments
        return made[case]

    return export_once


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
def test_every_graph_shades_batches_of_any_size_as_torch_does(written, elsewhere, case):
    path, transfer, arguments = written(case)
    # Elsewhere first: here a fault would be a signal, and the end of all tests.
    answer = elsewhere(path, list(BATCHES))
    assert answer == [[[batch, SIDE**2, 3], "float32"] for batch in BATCHES]
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    module = module_of(transfer, arguments)
    for batch in BATCHES:
        feed = inputs_of(path, batch)
        found = torch.from_numpy(session.run(None, feed)[0])
        wide = {name: torch.from_numpy(np.array(value)).double() for name, value in feed.items()}
        lights = [wide.pop(name) for name in ("light", "environment", "rotation") if name in wide]
        wanted = module(*lights, **wide)
        assert found.shape == wanted.shape == (batch, SIDE**2, 3)
        if batch:
            # Parity's own bound, of a table of factors as of functions of order 32.
            assert (found - wanted).abs().max() <= tolerance(32) * wanted.abs().max()


def test_inputs_of_different_batches_are_an_error(written):
    path, _, _ = written(("dense", 3, "all"))
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    feed = inputs_of(path, 2)
    for name, value in feed.items():
        with pytest.raises(Exception, match=r"INVALID_ARGUMENT|Fail|RUNTIME_EXCEPTION|dimension|broadcast"):
            session.run(None, feed | {name: np.concatenate([value, value[:1]])})

"""Can a layer and a signal that are defined outside of the package go wherever those of the package go?

Each is one class a room: what is stored, its module, and, where tracing that is not fast enough, its part of a graph.
"""

from dataclasses import dataclass
from typing import ClassVar

import pytest
import torch
from torch import Tensor
from transfers import random_glossy, stored

from torchprt.compression import compress, decompress, fit
from torchprt.onnx import SignalGraph, by_channel, describe, export, signal_graph
from torchprt.shade import EyeLayerModule, SignalModule, layer_module, shader, signal_module
from torchprt.shade.dense import matrix_vectors
from torchprt.transfer import Dense, Layout, Signal, Transfer, load, save
from torchprt.transfer.layer import EyeLayer

LIGHT = torch.randn(2, 9, 3, generator=torch.Generator().manual_seed(3))
EYE = torch.tensor([2.0, 3.0, 5.0])


@dataclass(kw_only=True)
class Rim(EyeLayer):
    """Two rows: one for all eyes, and one that grows toward the silhouette as a power of the sine."""

    kind: ClassVar[str] = "rim"

    power: float


@layer_module.register(Rim)
class RimLayer(EyeLayerModule):
    def __init__(self, layer, making):
        super().__init__(layer, making)
        self.power = layer.power

    def exit_values(self, local):
        return torch.stack([torch.ones_like(local[..., 2]), (1 - local[..., 2]) ** self.power], -1)


@dataclass(kw_only=True)
class Bytes(Signal):
    """A byte a number, in steps of its own for every receiver."""

    kind: ClassVar[str] = "bytes"
    layouts: ClassVar[dict[str, Layout]] = {
        "codes": Layout(("C", "G", "M", "N"), (torch.int8,)),
        "step": Layout(("G",)),
    }
    stored: ClassVar[tuple[str, ...]] = ("step",)
    approximates: ClassVar[bool] = False

    codes: Tensor
    step: Tensor

    @property
    def shape(self):
        channels, receivers, rows, columns = self.codes.shape
        return receivers, channels, rows, columns

    def to_order(self, order):
        return self.replace(codes=self.codes[..., : order**2].contiguous())

    def take(self, index):
        return self.replace(codes=self.codes[:, index], step=self.step[index])

    def dense(self):
        values = self.codes * self.step[:, None, None].float()
        return Dense(values=values if self.shape[2] > 1 else values[:, :, 0].mT.contiguous())

    @classmethod
    def of(cls, dense):
        values = dense.values.mT.unsqueeze(2) if dense.values.ndim == 3 else dense.values
        step = values.abs().amax((0, 2, 3)) / 127
        return cls(codes=(values / step[:, None, None]).round().to(torch.int8), step=step)


@signal_module.register(Bytes)
class BytesSignal(SignalModule):
    def __init__(self, signal, making, lost=None):
        super().__init__(signal.shape)
        step = signal.step if lost is None else signal.step.index_fill(0, lost, 0)
        self.register_buffer("codes", signal.codes)
        self.register_buffer("step", step.to(making.dtype))

    def toward(self, values, frames=None):
        if values is None:
            return (self.codes[:, :, 0] * self.step[:, None]).mT
        return matrix_vectors(self.codes.to(values.dtype), values * self.step[:, None])


@signal_graph.register(BytesSignal)
class BytesGraph(SignalGraph):
    """All rows as one stream, as matrices are; the layout that runs fastest is this one's own affair."""

    def __init__(self, signal, weight):
        super().__init__(None, weight)
        channels, self.receivers, self.rows, columns = signal.codes.shape
        streams = (signal.codes * signal.step[:, None, None]).permute(0, 3, 2, 1).float()
        self.register_buffer("streams", streams.reshape(channels, columns, self.rows * self.receivers))

    def forward(self, light, values, frames):
        sent = (by_channel(light) @ self.streams).reshape(3, -1, self.rows, self.receivers).transpose(0, 1)
        return self.weighed(sent.sum(2) if values is None else (sent * values.unsqueeze(1)).sum(2))


def rim(**options):
    """Transfer of a diffuse layer and of one with the functions of `Rim`."""
    transfer = random_glossy("factored", vertices=12, glossy=9, order=3, **options)
    layer = transfer.layers["factored"]
    signal = Dense(values=stored(transfer)[:, :, :2].contiguous())
    made = Rim(signal=signal, receivers=layer.receivers, tangents=layer.tangents, specular=layer.specular, power=3.0)
    return Transfer(receivers=transfer.receivers, layers={"diffuse": transfer.layers["diffuse"], "rim": made})


def in_bytes(transfer):
    return transfer.with_layers(
        **{name: layer.replace(signal=Bytes.of(layer.signal)) for name, layer in transfer.layers.items()}
    )


def by_hand(transfer):
    """Radiance [B, V, 3] under `LIGHT` toward `EYE` in float64, one receiver after the other."""
    radiance = torch.einsum("nv,bnc->bvc", stored(transfer, "diffuse")[0].double(), LIGHT.double())
    radiance = radiance * transfer.albedo.double()
    layer = transfer.layers["rim"]
    for g, v in enumerate(layer.receivers.tolist()):
        away = EYE.double() - transfer.positions[v].double()
        normal, tangent = transfer.normals[v].double(), layer.tangents[g].double()
        z = (normal @ away).clamp(min=0)
        across = away - normal * (normal @ away)
        z = z / torch.sqrt(z * z + across @ across)
        assert abs(float(normal @ tangent)) < 1e-5
        weights = torch.stack([torch.ones_like(z), (1 - z) ** 3])
        vector = weights @ layer.signal.values[0, g].double()
        specular = layer.specular.double().expand(len(layer.receivers), 3)[g]
        radiance[:, v] += specular * (vector @ LIGHT.double())
    return radiance


def test_a_new_layer_is_written_and_read(tmp_path):
    save(rim(), tmp_path / "a.safetensors")
    found = load(tmp_path / "a.safetensors")
    assert found.kind == "diffuse + rim"
    assert found.layers["rim"].power == 3.0
    assert torch.equal(stored(found), stored(rim()))


def test_a_new_layer_is_shaded_with_its_own_functions_of_the_eye():
    found = shader(rim(), dtype=torch.float64)(LIGHT.double(), eye=EYE.double())
    # Tangents are float32: frames are orthonormal to so many digits.
    torch.testing.assert_close(found, by_hand(rim()), atol=1e-5, rtol=1e-5)


def test_a_new_layer_with_eye_or_light_fixed_is_the_same():
    module = shader(rim())
    wanted = module(LIGHT, eye=EYE)
    torch.testing.assert_close(module.fix_eye(eye=EYE)(LIGHT), wanted, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(module.fix_light(LIGHT)(eye=EYE), wanted, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("make", [compress, fit], ids=["clustered", "zonal"])
def test_a_new_layer_is_compressed(make):
    options = {"clusters": 2, "components": 6} if make is compress else {"lobes": 6}
    packed = make(rim(), **options)
    assert packed.layers["rim"].signal.approximates
    # As many weights as there are receivers in a cluster, and lobes that are as many as their numbers: nothing is lost.
    torch.testing.assert_close(shader(packed)(LIGHT, eye=EYE), shader(rim())(LIGHT, eye=EYE), atol=2e-2, rtol=2e-2)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("change", [None, compress, fit, in_bytes], ids=["dense", "clustered", "zonal", "bytes"])
def test_a_new_layer_is_exported_in_any_signal(change, tmp_path):
    options = {compress: {"clusters": 2, "components": 2}, fit: {"lobes": 2}}.get(change, {})
    # Low orders are traced faster.
    whole = rim().to_order(2)
    transfer = whole if change is None else change(whole, **options)
    # Loose points have no faces, from which frames would be estimated.
    report = export(transfer, tmp_path / "a.onnx", eye="direction" if change is fit else "point")
    assert report.parity.passed
    assert describe(tmp_path / "a.onnx")["layers"][-1]["kind"] == "rim"


@pytest.mark.parametrize("channels", [1, 3])
def test_a_new_signal_is_written_and_read_and_shaded(channels, tmp_path):
    whole = random_glossy("exit", vertices=12, glossy=9, order=3, channels=channels)
    transfer = in_bytes(whole)
    save(transfer, tmp_path / "a.safetensors")
    found = load(tmp_path / "a.safetensors")
    assert found.kind == "bytes diffuse + bytes exit"
    assert torch.equal(found.layers["exit"].signal.codes, transfer.layers["exit"].signal.codes)
    wanted = shader(whole)(LIGHT, eye=EYE)
    # Half a step of 1 / 127 in each of up to 9 x 9 numbers of a sum, whose signs are random.
    assert (shader(found)(LIGHT, eye=EYE) - wanted).abs().max() <= 0.05 * wanted.abs().max()


def test_a_new_signal_answers_as_the_dense_one_does():
    transfer = in_bytes(random_glossy("exit", vertices=12, glossy=9, order=3))
    dense = transfer.with_layers(
        **{name: layer.replace(signal=layer.signal.dense()) for name, layer in transfer.layers.items()}
    )
    one, other = shader(transfer), shader(dense)
    for call in (
        lambda module: module(LIGHT, eye=EYE),
        lambda module: module(LIGHT[:, None], eye=torch.stack([EYE, -EYE])),
        lambda module: module.fix_light(LIGHT)(eye=EYE),
        lambda module: module.fix_eye(eye=EYE)(LIGHT),
    ):
        torch.testing.assert_close(call(one), call(other), atol=1e-5, rtol=1e-5)


def test_a_new_signal_is_compressed_from_what_it_stands_for():
    transfer = in_bytes(random_glossy("exit", vertices=40, glossy=30, order=3))
    packed = compress(transfer, clusters=3, components=4)
    assert packed.kind == "bytes diffuse + clustered exit"
    wanted = compress(
        transfer.with_layers(exit=transfer.layers["exit"].replace(signal=transfer.layers["exit"].signal.dense())),
        clusters=3,
        components=4,
    )
    assert torch.equal(packed.layers["exit"].signal.weights, wanted.layers["exit"].signal.weights)
    assert decompress(packed).kind == "bytes diffuse + exit"


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("own", [True, False], ids=["with a part of its own", "traced as it is"])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_new_signal_is_exported(channels, own, tmp_path, monkeypatch):
    if not own:
        monkeypatch.setattr("torchprt.onnx.layers.signal_graph", SignalGraph)
    transfer = in_bytes(random_glossy("exit", vertices=12, glossy=9, order=2, output_order=2, channels=channels))
    assert export(transfer, tmp_path / "a.onnx").parity.passed
    if own and channels == 1:
        assert export(transfer, tmp_path / "b.onnx", fix_light=LIGHT[0, :4]).parity.passed
        assert export(transfer, tmp_path / "c.onnx", fix_eye=EYE).parity.passed


def test_what_has_no_module_is_refused_in_one_sentence():
    @dataclass(kw_only=True)
    class Strange(Bytes):
        kind: ClassVar[str] = "strange"

    @dataclass(kw_only=True)
    class Odd(Signal):
        kind: ClassVar[str] = "odd"
        stored: ClassVar[tuple[str, ...]] = ("values",)
        layouts: ClassVar[dict[str, Layout]] = {"values": Layout(("C", "G", "M", "N"))}
        values: Tensor
        shape = Bytes.shape
        to_order = take = None

    # A class that builds on another has the module of that.
    transfer = random_glossy("exit", vertices=4, order=2, diffuse=False)
    layer = transfer.layers["exit"]
    made = Strange(**vars(Bytes.of(layer.signal)))
    assert shader(transfer.with_layers(exit=layer.replace(signal=made))).order == 2
    Odd.shape = property(lambda self: (self.values.shape[1], 1, *self.values.shape[2:]))
    from torchprt.errors import InputError

    with pytest.raises(InputError, match="'odd' has no shader: register one"):
        shader(transfer.with_layers(exit=layer.replace(signal=Odd(values=layer.signal.values))))
    del Signal.family["strange"], Signal.family["odd"]

"""How fast is shading? Ratios measured side by side on one thread, with the error beside the time.

    python scripts/benchmarks/shade.py

50 000 vertices, order 5, one transfer channel; glossy transfer with 25 000. Every target is a ratio within this run: a
machine's own stream rate, its own matrix product, the plain product of the textbook, ONNX Runtime, the lights before
the eye.
"""

import functools
import tempfile
from pathlib import Path

import numpy as np
import onnxruntime
import rich
import torch

from torchprt.measure import Table, relative_rms, time_it
from torchprt.onnx import export
from torchprt.sh import bands
from torchprt.shade import Shader, shader
from torchprt.transfer import Dense, Diffuse, Exit, Transfer, Vertices, Visibility, diffuse_transfer

VERTICES, LARGE, ORDER, MANY = 50_000, 2_000_000, 5, 256
GLOSSY, LIGHTS, DEGREE = 25_000, 16, 12


def random_transfer(vertices: int = VERTICES, order: int = ORDER) -> Transfer:
    generator = torch.Generator().manual_seed(0)
    vectors = torch.randn(1, order**2, vertices, generator=generator) / (1 + bands(order)[:, None]) ** 2
    return diffuse_transfer(
        vectors,
        albedo=torch.full((1, 1), 0.5),
        positions=torch.zeros(vertices, 3),
        normals=torch.zeros(vertices, 3),
        faces=torch.zeros(0, 3, dtype=torch.int64),
    )


def run(rounds: int = 15) -> None:
    """Prints the timings and, below them, every ratio with its target."""
    torch.set_num_threads(1)
    transfer = random_transfer()
    module = shader(transfer)
    vectors = transfer.layers["diffuse"].signal.values
    generator = torch.Generator().manual_seed(1)
    one, many = (torch.randn(count, ORDER**2, 3, generator=generator) for count in (1, MANY))
    out_one, out_many = module(one), module(many)
    by_vertex = vectors[0].T.contiguous()
    # What no shader can beat while torch has no better product: the bare call on the very tensors.
    rows, product = one[0].T.contiguous(), torch.empty(3, VERTICES)
    # As large as the transfer, so that both are read from the same level of the cache.
    stream = torch.ones(vectors.numel())
    # A scene whose transfer is larger than any cache, and as much to read.
    large = shader(random_transfer(LARGE))
    memory = torch.ones(large.layers["diffuse"].signal.values.numel())
    out_large = large(one)
    square = torch.randn(2048, 2048, generator=generator)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.onnx"
        export(transfer, path)
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    identity = torch.eye(3)

    def ort(light: torch.Tensor) -> np.ndarray:
        rotation = identity.expand(len(light), 3, 3).contiguous().numpy()
        return session.run(None, {"light": light.numpy(), "rotation": rotation})[0]

    def turned(light: torch.Tensor, out: torch.Tensor | None = None) -> torch.Tensor:
        return module(light, identity.expand(len(light), 3, 3), out=out)

    with torch.no_grad():
        times = time_it(
            {
                "read as much as the transfer": stream.sum,
                "read 200 MB": memory.sum,
                "product of two 2048 x 2048": lambda: square @ square,
                "1 light": lambda: module(one, out=out_one),
                f"1 light, {LARGE} vertices": lambda: large(one, out=out_large),
                "1 light, new result": lambda: module(one),
                "1 light, [V, N] @ [N, 3]": lambda: torch.matmul(by_vertex, one[0]),
                "1 light, bare torch.mm": lambda: torch.mm(rows, vectors[0], out=product),
                "1 light, turned": lambda: turned(one, out_one),
                "1 light, turned, ONNX Runtime": lambda: ort(one),
                f"{MANY} lights": lambda: module(many, out=out_many),
                f"{MANY} lights, new result": lambda: module(many),
                f"{MANY} lights, turned": lambda: turned(many, out_many),
                f"{MANY} lights, turned, new result": lambda: turned(many),
                f"{MANY} lights, turned, ONNX Runtime": lambda: ort(many),
            },
            rounds=rounds,
        )
        wanted_one, wanted_many = (shader(transfer, dtype=torch.float64)(light.double()) for light in (one, many))
        values = {
            "1 light": module(one),
            "1 light, [V, N] @ [N, 3]": 0.5 * torch.matmul(by_vertex, one),
            "1 light, turned": turned(one),
            "1 light, turned, ONNX Runtime": torch.from_numpy(ort(one)),
            f"{MANY} lights": module(many),
            f"{MANY} lights, turned": turned(many),
            f"{MANY} lights, turned, ONNX Runtime": torch.from_numpy(ort(many)),
        }
    table = Table(f"Shading {VERTICES} vertices, order {ORDER}, one thread, process CPU time")
    for name, timing in times.items():
        error = None
        if name in values:
            error = relative_rms(values[name], wanted_one if len(values[name]) == 1 else wanted_many)
        table.add(name, seconds=timing, error=error)
    rich.print(table)

    rate = 2 * 2048**3 / times["product of two 2048 x 2048"].median
    work = 2 * MANY * 3 * vectors.numel()
    ratios = Table("Ratios")

    def ratio(name: str, value: float, target: float | None = None) -> None:
        verdict = {} if target is None else {"target": target, "met": "yes" if value >= target else "no"}
        ratios.add(name, extra={"ratio": value, **verdict})

    # One light reads N numbers a vertex and writes 3.
    moved = 1 + 3 / ORDER**2
    memory_rate = memory.numel() / times["read 200 MB"].median
    one_rate = moved * vectors.numel() / times["1 light"].median
    large_rate = moved * memory.numel() / times[f"1 light, {LARGE} vertices"].median
    cache_rate = vectors.numel() / times["read as much as the transfer"].median
    ratio("1 light / stream rate of a read of 200 MB", one_rate / memory_rate, 0.7)
    ratio("the same against a read of 5 MB, from the cache", one_rate / cache_rate)
    ratio(f"{LARGE} vertices, 1 light / the stream rate", large_rate / memory_rate)
    ratio("1 light / [V, N] @ [N, 3]", times["1 light, [V, N] @ [N, 3]"].median / times["1 light"].median, 5)
    bare = times["1 light, bare torch.mm"].median
    ratio("bare torch.mm / stream rate of a read of 200 MB", moved * vectors.numel() / bare / memory_rate)
    ratio("bare torch.mm / [V, N] @ [N, 3]", times["1 light, [V, N] @ [N, 3]"].median / bare)
    ratio(f"{MANY} lights / FLOP rate of the square product", work / times[f"{MANY} lights"].median / rate, 0.4)
    for count in ("1 light", f"{MANY} lights"):
        runtime = times[f"{count}, turned, ONNX Runtime"].median
        ratio(f"{count}: ONNX Runtime / torch with out=", times[f"{count}, turned"].median / runtime, 1)
    fresh = times[f"{MANY} lights, turned, new result"].median
    runtime = times[f"{MANY} lights, turned, ONNX Runtime"].median
    ratio(f"{MANY} lights: ONNX Runtime / torch with a new result", fresh / runtime, 1)
    rich.print(ratios)


def random_glossy(visibility: bool) -> Transfer:
    """Every receiver glossy and diffuse, order 5 in and out; with matrices, or visibility of the same order."""
    generator = torch.Generator().manual_seed(0)
    count = ORDER**2
    normals = torch.nn.functional.normalize(torch.randn(GLOSSY, 3, generator=generator, dtype=torch.float64), dim=-1)
    across = torch.linalg.cross(normals, torch.randn(GLOSSY, 3, generator=generator, dtype=torch.float64))
    vertices = Vertices(positions=normals.float(), normals=normals.float(), faces=torch.zeros(0, 3, dtype=torch.int64))
    gloss = {
        "receivers": torch.arange(GLOSSY),
        "tangents": torch.nn.functional.normalize(across, dim=-1).float(),
        "specular": torch.full((1, 1), 0.5),
        "output_order": ORDER,
    }
    vectors = Dense(values=torch.randn(1, count, GLOSSY, generator=generator))
    diffuse = Diffuse(albedo=torch.full((1, 1), 0.5), signal=vectors)
    if not visibility:
        matrix = Dense(values=torch.randn(1, GLOSSY, count, count, generator=generator))
        return Transfer(receivers=vertices, layers={"diffuse": diffuse, "exit": Exit(signal=matrix, **gloss)})
    seen = Visibility(
        signal=Dense(values=torch.randn(1, count, GLOSSY, generator=generator)),
        kernel=torch.randn(count, (DEGREE // 2 + 1) * (DEGREE + 1), generator=generator),
        degree=DEGREE,
        light_order=ORDER,
        **gloss,
    )
    return Transfer(receivers=vertices, layers={"diffuse": diffuse, "visibility": seen})


def light_first(module: Shader, light: torch.Tensor, eye: torch.Tensor) -> torch.Tensor:
    """The same sums with the eye last: one product of all matrices with all lights, then the exit functions."""
    gloss = module.layers["exit"]
    matrix = gloss.signal.values
    _, receivers, rows, columns = matrix.shape
    flat = light.mT.reshape(-1, columns) @ matrix.view(receivers * rows, columns).T
    scattered = (flat.view(-1, receivers, rows) * gloss.values(eye, None)).sum(-1)
    return (module.layers["diffuse"](light) + 0.5 * scattered.view(len(light), 3, receivers)).mT


def run_glossy(rounds: int = 9) -> None:
    """Prints the timings of glossy transfer and, below them, every ratio with its target."""
    torch.set_num_threads(1)
    stored, seen = random_glossy(visibility=False), random_glossy(visibility=True)
    matrix, visibility = shader(stored), shader(seen)
    generator = torch.Generator().manual_seed(1)
    lights, eye = torch.randn(LIGHTS, ORDER**2, 3, generator=generator), torch.tensor([3.0, 4.0, 5.0])
    eyes = 5 * torch.randn(LIGHTS, 3, generator=generator)
    one = lights[:1]
    with torch.no_grad():
        lit, looked = matrix.fix_light(one), matrix.fix_eye(eye=eye)
        calls = {
            f"matrix: 1 eye, {LIGHTS} lights": lambda: matrix(lights, eye=eye),
            f"matrix: 1 eye, {LIGHTS} lights, light first": lambda: light_first(matrix, lights, eye),
            "matrix: 1 eye, 1 light": lambda: matrix(one, eye=eye),
            f"matrix: {LIGHTS} eyes, each with its light": lambda: matrix(lights, eye=eyes),
            "matrix: fixed light, moving eye": lambda: lit(eye=eye),
            "matrix: fixed eye, moving light": lambda: looked(one),
            "on the fly: 1 eye, 1 light": lambda: visibility(one, eye=eye),
            f"on the fly: 1 eye, {LIGHTS} lights": lambda: visibility(lights, eye=eye),
        }
        times = time_it(calls, rounds=rounds)
        exact = {name: shader(transfer, dtype=torch.float64) for name, transfer in (("m", stored), ("o", seen))}
        errors = {}
        for name, call in calls.items():
            light = (lights if "lights" in name or "each" in name else one).double()
            wanted = exact[name[0]](light, eye=(eyes if "eyes" in name else eye).double())
            errors[name] = relative_rms(call(), wanted)
    table = Table(f"Shading {GLOSSY} glossy vertices, order {ORDER}, one thread, process CPU time")
    for name, timing in times.items():
        table.add(name, seconds=timing, error=errors[name], bytes=(stored if name[0] == "m" else seen).bytes)
    rich.print(table)

    ratios = Table("Ratios, glossy")

    def ratio(name: str, slow: str, fast: str, target: float | None = None) -> None:
        value = times[slow].median / times[fast].median
        verdict = {} if target is None else {"target": target, "met": "yes" if value >= target else "no"}
        ratios.add(name, extra={"ratio": value, **verdict})

    first = f"matrix: 1 eye, {LIGHTS} lights"
    ratio(f"1 eye, {LIGHTS} lights: light first / eye first", f"{first}, light first", first, 8)
    ratio("1 light: eye and light new / light fixed", "matrix: 1 eye, 1 light", "matrix: fixed light, moving eye")
    ratio("1 light: eye and light new / eye fixed", "matrix: 1 eye, 1 light", "matrix: fixed eye, moving light")
    ratio("1 eye, 1 light: on the fly / matrix", "on the fly: 1 eye, 1 light", "matrix: 1 eye, 1 light")
    ratios.add("bytes: matrix / on the fly", extra={"ratio": stored.bytes / seen.bytes})
    rich.print(ratios)


def run_narrow(rounds: int = 9) -> None:
    """Prints what narrow types take and lose, side by side with float32."""
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(1)
    lights, eye = torch.randn(LIGHTS, ORDER**2, 3, generator=generator), torch.tensor([3.0, 4.0, 5.0])
    table = Table(f"Narrow types, {VERTICES} diffuse and {GLOSSY} glossy vertices, order {ORDER}, process CPU time")
    for name, transfer in (("diffuse", random_transfer()), ("matrix", random_glossy(visibility=False))):
        modules = {dtype: shader(transfer, dtype=dtype) for dtype in (torch.float32, torch.bfloat16, torch.float16)}
        look = {"eye": eye} if "eye" in transfer.needs else {}
        for count in (1, LIGHTS):
            light = lights[:count]
            calls = {str(d): functools.partial(module, light.to(d), **look) for d, module in modules.items()}
            with torch.no_grad():
                times = time_it(calls, rounds=rounds)
                wanted = shader(transfer, dtype=torch.float64)(
                    light.double(), **{k: v.double() for k, v in look.items()}
                )
                for dtype, module in modules.items():
                    timing = times[str(dtype)]
                    table.add(
                        f"{name}, {count} lights, {dtype}",
                        seconds=timing,
                        error=relative_rms(calls[str(dtype)]().double(), wanted),
                        bytes=sum(buffer.nbytes for buffer in module.buffers()),
                        extra={"of float32": timing.median / times["torch.float32"].median},
                    )
    rich.print(table)


if __name__ == "__main__":
    run()
    run_glossy()
    run_narrow()

"""Do the shader texts for other engines compute what torch does: GLSL in a browser's WebGL 2, HLSL where slangpy is?"""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from web.conftest import SIZE, Visit, at

from torchprt import sh
from torchprt.pose.frames import nearest_rotation
from torchprt.sh.hemisphere_basis import exit_recurrence
from torchprt.shade.lobes import turned_exact
from torchprt.web.three import gpu_text

ROOT = Path(__file__).parents[2]
ORDER, VECTORS = 5, 3
COUNT = ORDER**2
CLOSE = 1e-5


def random(*shape, seed):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


LIGHT = random(COUNT, 3, seed=1)
TRANSFER = random(COUNT, 3, seed=2)
BANDS = random(ORDER, 3, seed=3)
AXIS = torch.nn.functional.normalize(random(3, seed=4), dim=0)
LOW = random(4, seed=5)
# A blend of two rotations, scaled.
BLEND = 1.7 * (
    0.4 * torch.eye(3, dtype=torch.float64) + 0.6 * sh.yaw_pitch_roll(torch.tensor([80.0, 30, -40]).double())
)
TANGENT, TOWARD = torch.tensor([0.0, 0, 1]).double(), torch.tensor([2.0, 0.7, -0.4]).double()
NORMAL = torch.tensor([0.6, 0.8, 0]).double()
TABLE, SECTORAL = exit_recurrence(ORDER)
MEANS, WEIGHTS = random(VECTORS + 1, 3, seed=6), random(VECTORS, seed=7)


def expected():
    """Twelve times three numbers, one function after the other."""
    y = sh.basis(AXIS, ORDER)
    bands = torch.arange(ORDER).repeat_interleave(2 * torch.arange(ORDER) + 1)
    turn = nearest_rotation(BLEND)
    low = turned_exact(LOW.reshape(1, 4, 1), turn[None]).reshape(4)
    local = torch.stack([TANGENT @ TOWARD, torch.linalg.cross(NORMAL, TANGENT) @ TOWARD, NORMAL @ TOWARD])
    local = local / local.norm()
    exits = sh.exit_functions(local, ORDER)
    rows = [
        LIGHT.T @ y,
        (TRANSFER[:, :1] * LIGHT).sum(0),
        (TRANSFER * LIGHT).sum(0),
        (BANDS[bands] * y[:, None] * LIGHT).sum(0),
        low[:3],
        low[3].expand(3),
        *turn,
        MEANS[0] + WEIGHTS @ MEANS[1:],
        local,
        LIGHT.T @ exits,
    ]
    return torch.stack(rows).numpy()


def body(vec, mat, array, rows):
    """The calls, in either language: what is `array` of these numbers, and what becomes of `result[12]`."""

    def three(values):
        return f"{vec}3({', '.join(f'{float(x):.9e}' for x in values)})"

    def fill(name, values):
        return " ".join(f"{name}[{i}] = {x};" for i, x in enumerate(values))

    singles = [f"{float(x):.9e}" for x in TRANSFER[:, 0]]
    matrix = BLEND if rows else BLEND.T
    row = "turn[{0}]" if rows else f"{vec}3(turn[0][{{0}}], turn[1][{{0}}], turn[2][{{0}}])"
    low = ", ".join(f"{float(x):.9e}" for x in LOW)
    return f"""
        {array(f"{vec}3", "light", COUNT)} {fill("light", map(three, LIGHT))}
        {array(f"{vec}3", "colours", COUNT)} {fill("colours", map(three, TRANSFER))}
        {array("float", "single", COUNT)} {fill("single", singles)}
        {array(f"{vec}3", "bands", ORDER)} {fill("bands", map(three, BANDS))}
        {array(f"{vec}3", "table", COUNT)} {fill("table", map(three, TABLE))}
        {array("float", "sectoral", ORDER)} {fill("sectoral", [f"{float(x):.9e}" for x in SECTORAL])}
        {array(f"{vec}3", "vectors", VECTORS)} {fill("vectors", map(three, MEANS[1:]))}
        {array("float", "weights", VECTORS)} {fill("weights", [f"{float(x):.9e}" for x in WEIGHTS])}
        {array("float", "y", COUNT)} prtBasis({three(AXIS)}, y);
        {array(f"{vec}3", "result", 12)}
        result[0] = prtDiffuse(y, light);
        result[1] = prtDiffuse(single, light);
        result[2] = prtDiffuseColour(colours, light);
        result[3] = prtLobe({three(AXIS)}, bands, light);
        {mat} turn = prtNearestRotation({mat}({", ".join(three(each) for each in matrix)}));
        {vec}4 low = prtTurnedLinear({vec}4({low}), turn);
        result[4] = low.xyz;
        result[5] = low.www;
        result[6] = {row.format(0)};
        result[7] = {row.format(1)};
        result[8] = {row.format(2)};
        result[9] = prtClustered({three(MEANS[0])}, vectors, weights);
        result[10] = prtLocalView({three(TOWARD)}, {three(TANGENT)}, {three(NORMAL)});
        prtExitFunctions(result[10], table, sectoral, y);
        result[11] = prtDiffuse(y, light);"""


DEFINED = f"#define PRT_ORDER {ORDER}\n#define PRT_VECTORS {VECTORS}\n"


def test_the_files_for_other_engines_are_made_of_the_sources_of_the_module():
    spec = importlib.util.spec_from_file_location("make_gpu", ROOT / "docs/make/gpu.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    old = [path for path, text in make.texts().items() if path.read_text(encoding="utf-8") != text]
    assert not old, "run docs/make/gpu.py"


def test_the_tables_of_every_projection_make_its_exit_functions():
    directions = torch.nn.functional.normalize(random(20, 3, seed=8).abs(), dim=-1)
    for projection in ("optimal", "zero", "odd", "reduced"):
        for order in (1, 2, 5):
            table, sectoral = exit_recurrence(order, projection)
            e = [[float(sectoral[0])] * 20]
            for l in range(1, order):
                start, last = l * l, (l - 1) ** 2
                cosine, sine = np.array(e[start - 1]), np.array(e[last]) if l > 1 else np.zeros(20)
                x, y, z = directions.numpy().T
                band = [float(sectoral[l]) * (x * sine + y * cosine)]
                for i in range(1, 2 * l):
                    slope, level, across = table[start + i].tolist()
                    risen = np.array(e[last + i - 1]) * (slope * z + level)
                    if 1 < i < 2 * l - 1:
                        risen = risen - across * np.array(e[last - 2 * l + 3 + i - 2])
                    band.append(risen)
                e += [*band, float(sectoral[l]) * (x * cosine - y * sine)]
            whole = "zero" if projection == "reduced" else projection
            np.testing.assert_allclose(np.stack(e, -1), sh.exit_functions(directions, order, whole), atol=1e-10)


def test_glsl_compiles_and_computes_what_torch_does(browser, libraries, tmp_path):
    shader = (
        "precision highp float;\n"
        + DEFINED
        + gpu_text("prt.glsl")
        + "out vec4 color;\nvoid main() {"
        + body("vec", "mat3", lambda kind, name, size: f"{kind} {name}[{size}];", rows=False)
        + "color = vec4(result[int(gl_FragCoord.x)], 1.0); }"
    )
    (tmp_path / "index.html").write_text("<body data-ready=yes>shaders</body>")
    with at(tmp_path) as root:
        page = browser.new_page(viewport=SIZE)
        tab = Visit(page).open(root)
        found = tab.ask(f"""
            const gl = new OffscreenCanvas(12, 1).getContext("webgl2");
            gl.getExtension("EXT_color_buffer_float");
            const program = gl.createProgram();
            const texts = ["in vec4 place; void main() {{ gl_Position = place; }}", {json.dumps(shader)}];
            for (const [i, text] of texts.entries()) {{
              const shader = gl.createShader(i ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
              gl.shaderSource(shader, "#version 300 es\\n" + text);
              gl.compileShader(shader);
              if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) return gl.getShaderInfoLog(shader);
              gl.attachShader(program, shader);
            }}
            gl.linkProgram(program);
            gl.useProgram(program);
            gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
            gl.bufferData(gl.ARRAY_BUFFER, Float32Array.of(-1, -1, 3, -1, -1, 3), gl.STATIC_DRAW);
            gl.enableVertexAttribArray(0);
            gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
            gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
            gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, 12, 1);
            gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
            const texture = gl.getParameter(gl.TEXTURE_BINDING_2D);
            gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
            gl.viewport(0, 0, 12, 1);
            gl.drawArrays(gl.TRIANGLES, 0, 3);
            const values = new Float32Array(48);
            gl.readPixels(0, 0, 12, 1, gl.RGBA, gl.FLOAT, values);
            return Array.from(values);
        """)
        page.close()
    assert not isinstance(found, str), found
    np.testing.assert_allclose(np.reshape(found, (12, 4))[:, :3], expected(), atol=CLOSE, rtol=CLOSE)


def test_hlsl_compiles_and_computes_what_torch_does():
    pytest.importorskip("slangpy", reason="HLSL IS NOT COMPILED: slangpy is not installed (torchprt[shaders])")
    shader = (
        DEFINED
        + gpu_text("prt.hlsl")
        + 'RWStructuredBuffer<float3> found;\n[shader("compute")] [numthreads(1, 1, 1)]\nvoid shade() {'
        + body("float", "float3x3", lambda kind, name, size: f"{kind} {name}[{size}];", rows=True)
        + "for (int i = 0; i < 12; i++) found[i] = result[i]; }"
    )
    script = """
import json, sys, slangpy
device = slangpy.Device(type=slangpy.DeviceType.cpu, enable_debug_layers=False)
module = device.load_module_from_source("prt", sys.stdin.read())
kernel = device.create_compute_kernel(device.link_program([module], [module.entry_point("shade")]))
buffer = device.create_buffer(element_count=12, struct_size=12, usage=slangpy.BufferUsage.unordered_access)
kernel.dispatch(thread_count=[1, 1, 1], vars={"found": buffer})
print("FOUND", json.dumps(buffer.to_numpy().view("f4").tolist()))
"""
    # Another process: the library writes to the terminal and ends as it likes.
    run = subprocess.run([sys.executable, "-c", script], input=shader, capture_output=True, text=True, timeout=100)
    lines = [line for line in run.stdout.splitlines() if line.startswith("FOUND ")]
    assert lines, run.stdout + run.stderr
    found = np.reshape(json.loads(lines[0][6:]), (12, 3))
    np.testing.assert_allclose(found, expected(), atol=CLOSE, rtol=CLOSE)

"""Are the tone maps those of three.js, as a graphics card draws them, and is the page's the one of all pictures?"""

import numpy as np
import pytest
import torch
from web.conftest import at

from torchprt.shade import agx, neutral
from torchprt.shade.display import TONE, tone_mapped

# Draws a row of pixels, each the tone map of a colour, in float32.
DRAW = """
    const { ShaderChunk } = await import("./libraries/three.module.min.js");
    const { DISPLAY } = await import("./display.js");
    const [colours, expression] = GIVEN;
    const gl = document.createElement("canvas").getContext("webgl2");
    gl.getExtension("EXT_color_buffer_float");
    const compile = (kind, source) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      return shader;
    };
    const parts = expression.includes("ToneMapping") ? ShaderChunk.tonemapping_pars_fragment : DISPLAY;
    const program = gl.createProgram();
    gl.attachShader(program, compile(gl.VERTEX_SHADER, `#version 300 es
      void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER, `#version 300 es
      precision highp float;
      precision highp sampler2D;
      #define saturate(a) clamp(a, 0.0, 1.0)
      ${parts}
      uniform sampler2D colours;
      out vec4 shown;
      void main() {
        vec3 given = texelFetch(colours, ivec2(gl_FragCoord.xy), 0).rgb;
        shown = vec4(${expression}(given), 1.0);
      }`));
    gl.linkProgram(program);
    gl.useProgram(program);
    gl.uniform1f(gl.getUniformLocation(program, "toneMappingExposure"), 1);
    const width = colours.length / 4;
    const texture = (values) => {
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, 1, 0, gl.RGBA, gl.FLOAT, values);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      return gl.getParameter(gl.TEXTURE_BINDING_2D);
    };
    const target = texture(null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
    texture(new Float32Array(colours));
    gl.viewport(0, 0, width, 1);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const values = new Float32Array(4 * width);
    gl.readPixels(0, 0, width, 1, gl.RGBA, gl.FLOAT, values);
    return Array.from(values);
"""


@pytest.fixture(scope="module")
def address(pages):
    with at(pages.parent) as root:
        yield f"{root}/some%20where/plane/"


def colours():
    """From black to 250, of all hues."""
    random = torch.rand(300, 3, generator=torch.Generator().manual_seed(0))
    return random * 2.0 ** torch.linspace(-10, 8, 300)[:, None]


def drawn(tab, expression):
    given = torch.cat([colours(), torch.ones(300, 1)], 1).flatten().tolist()
    found = tab.page.evaluate(f"async (GIVEN) => {{ {DRAW} }}", [given, expression])
    return torch.from_numpy(np.float32(found)).view(-1, 4)[:, :3]


@pytest.mark.parametrize(("name", "ours"), [("NeutralToneMapping", neutral), ("AgXToneMapping", agx)])
def test_three_shows_the_same_colours(visit, address, name, ours):
    found, wanted = drawn(visit().open(address), name), ours(colours())
    # log2, pow and a polynomial whose terms cancel, in float32.
    torch.testing.assert_close(found, wanted, rtol=0, atol=5e-5)
    assert float(wanted.std()) > 0.2


def test_the_page_shows_the_tone_of_all_pictures(visit, address):
    found = drawn(visit().open(address), TONE)
    torch.testing.assert_close(found, tone_mapped(colours()), rtol=0, atol=1e-5)

"""Does shading need torch alone?"""

import subprocess
import sys

HEAVY = ("trimesh", "embreex", "open3d", "onnx", "onnxruntime", "matplotlib", "kornia", "OpenEXR", "imageio", "PIL")


def test_importing_the_run_time_brings_nothing_heavy():
    code = f"import sys, torchprt.shade; print(*[name for name in {HEAVY!r} if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == []

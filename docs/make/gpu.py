"""Writes what export/three and export/shaders hold: the module for three.js and the texts of shaders.

python docs/make/gpu.py            writes the files
python docs/make/gpu.py --check    fails if a file is not what it would write
"""

from __future__ import annotations

import sys
from pathlib import Path

from torchprt.web.three import gpu_text, module

EXPORT = Path(__file__).parents[2] / "export"


def texts() -> dict[Path, str]:
    """What each file should hold."""
    made = {EXPORT / "shaders" / name: gpu_text(name) for name in ("prt.glsl", "prt.hlsl")}
    return made | {EXPORT / "three" / "torchprt.js": module()}


def main() -> int:
    old = [path for path, text in texts().items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    if "--check" in sys.argv[1:]:
        for path in old:
            print(f"{path} is not what docs/make/gpu.py makes: run it")
        return len(old)
    for path in old:
        path.write_text(texts()[path], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""How fast is the page? In a headless Chromium on this machine, WebGL in software.

    python scripts/benchmarks/web.py

The bunny (TORCHPRT_DATA names the folder with mesh/bunny.ply) or the project's own sculpture, order 5, one channel.
A cold page is one in a browser that was just started. Times are of the page's own clock.
"""

import os
import shutil
import statistics
import tempfile
import threading
from pathlib import Path

import rich

from torchprt import bake, load, web
from torchprt.scene import Scene, samples
from torchprt.web import serve

ORDER, RAYS = 5, 64
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")

SHADES = """
async () => {
  const it = window.torchprt;
  await it.raced;
  const times = [];
  for (let turn = 0; turn < 60; turn++) {
    const start = performance.now();
    await it.model.shade(it.light.coefficients, it.rotation, it.view.eye.toArray());
    times.push(performance.now() - start);
  }
  return times.slice(10);
}
"""


def scene_to_measure() -> Scene:
    """The bunny where there is one, else the sculpture; says which."""
    folder = Path(os.environ.get("TORCHPRT_DATA") or Path(__file__).parents[3] / "shared" / "data")
    path = folder / "mesh" / "bunny.ply"
    if path.is_file():
        rich.print(f"scene: {path.name}")
        return load(path, albedo=0.6)
    rich.print(f"scene: the project's own sculpture, since there is no {path} (set TORCHPRT_DATA)")
    return samples.organic(35_000)


def run(rounds: int = 5) -> None:
    """Prints the figures of the page beside their targets."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    transfer = bake(scene_to_measure(), order=ORDER, rays=RAYS, progress=False)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        report = web.export(transfer, Path(folder) / "page")
        with serve(report.folder) as server:
            thread = threading.Thread(target=server.serve_forever, daemon=True)
            thread.start()
            firsts, shades = [], []
            for _ in range(rounds):
                browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                page.goto(f"http://127.0.0.1:{server.server_port}/")
                page.wait_for_selector("body[data-ready]", timeout=60_000)
                firsts.append(float(page.evaluate("document.body.dataset.ready")))
                shades.append(statistics.median(page.evaluate(SHADES)))
                version = f"Chromium {browser.version}"
                browser.close()
            server.shutdown()
            thread.join()
    rich.print(f"{transfer.vertices} vertices, order {ORDER}, {rounds} cold browsers, {version}")
    own = report.model_bytes / 2**20
    rich.print(f"folder: {report.bytes / 2**20:.1f} MB (target 20), of which model, mesh and lights are {own:.1f}")
    rich.print(f"first picture of a cold page: {_spread(firsts, 1e-3)} s (target 3)")
    rich.print(f"one shade, WebAssembly on one thread: {_spread(shades, 1)} ms (target 10)")


def _spread(values: list[float], unit: float) -> str:
    middle, low, high = (unit * value for value in (statistics.median(values), min(values), max(values)))
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


if __name__ == "__main__":
    run()

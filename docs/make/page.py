"""Writes docs/images/page.png: the web page of a baked scene, as a browser shows it.

    python docs/make/page.py

Needs Chromium and playwright, and npm the first time.
"""

import io
import shutil
import tempfile
import threading
from pathlib import Path

import pictures
from PIL import Image
from playwright.sync_api import sync_playwright

from torchprt import web
from torchprt.web import serve

FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--force-color-profile=srgb")
SIZE = {"width": 1200, "height": 760}


def main() -> None:
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page = web.export(pictures.staged(3), Path(folder) / "page", title="Sculpture")
        with serve(page.folder) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
            tab = browser.new_page(viewport=SIZE)
            tab.goto(f"http://127.0.0.1:{server.server_port}/")
            tab.wait_for_selector("body[data-ready]", timeout=60_000)
            tab.click("#environments label:nth-child(2)")
            tab.evaluate(
                "async () => { await torchprt.raced; await torchprt.turnLight(60, 0); await torchprt.zoom(0.6); }"
            )
            tab.evaluate("async () => { torchprt.turnCamera(-30, -25); await torchprt.change(); }")
            picture = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
            browser.close()
            server.shutdown()
    picture.save(pictures.FOLDER / "page.png", optimize=True)


if __name__ == "__main__":
    main()

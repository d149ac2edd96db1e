"""A page and a browser to look at it with. Where one of them cannot be had, tests say so and are skipped."""

import contextlib
import dataclasses
import functools
import shutil
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import torch
from jaxtyping import config

from torchprt import bake, web
from torchprt.compression import compress
from torchprt.errors import InputError
from torchprt.scene import Material, samples
from torchprt.transfer import Transfer, save

SIZE = {"width": 760, "height": 420}


@pytest.fixture(scope="session")
def libraries() -> Path:
    try:
        return web.libraries()
    except InputError as fault:
        pytest.skip(f"THE PAGE IS NOT TESTED: {fault}")


@pytest.fixture(scope="session")
def plane() -> Transfer:
    """A ground with the shadow of a square: nothing hides anything, so every pixel of it is smooth."""
    return bake(samples.plane_and_blocker(32), order=4, rays=256, progress=False)


@pytest.fixture(scope="session")
def dish() -> Transfer:
    """A glossy dish, and beside it a mirror, which is drawn and not shaded."""
    material = Material(0.2, gloss="ggx:0.4", specular=(0.9, 0.6, 0.3))
    baked = bake(samples.dish(24, material), order=3, rays=64, progress=False)
    ring = samples.ring(12)
    parts = {"positions": ring.positions, "normals": ring.normals, "faces": ring.faces}
    parts["reflectance"] = torch.tensor([0.9, 0.6, 0.3]).expand(len(ring.positions), 3)
    receivers = baked.receivers.replace(**{f"mirror_{name}": value for name, value in parts.items()})
    return dataclasses.replace(baked, receivers=receivers)


@pytest.fixture(scope="session")
def pages(libraries: Path, plane: Transfer, dish: Transfer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pages "plane" (with a compressed twin) and "dish", in a folder inside a folder; their transfer is beside them."""
    folder = tmp_path_factory.mktemp("site") / "some where"
    packed = compress(plane, clusters=8, components=2)
    config.update("jaxtyping_disable", True)
    web.export(plane, folder / "plane", compressed=packed, title="A plane", check=False)
    web.export(dish, folder / "dish", title="A dish", check=False)
    config.update("jaxtyping_disable", False)
    save(packed, folder / "packed.safetensors")
    return folder


class Quiet(SimpleHTTPRequestHandler):
    """A static server that knows nothing of pages."""

    def log_message(self, *_: Any) -> None:
        pass


@contextlib.contextmanager
def at(folder: Path) -> Iterator[str]:
    """The address of a plain static server of `folder`."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.fixture(scope="session")
def launch() -> Iterator[Callable[..., Any]]:
    """`launch(flag, ...)`: a headless Chromium."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("THE PAGE IS NOT TESTED: there is no Chromium (Debian: apt-get install chromium)")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="THE PAGE IS NOT TESTED: playwright is not installed"
    )
    # WebGL in software: a machine for tests has no graphics card.
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--force-color-profile=srgb"]
    with playwright.sync_playwright() as run:
        started = []

        def launch(*more: str) -> Any:
            started.append(run.chromium.launch(executable_path=program, args=[*flags, *more]))
            return started[-1]

        yield launch
        for each in started:
            each.close()


@pytest.fixture(scope="session")
def browser(launch: Callable[..., Any]) -> Any:
    return launch()


class Visit:
    """A page that is looked at, and everything that it asked for or complained of."""

    def __init__(self, page: Any):
        self.page = page
        self.requests: list[str] = []
        self.complaints: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("requestfailed", lambda request: self.complaints.append(f"{request.url}: {request.failure}"))
        page.on("pageerror", lambda fault: self.complaints.append(str(fault)))
        page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)

    def open(self, address: str) -> "Visit":
        self.page.goto(address)
        self.page.wait_for_selector("body[data-ready]", timeout=60_000)
        return self

    def ask(self, script: str) -> Any:
        """What the script gives, in which `it` is the viewer; promises are waited for."""
        return self.page.evaluate(f"async () => {{ const it = window.torchprt; {script} }}")

    def settled(self) -> None:
        """Until what is shown is what was asked for."""
        self.ask("await it.change();")

    def radiance(self) -> list[float]:
        self.settled()
        return self.ask("return Array.from(it.radiance);")

    def drag(self, right: float, down: float, *, button: str = "left", shift: bool = False) -> None:
        """With the mouse, from the middle of the picture."""
        box = self.page.locator("#canvas").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        mouse, keyboard = self.page.mouse, self.page.keyboard
        if shift:
            keyboard.down("Shift")
        mouse.move(x, y)
        mouse.down(button=button)
        mouse.move(x + right, y + down, steps=5)
        mouse.up(button=button)
        if shift:
            keyboard.up("Shift")
        self.settled()


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[[], Visit]]:
    """`visit()`: a new tab."""
    tabs = []

    def visit() -> Visit:
        tabs.append(browser.new_page(viewport=SIZE))
        return Visit(tabs[-1])

    yield visit
    for tab in tabs:
        tab.close()

"""The window: Open3D's legacy visualiser, which shows vertex colours as they are. Open3D is imported when it opens."""

from __future__ import annotations

import functools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchprt.errors import InputError
from torchprt.preview.controls import HELP, Controls, Event
from torchprt.preview.drawing import Drawing
from torchprt.preview.picture import save_png
from torchprt.preview.session import PLAIN, Session

REST = 0.004
"""Seconds of sleep when nothing has changed."""
HINT = "right drag turns the light, H is help"
OFF_SCREEN = "write pictures with `torchprt render`, which needs no display"


def show(
    session: Session,
    *,
    size: tuple[int, int] = (1024, 768),
    name: str = "torchprt",
    pictures: str | os.PathLike[str] = ".",
    say: Callable[[str], None] = print,
) -> None:
    """Opens a window on `session` and returns when it is closed. Pictures that are saved go to the folder `pictures`.

    Raises InputError as `check_window`.
    """
    open3d = check_window()
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    window = Window(open3d, session, size, name, Path(pictures), say)
    try:
        window.run()
    finally:
        window.close()


def check_window() -> Any:
    """The module of Open3D, if a window could be opened.

    Raises InputError, and says how to do without, if it is not installed or there is no display.
    """
    try:
        import open3d
    except (ImportError, OSError) as fault:
        missing = "is not installed" if isinstance(fault, ModuleNotFoundError) else f"cannot be loaded ({fault})"
        raise InputError(
            f"the window needs Open3D, which {missing}: pip install 'torchprt[preview]' (on a bare Debian also "
            f"apt-get install libusb-1.0-0 libgl1 libegl1), or {OFF_SCREEN}"
        ) from fault
    if not has_display():
        raise InputError(f"there is no display to open a window on: {OFF_SCREEN}")
    return open3d


def has_display() -> bool:
    """Whether a window could be opened here. Open3D does not say: without a display it goes on unseen."""
    if not sys.platform.startswith("linux"):
        return True
    wayland = os.environ.get("WAYLAND_DISPLAY")
    if wayland and Path(os.environ.get("XDG_RUNTIME_DIR", "/"), wayland).exists():
        return True
    name = os.environ.get("DISPLAY")
    return bool(name) and _connection(name) is not None


@functools.cache
def _connection(name: str) -> int | None:
    """A connection to an X server, None if it does not answer.

    It is kept: an X server that loses its last client starts anew, and Open3D, coming meanwhile, would find none.
    """
    import ctypes

    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return None
    x11.XOpenDisplay.restype = ctypes.c_void_p
    return x11.XOpenDisplay(name.encode())


class Window:
    """An Open3D window and the loop that keeps it as the session is.

    Events are only collected while Open3D polls, and taken after: an exception inside its callbacks would be lost.
    """

    def __init__(
        self,
        open3d: Any,
        session: Session,
        size: tuple[int, int],
        name: str,
        pictures: Path,
        say: Callable[[str], None],
    ):
        self.session = session
        self.pictures = pictures
        self.say = say
        self.viewer = open3d.visualization.VisualizerWithKeyCallback()
        if not self.viewer.create_window(name, *size):
            raise InputError(f"the window could not be opened (it needs OpenGL 3.3): {OFF_SCREEN}")
        options = self.viewer.get_render_option()
        options.light_on = False
        options.background_color = np.full(3, PLAIN)
        self.controls = Controls(session, say, size)
        self.drawing = Drawing(open3d, self.viewer, session)
        self._events: list[Event] = []
        self._ticks: list[float] = []
        self._now = time.perf_counter()
        self._listen()

    def run(self) -> None:
        """Until the window is closed."""
        going = self.step()
        # When there is something to be seen that the keys change.
        self.say("\n".join(f"{key:20} {what}" for key, what in HELP))
        while going:
            going = self.step()

    def step(self) -> bool:
        """One round: what has happened, what it changes, what is drawn. False once the window is closed."""
        self._events.clear()
        if not self.viewer.poll_events():
            return False
        self.controls.size = self._size()
        for event in self._events:
            self.controls.take(event)
        if self.controls.closing:
            return False
        now = time.perf_counter()
        self.session.advance(now - self._now)
        self._now = now
        if self.drawing.update(self.controls.size, self._lines()) or self.controls.rate:
            self.viewer.update_renderer()
            self._count()
        else:
            time.sleep(REST)
        if self.controls.saving:
            self.controls.saving = False
            self._save()
        return True

    def close(self) -> None:
        self.viewer.destroy_window()

    def _listen(self) -> None:
        def note(event: Event) -> bool:
            self._events.append(event)
            return False

        def nothing(_: Any) -> bool:
            return False

        viewer = self.viewer
        # Open3D's own keys change how colours are shown.
        for code in (*range(32, 97), *range(256, 349)):
            viewer.register_key_callback(code, nothing)
        for code in self.controls.keys:
            viewer.register_key_action_callback(
                code, lambda _, action, modifiers, code=code: note(Event("key", code, action, modifiers))
            )
        viewer.register_mouse_button_callback(lambda _, *pressed: note(Event("button", *pressed)))
        viewer.register_mouse_move_callback(lambda _, x, y: note(Event("move", x=x, y=y)))
        viewer.register_mouse_scroll_callback(lambda _, x, y: note(Event("scroll", x=x, y=y)))

    def _size(self) -> tuple[int, int]:
        shown = self.viewer.get_view_control().convert_to_pinhole_camera_parameters().intrinsic
        return max(int(shown.width), 1), max(int(shown.height), 1)

    def _lines(self) -> list[str]:
        lines = self.session.status()
        if self.controls.rate:
            lines.append(f"{self._rate():.0f} frames per second")
        if not self.controls.help:
            return [*lines, HINT]
        return [*lines, "", *(f"{key}\t{what}" for key, what in HELP)]

    def _count(self) -> None:
        now = time.perf_counter()
        self._ticks = [tick for tick in self._ticks if now - tick < 1] + [now]

    def _rate(self) -> float:
        if len(self._ticks) < 2:
            return 0.0
        return (len(self._ticks) - 1) / (self._ticks[-1] - self._ticks[0])

    def _save(self) -> None:
        number = 1
        while (self.pictures / f"preview-{number}.png").exists():
            number += 1
        path = self.pictures / f"preview-{number}.png"
        # Not by Open3D, which only prints that a disk is full.
        shown = np.asarray(self.viewer.capture_screen_float_buffer(do_render=True))
        try:
            save_png(torch.from_numpy(shown.copy()), path)
        except InputError as fault:
            # The window stays: it may have been turned for long.
            self.say(str(fault))
        else:
            self.say(f"saved: {path}")

"""A screen without a monitor (Xvfb), the window of a process on it, and a hand on mouse and keyboard (xdotool)."""

import ctypes
import os
import queue
import re
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import PIL.ImageGrab

PATIENCE = 120
"""Seconds to wait for what is bound to happen, on a machine that does other things too."""


def missing():
    """What a window cannot be opened without, here; empty if nothing is missing."""
    lacking = [f"the program {name}" for name in ("Xvfb", "xdotool") if shutil.which(name) is None]
    check = subprocess.run([sys.executable, "-c", "import open3d"], capture_output=True, text=True, check=False)
    if check.returncode:
        lacking.append(f"Open3D ({(check.stderr.strip().splitlines() or ['it crashes'])[-1]})")
    return ", ".join(lacking)


class Screen:
    """An X server of its own, on the first free display."""

    def __init__(self, width=900, height=700):
        read, write = os.pipe()
        self.server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x24", "-nolisten", "tcp", "-noreset"],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as stream:
            self.display = ":" + stream.readline().strip()
        assert self.display != ":", "Xvfb did not start"

    def environment(self, folder):
        """Variables for a process on this screen; `folder`: for what it keeps while it runs."""
        kept = {name: value for name, value in os.environ.items() if name != "WAYLAND_DISPLAY"}
        return kept | {"DISPLAY": self.display, "XDG_RUNTIME_DIR": str(folder), "LIBGL_ALWAYS_SOFTWARE": "1"}

    def close(self):
        self.server.terminate()
        self.server.wait(PATIENCE)


class Opened:
    """`torchprt preview` with a window on `screen`."""

    def __init__(self, screen, folder, *arguments):
        self.screen, self.folder = screen, folder
        self._environment = screen.environment(folder)
        self._complaints = (folder / "complaints").open("w")
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-m", "torchprt", "preview", *map(str, arguments)],
            cwd=folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            text=True,
        )
        self.lines = queue.Queue()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        self.said = self.until("Esc")
        self.window = self._search()
        place = self._hand("getwindowgeometry", "--shell", self.window)
        self.left, self.top, self.width, self.height = (
            int(re.search(rf"^{name}=(-?\d+)$", place, re.M)[1]) for name in ("X", "Y", "WIDTH", "HEIGHT")
        )
        self._hand("windowfocus", self.window)
        self.settled()

    def until(self, word):
        """The lines said up to the one that holds `word`."""
        found, deadline = [], time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            try:
                found.append(self.lines.get(timeout=0.2))
            except queue.Empty:
                assert self.process.poll() is None, f"it ended: {(self.folder / 'complaints').read_text()}"
                continue
            if word in found[-1]:
                return found
        raise AssertionError(f"'{word}' was not said, but {found}")

    def press(self, key):
        """Presses a key; what is said of it."""
        self._hand("key", key)
        return self.until("")[-1]

    def drag(self, right, down, button=1, shift=False):
        """From the middle of the window, in steps, as a hand does."""
        x, y = self.left + self.width // 2, self.top + self.height // 2
        steps = [
            part
            for step in range(1, 9)
            for part in ("mousemove", str(x + right * step // 8), str(y + down * step // 8), "sleep", "0.01")
        ]
        keys = ("keydown", "shift"), ("keyup", "shift")
        self._hand("mousemove", x, y, *(keys[0] if shift else ()), "mousedown", button)
        self._hand(*steps)
        self._hand("mouseup", button, *(keys[1] if shift else ()))
        return self.settled()

    def click(self, x, y, button=1):
        """Clicks at a pixel of the window; what is said of it."""
        self._hand("mousemove", self.left + x, self.top + y, "click", button)
        return self.until("vertex")[-1]

    def wheel(self, steps):
        button = 4 if steps > 0 else 5
        self._hand("mousemove", self.left + 40, self.top + self.height - 40)
        self._hand("click", "--repeat", abs(steps), button)
        return self.settled()

    def picture(self):
        """What the screen shows of the window, uint8 [H, W, 3]."""
        box = self.left, self.top, self.left + self.width, self.top + self.height
        grabbed = PIL.ImageGrab.grab(bbox=box, xdisplay=self.screen.display)
        return np.asarray(grabbed.convert("RGB")).astype(int)

    def settled(self):
        """The picture once it no longer changes."""
        deadline, before, same = time.monotonic() + PATIENCE, None, 0
        while time.monotonic() < deadline:
            time.sleep(0.15)
            shown = self.picture()
            same = same + 1 if before is not None and np.array_equal(shown, before) else 0
            if same == 3:
                return shown
            before = shown
        raise AssertionError("the picture does not come to rest")

    def ask_to_close(self):
        """What a window manager sends when its cross is clicked."""
        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XInternAtom.restype = ctypes.c_ulong
        x11.XInternAtom.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int]
        x11.XSendEvent.argtypes = [ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int, ctypes.c_long, ctypes.c_void_p]
        x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
        display = x11.XOpenDisplay(self.screen.display.encode())
        # XClientMessageEvent: type, serial, send_event, display, window, message_type, format, five longs.
        event = (ctypes.c_long * 24)()
        event[0], event[4], event[6] = 33, int(self.window), 32
        event[5] = x11.XInternAtom(display, b"WM_PROTOCOLS", 0)
        event[7] = x11.XInternAtom(display, b"WM_DELETE_WINDOW", 0)
        x11.XSendEvent(display, int(self.window), 0, 0, event)
        x11.XCloseDisplay(display)

    def ended(self):
        """The exit code, and what was complained of."""
        return self.process.wait(PATIENCE), (self.folder / "complaints").read_text()

    def close(self):
        self.process.kill()
        self.process.wait(PATIENCE)
        self._complaints.close()
        self._listener.join(PATIENCE)
        self.process.stdout.close()

    def _listen(self):
        for line in self.process.stdout:
            self.lines.put(line.rstrip("\n"))

    def _search(self):
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            words = ["xdotool", "search", "--onlyvisible", "--name", "torchprt"]
            found = subprocess.run(words, env=self._environment, capture_output=True, text=True, check=False)
            if found.stdout.split():
                return found.stdout.split()[-1]
            time.sleep(0.2)
        raise AssertionError(f"there is no window: {found.stderr}")

    def _hand(self, *words):
        done = subprocess.run(
            ["xdotool", *map(str, words)],
            env=self._environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=PATIENCE,
        )
        return done.stdout

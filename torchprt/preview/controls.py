"""What the keys and the mouse do: events in, changes of the session out. No window in it either."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from torchprt.preview.session import MODES, Session

HELP = (
    ("drag", "turn the camera"),
    ("right or Shift drag", "turn the light"),
    ("wheel", "nearer, farther"),
    ("click", "the transfer function of a vertex"),
    ("left, right", "environment"),
    ("up, down", "exposure"),
    ("1 2 3 4 5 6", "transfer, unshadowed, one lamp, compressed, error of compression, sight"),
    ("M", "next of these modes"),
    ("- =", "fewer, more bands of the light"),
    ("W", "window against ringing"),
    ("I", "without, with interreflection, if both files were given"),
    ("Space", "move the model, if its transfer follows the pose"),
    ("E", "environment behind the model"),
    ("R", "camera and light as in the beginning"),
    ("S", "save a picture of the window"),
    ("F", "frames per second"),
    ("H", "these lines"),
    ("Q, Esc", "close"),
)
# Codes of GLFW, for what is not the character itself.
ESCAPE, RIGHT, LEFT, DOWN, UP, PLUS, MINUS = 256, 262, 263, 264, 265, 334, 333
PRESS, SHIFT = 1, 1
STILL = 4.0
"""Pixels that a click may move without being a drag."""
STOP = 0.5


@dataclass
class Event:
    """What GLFW tells: a "key" or "button" with its action and modifiers, a "move" to a place, a "scroll"."""

    what: str
    code: int = 0
    action: int = 0
    modifiers: int = 0
    x: float = 0.0
    y: float = 0.0


class Controls:
    """Turns events into changes of `session`; `say` is called with a line for each that is not a drag.

    `closing`, `saving`: what only the window can do; it takes `saving` back. `help`, `rate`: whether the lines of help
    and the frames per second are to be shown.
    """

    def __init__(self, session: Session, say: Callable[[str], None], size: tuple[int, int]):
        self.session = session
        self.say = say
        self.size = size
        self.closing = self.saving = self.help = self.rate = False
        self._place = (0.0, 0.0)
        self._held: str | None = None
        self._moved = 0.0
        self._keys: dict[int, Callable[[], str]] = {
            RIGHT: session.next_environment,
            LEFT: lambda: session.next_environment(-1),
            UP: lambda: session.expose(STOP),
            DOWN: lambda: session.expose(-STOP),
            **{ord("1") + number: lambda mode=mode: session.set_mode(mode) for number, mode in enumerate(MODES)},  # type: ignore[misc]
            ord("M"): session.next_mode,
            ord("-"): lambda: session.change_order(-1),
            MINUS: lambda: session.change_order(-1),
            ord("="): lambda: session.change_order(1),
            PLUS: lambda: session.change_order(1),
            ord("W"): session.next_window,
            ord("I"): session.next_bake,
            ord(" "): session.play,
            ord("E"): session.next_backdrop,
            ord("R"): session.reset,
            ord("S"): self._save,
            ord("F"): self._show_rate,
            ord("H"): self._show_help,
            ord("Q"): self._close,
            ESCAPE: self._close,
        }

    @property
    def keys(self) -> list[int]:
        """The codes of the keys that do something."""
        return list(self._keys)

    def take(self, event: Event) -> None:
        if event.what == "key" and event.action == PRESS and event.code in self._keys:
            self.say(self._keys[event.code]())
        elif event.what == "scroll":
            self.session.zoom(event.y)
        elif event.what == "button":
            self._button(event)
        elif event.what == "move":
            self._move(event.x, event.y)

    def _button(self, event: Event) -> None:
        if event.action == PRESS:
            self._held = "light" if event.code == 1 or event.modifiers & SHIFT else "camera"
            self._moved = 0.0
            return
        if self._held == "camera" and self._moved <= STILL:
            self.say(self.session.pick(*self._place, *self.size))
        self._held = None

    def _move(self, x: float, y: float) -> None:
        right, down = x - self._place[0], y - self._place[1]
        self._place = x, y
        if self._held is None:
            return
        self._moved += math.hypot(right, down)
        if self._moved <= STILL:
            return
        # The height of the window is half a turn.
        angle = math.pi / max(self.size[1], 1)
        turn = self.session.turn_light if self._held == "light" else self.session.turn_camera
        turn(right * angle, down * angle)

    def _close(self) -> str:
        self.closing = True
        return "closed"

    def _save(self) -> str:
        self.saving = True
        return "saving a picture"

    def _show_rate(self) -> str:
        self.rate = not self.rate
        return f"frames per second: {'on' if self.rate else 'off'}"

    def _show_help(self) -> str:
        self.help = not self.help
        return f"help: {'on' if self.help else 'off'}"

"""Does each key, drag and click do what the help says?"""

import pytest
import torch

from torchprt import light
from torchprt.preview import Environment, Session
from torchprt.preview.controls import ESCAPE, HELP, LEFT, MINUS, PLUS, RIGHT, UP, Controls, Event

SIZE = (400, 300)


@pytest.fixture
def controls(make_transfer):
    lights = [Environment(name, light.hemisphere((0.0, 1.0, 0.0), 1.0, 0.2, 4).float()) for name in ("one", "two")]
    bakes = {"a": make_transfer(order=4), "b": make_transfer(order=4, seed=1, bounces=1, transport="interreflected")}
    lines = []
    made = Controls(Session(bakes, lights), lines.append, SIZE)
    made.lines = lines
    return made


def press(controls, *codes):
    for code in codes:
        controls.take(Event("key", code if isinstance(code, int) else ord(code), 1))
        controls.take(Event("key", code if isinstance(code, int) else ord(code), 0))
    return controls.lines[-1] if controls.lines else None


def drag(controls, right, down, button=0, modifiers=0, steps=5):
    controls.take(Event("move", x=200.0, y=150.0))
    controls.take(Event("button", button, 1, modifiers))
    for step in range(1, steps + 1):
        controls.take(Event("move", x=200.0 + right * step / steps, y=150.0 + down * step / steps))
    controls.take(Event("button", button, 0, modifiers))


@pytest.mark.parametrize("code", [0, 65, 999, -1])
def test_other_keys_do_nothing(controls, code):
    before = controls.session.colours()
    assert press(controls, code) is None
    assert controls.session.colours() is before


@pytest.mark.parametrize("what", ["button", "move", "scroll", "key", "nothing"])
def test_events_of_nothing_do_no_harm(controls, what):
    controls.take(Event(what))
    assert not controls.closing


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ([RIGHT], "environment: two"),
        ([RIGHT, RIGHT], "environment: one"),
        ([LEFT], "environment: two"),
        (["1"], "mode: transfer"),
        (["2"], "mode: unshadowed"),
        (["3"], "mode: one lamp"),
        (["5"], "mode: error"),
        (["M"], "mode: unshadowed"),
        (["-"], "order: 3"),
        ([MINUS, MINUS, "="], "order: 3"),
        ([MINUS, PLUS], "order: 4"),
        (["W"], "window: hann"),
        (["I"], "bake: b, interreflected, 1 bounce"),
        (["E"], "behind: environment"),
        (["R"], "camera and light as in the beginning"),
        (["H"], "help: on"),
        (["H", "H"], "help: off"),
        (["F"], "frames per second: on"),
        ([" "], "this bake stands still: give one in zonal lobes, which follows the pose"),
    ],
)
def test_every_key_says_what_it_did(controls, keys, line):
    assert press(controls, *keys) == line


def test_the_compressed_bake_is_on_the_fourth_key(controls):
    assert press(controls, "4").startswith("mode: compressed, ")


def test_exposure_goes_up_by_half_a_stop(controls):
    before = controls.session.stops
    press(controls, UP)
    assert controls.session.stops == pytest.approx(before + 0.5)


@pytest.mark.parametrize("code", [ESCAPE, ord("Q")])
def test_escape_and_q_close(controls, code):
    press(controls, code)
    assert controls.closing


def test_a_picture_is_saved_once(controls):
    press(controls, "S")
    assert controls.saving


def test_the_help_names_every_key(controls):
    words = {"Space": " ", "Esc": ESCAPE, "left": LEFT, "right": RIGHT, "up": UP, "down": 264}
    named = set()
    for keys, _ in HELP:
        for word in keys.replace(",", " ").split():
            if len(word) == 1 or word in words:
                code = words.get(word, word)
                named.add(code if isinstance(code, int) else ord(code))
    # The number pad has the signs once more.
    assert named == set(controls.keys) - {PLUS, MINUS}


# The mouse


def state(controls):
    return controls.session.orbit, controls.session.rotation


def test_the_left_button_turns_the_camera_alone(controls):
    orbit, rotation = state(controls)
    drag(controls, 60, 20)
    assert controls.session.orbit.yaw < orbit.yaw
    assert controls.session.orbit.pitch > orbit.pitch
    assert torch.equal(controls.session.rotation, rotation)


@pytest.mark.parametrize(("button", "modifiers"), [(1, 0), (0, 1), (1, 1)])
def test_the_right_button_and_shift_turn_the_light_alone(controls, button, modifiers):
    orbit, rotation = state(controls)
    drag(controls, 60, 20, button, modifiers)
    assert controls.session.orbit == orbit
    assert not torch.equal(controls.session.rotation, rotation)


def test_a_drag_over_the_height_of_the_window_is_half_a_turn(controls):
    one, other = state(controls)[0], None
    drag(controls, 300, 0, steps=300)
    other = controls.session.orbit
    # The first pixels may be a click, and are lost.
    assert abs(abs(other.yaw - one.yaw) - torch.pi) < 6 * torch.pi / 300


def test_moving_without_a_button_turns_nothing(controls):
    before = state(controls)
    controls.take(Event("move", x=10.0, y=10.0))
    controls.take(Event("move", x=300.0, y=200.0))
    assert state(controls)[0] == before[0]
    assert torch.equal(state(controls)[1], before[1])


def test_a_click_picks_and_turns_nothing(controls):
    before = controls.session.orbit
    controls.take(Event("move", x=200.0, y=150.0))
    controls.take(Event("button", 0, 1))
    controls.take(Event("move", x=201.0, y=151.0))
    controls.take(Event("button", 0, 0))
    assert controls.session.picked is not None
    assert controls.lines[-1].startswith(f"vertex {controls.session.picked}:")
    assert controls.session.orbit == before


def test_neither_a_drag_nor_a_right_click_picks(controls):
    drag(controls, 60, 20)
    drag(controls, 0, 0, button=1)
    assert controls.session.picked is None
    assert controls.lines == []


def test_the_wheel_goes_nearer(controls):
    before = controls.session.orbit.distance
    controls.take(Event("scroll", y=2.0))
    assert controls.session.orbit.distance < before

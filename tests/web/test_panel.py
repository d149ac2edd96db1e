"""Can the panel be used by keys, on a phone, and by who wants nothing to move?"""

import numpy as np
import pytest
from web.conftest import Visit, at

LEAST_TARGET = 24


@pytest.fixture(scope="module")
def address(pages):
    with at(pages.parent) as root:
        yield f"{root}/some%20where/plane/"


@pytest.fixture
def tab(visit, address):
    return visit().open(address)


@pytest.fixture(params=[(360, 740), (740, 360)], ids=["upright", "lying"])
def phone(browser, address, request):
    width, height = request.param
    context = browser.new_context(viewport={"width": width, "height": height}, has_touch=True, is_mobile=True)
    yield Visit(context.new_page()).open(address)
    context.close()


def test_arrow_keys_go_through_lights_and_shadings(tab):
    keyboard = tab.page.keyboard
    tab.page.focus("#environments input:checked")
    for key, number in (("ArrowRight", 1), ("ArrowDown", 2), ("ArrowLeft", 1), ("ArrowUp", 0), ("ArrowUp", 5)):
        keyboard.press(key)
        assert tab.ask("return [it.environment, document.activeElement.value];") == [number, str(number)]
    tab.page.focus("#modes input:checked")
    keyboard.press("ArrowDown")
    assert tab.ask("return [it.mode, document.activeElement.value];") == ["compressed", "compressed"]
    # One stop of the Tab key a group.
    keyboard.press("Shift+Tab")
    assert tab.ask("return document.activeElement.id;") == "tone"


def test_what_has_the_focus_is_seen(tab):
    seen = tab.ask("""
        const outline = (element) => getComputedStyle(element).outlineStyle;
        const found = {};
        for (const id of ["canvas", "file", "turning", "order", "window"]) {
          const element = document.getElementById(id);
          element.focus({ focusVisible: true });
          found[id] = [outline(element), outline(element.closest("label") ?? element)];
        }
        const radio = document.querySelector("#environments input:checked");
        radio.focus({ focusVisible: true });
        found.radio = [outline(radio.parentElement)];
        return found;
    """)
    for name, styles in seen.items():
        assert any(style in ("solid", "auto") for style in styles), name


def test_targets_on_a_phone_are_large_enough_for_a_finger_and_nothing_is_cut_off(phone):
    small, wide = phone.ask("""
        const small = [];
        for (const each of document.querySelectorAll("aside :is(input, select, label, a)")) {
          const { width, height } = each.getBoundingClientRect();
          if (Math.min(width, height) < 24) small.push(`${each.tagName} ${each.id} ${width} x ${height}`);
        }
        const aside = document.querySelector("aside");
        const shown = aside.getBoundingClientRect();
        return [small, [aside.scrollWidth - aside.clientWidth, document.documentElement.scrollWidth - innerWidth,
          shown.right - innerWidth, 100 - shown.height]];
    """)
    assert small == []
    assert max(wide) <= 0


def test_the_light_turns_by_itself_until_it_is_told_not_to(tab):
    still = tab.ask("return it.rotation;")
    tab.page.check("#turning")
    tab.page.wait_for_function("() => window.torchprt.rotation[2] > 0.02")
    turned = tab.ask("return it.rotation;")
    # About +y alone.
    assert np.allclose(np.reshape(turned, (3, 3)) @ [0, 1, 0], [0, 1, 0], atol=1e-9)
    assert not np.allclose(turned, still)
    tab.page.focus("#canvas")
    tab.page.keyboard.press("Space")
    assert not tab.page.is_checked("#turning")
    tab.ask("await it.running;")
    stopped = tab.ask("return it.rotation;")
    tab.page.wait_for_timeout(200)
    assert tab.ask("return it.rotation;") == stopped


def test_nothing_moves_before_it_is_asked_to_and_it_stops_where_motion_is_not_wanted(tab):
    assert not tab.page.is_checked("#turning")
    tab.page.check("#turning")
    tab.page.emulate_media(reduced_motion="reduce")
    tab.page.wait_for_function("() => !window.torchprt.turning")
    assert not tab.page.is_checked("#turning")


def test_a_tone_map_of_ones_own_is_drawn(tab):
    assert tab.page.input_value("#tone") == "neutral"
    before = tab.page.locator("main").screenshot()
    tab.page.select_option("#tone", "agx")
    tab.settled()
    assert tab.page.locator("main").screenshot() != before

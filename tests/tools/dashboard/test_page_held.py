"""Driving by hand: whatever may hide the end of a press ends it, and it never drives again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.quick_chassis import quick_config
from tests.tools.dashboard.browsers import (
    SharedBrowser,
    SimulatedPage,
    actions,
    element,
    eventually,
    hold_stick,
    is_driving,
    is_stopped_by_zero,
    open_page,
    press,
    script,
    set_screen,
    show,
    text,
)
from tests.tools.dashboard.pages import program
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator import SimulatorThread

pytestmark = pytest.mark.timeout(300)
_HELD = "store.held.value !== null"


def key(driver: Any, kind: str, name: str, code: str | None = None, **more: Any) -> None:
    """Press a key without letting go of the others: `rawKeyDown` or `keyUp`."""
    numbers = {"ArrowUp": 38, "ArrowLeft": 37, " ": 32, "Tab": 9, "Meta": 91}
    code = code or {" ": "Space", "Meta": "MetaLeft"}.get(name, name)
    event = {"type": kind, "key": name, "code": code, "windowsVirtualKeyCode": numbers.get(name, 0)}
    driver.execute_cdp_cmd("Input.dispatchKeyEvent", {**event, **more})


def mouse(driver: Any, kind: str, x: float, y: float, button: str, buttons: int) -> None:
    event = {"type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1}
    driver.execute_cdp_cmd("Input.dispatchMouseEvent", event)


def middle(driver: Any, selector: str) -> tuple[float, float]:
    box = element(driver, selector).rect
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def hold_key(driver: Any, drives: Callable[[], bool]) -> None:
    """Hold an arrow key until the robot drives.

    On a busy machine, the connection to the dashboard may be too slow for a moment.
    """

    def is_held() -> bool:
        if not script(driver, _HELD):
            key(driver, "keyUp", "ArrowUp")
            key(driver, "rawKeyDown", "ArrowUp")
        return drives()

    eventually(is_held, "the robot to drive")


def _switch_with_the_pointer(driver: Any) -> None:
    element(driver, "#keyboard").click()
    assert not script(driver, "store.keyboard.value")


def _switch_with_space(driver: Any) -> None:
    assert script(driver, "document.activeElement.id") == "keyboard"
    key(driver, "rawKeyDown", " ")
    key(driver, "keyUp", " ")
    assert not script(driver, "store.keyboard.value")


def _open_a_list(driver: Any) -> None:
    mouse(driver, "mousePressed", *middle(driver, "#theme"), "left", 1)
    mouse(driver, "mouseReleased", *middle(driver, "#theme"), "left", 0)


def _open_a_list_with_the_keyboard(driver: Any) -> None:
    script(driver, "document.querySelector('#theme').focus()")


def _begin_a_shortcut(driver: Any) -> None:
    key(driver, "rawKeyDown", "Meta")  # on a Mac, the keys that are let go meanwhile are not told


def _release_control(driver: Any) -> None:
    script(driver, "document.querySelector('#release').click()")


@pytest.mark.parametrize(
    "end",
    [
        _switch_with_the_pointer,
        _switch_with_space,
        _open_a_list,
        _open_a_list_with_the_keyboard,
        _begin_a_shortcut,
        _release_control,
    ],
)
def test_a_held_key_drives_no_more_after(
    robot: SimulatedPage, browser: Any, end: Callable[[Any], None]
) -> None:
    set_screen(browser, 1440, 900)
    show(browser, "setup")
    script(browser, "document.querySelector('#theme').scrollIntoView()")
    press(browser, "#keyboard")
    hold_key(browser, lambda: is_driving(robot))
    end(browser)
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    if end is _release_control:
        eventually(lambda: text(browser, "#owner") == "Nobody has control", "the release")
    # the key is still down, and repeats; the browser may have kept its end for itself
    key(browser, "rawKeyDown", "ArrowUp", autoRepeat=True)
    assert not script(browser, _HELD)
    key(browser, "keyUp", "ArrowUp")
    key(browser, "keyUp", "Meta")
    assert is_stopped_by_zero(robot)


def test_a_key_is_known_by_its_place_whatever_it_means_when_it_is_let_go(
    robot: SimulatedPage, browser: Any
) -> None:
    press(browser, "#keyboard")
    key(browser, "rawKeyDown", "ArrowUp", "Numpad8")
    key(browser, "keyUp", "8", "Numpad8")  # with Shift, its end has another name
    assert not script(browser, _HELD)
    hold_key(browser, lambda: is_driving(robot))
    key(browser, "keyUp", "8", "ArrowUp")
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    assert not script(browser, _HELD)


@pytest.mark.parametrize("end", ["another button", "lost release", "another place", "Tab"])
def test_the_held_stick_drives_no_more_after(robot: SimulatedPage, browser: Any, end: str) -> None:
    hold_stick(browser, robot)
    x, y = middle(browser, "#stick")
    if end == "another button":
        mouse(browser, "mousePressed", x, y - 50, "right", 3)
    elif end == "lost release":
        mouse(browser, "mouseMoved", x, y - 40, "none", 0)
    elif end == "another place":  # by another pointer
        script(
            browser,
            "document.querySelector('#answer').dispatchEvent(new PointerEvent('pointerdown',"
            " {pointerId: 7, bubbles: true}))",
        )
    else:
        key(browser, "rawKeyDown", "Tab")
        key(browser, "keyUp", "Tab")
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    # the pointer is still down
    mouse(browser, "mouseMoved", x, y - 45, "left", 1)
    assert not script(browser, _HELD)
    if end == "another button":
        mouse(browser, "mouseReleased", x, y - 45, "left", 2)
        mouse(browser, "mouseMoved", x, y - 50, "right", 2)
        assert not script(browser, _HELD)
        mouse(browser, "mouseReleased", x, y - 50, "right", 0)
    hold_stick(browser, robot)  # another press drives
    actions(browser).release().perform()


def test_another_robot_is_not_driven_by_the_keys_of_the_former(
    shared_browser: SharedBrowser,
) -> None:
    with (
        SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=7)) as first,
        SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=8)) as second,
        program(first, second) as (_, url),
        shared_browser.window() as browser,
    ):
        open_page(browser, url)
        press(browser, "#keyboard")
        hold_key(browser, lambda: first.state.velocity.forward > 0.05)
        element(browser, "#robots option[value='1']").click()
        eventually(lambda: first.last(full_name(Twist)) == Twist(), "the first robot to stop")
        eventually(lambda: script(browser, "document.title").startswith("8 "), "the other robot")
        assert not script(browser, "store.keyboard.value")
        for kind in ("keyUp", "rawKeyDown", "keyUp"):
            script(browser, "document.activeElement.blur()")
            key(browser, kind, "ArrowUp")
            assert not script(browser, _HELD)
        assert second.counts[full_name(Twist)] == 0


@pytest.mark.parametrize("end", ["mark", "pose", "hidden"])
def test_keys_whose_switch_goes_out_of_sight_are_off(
    robot: SimulatedPage, browser: Any, end: str
) -> None:
    show(browser, "go")
    press(browser, "#keyboard")
    assert script(browser, "store.keyboard.value")
    if end == "mark":
        press(browser, "#marks li:nth-child(2) button")
    elif end == "pose":
        show(browser, "map")
        press(browser, "#set-pose")
    else:
        browser.switch_to.new_window("tab")
        browser.switch_to.window(browser.window_handles[1])
    eventually(lambda: not script(browser, "store.keyboard.value"), "the keys to be off")
    eventually(lambda: "arrow keys drive no more" in text(browser, "#answer"), "why")
    key(browser, "rawKeyDown", "ArrowUp")
    assert not script(browser, _HELD)
    key(browser, "keyUp", "ArrowUp")
    assert robot.call(lambda simulator: simulator.counts[full_name(Twist)]) == 0

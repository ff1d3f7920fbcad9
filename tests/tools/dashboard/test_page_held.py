"""Driving by hand: whatever may hide the end of a press ends it, and it never drives again."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable
from typing import Any

import pytest

from tests.tools.dashboard.browsers import Browser, SimulatedPage, chromium, eventually
from tests.tools.dashboard.conftest import Serve
from tests.tools.dashboard.pages import is_driving, is_stopped_by_zero, velocities
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

pytestmark = pytest.mark.timeout(300)
_HELD = "store.held.value !== null"


def key(browser: Browser, kind: str, name: str, code: str | None = None, **more: Any) -> None:
    """Press a key without letting go of the others: `rawKeyDown` or `keyUp`."""
    numbers = {"ArrowUp": 38, "ArrowLeft": 37, " ": 32, "Tab": 9, "Meta": 91}
    code = code or {" ": "Space", "Meta": "MetaLeft"}.get(name, name)
    event = {"type": kind, "key": name, "code": code, "windowsVirtualKeyCode": numbers.get(name, 0)}
    browser.send("Input.dispatchKeyEvent", **event, **more)


def mouse(browser: Browser, kind: str, x: float, y: float, button: str, buttons: int) -> None:
    event = {"type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1}
    browser.send("Input.dispatchMouseEvent", **event)


def hold_key(browser: Browser, drives: Callable[[], bool]) -> None:
    """Hold an arrow key until the robot drives.

    On a busy machine, the connection to the dashboard may be too slow for a moment.
    """

    def is_held() -> bool:
        if not browser.script(_HELD):
            key(browser, "keyUp", "ArrowUp")
            key(browser, "rawKeyDown", "ArrowUp")
        return drives()

    eventually(is_held, "the robot to drive")


_ENDS_OF_KEYS: dict[str, Callable[[Browser], None]] = {
    "the pointer on the switch": lambda browser: browser.element("#keyboard").click(),
    "the space key on the switch": lambda browser: press_space(browser),
    "the focus goes to a list": lambda browser: browser.script(
        "document.querySelector('#theme').focus()"
    ),
    # on a Mac, the keys that are let go during a shortcut are not told
    "a shortcut begins": lambda browser: key(browser, "rawKeyDown", "Meta"),
    "the control is released": lambda browser: browser.script(
        "document.querySelector('#release').click()"
    ),
    # the last one, because the list would take the next press
    "a list is opened": lambda browser: click(browser, *browser.middle("#theme")),
}


def press_space(browser: Browser) -> None:
    assert browser.script("document.activeElement.id") == "keyboard"
    key(browser, "rawKeyDown", " ")
    key(browser, "keyUp", " ")


def click(browser: Browser, x: float, y: float) -> None:
    mouse(browser, "mousePressed", x, y, "left", 1)
    mouse(browser, "mouseReleased", x, y, "left", 0)


def test_a_held_key_drives_no_more_after(robot: SimulatedPage, browser: Browser) -> None:
    browser.set_screen(1440, 900)
    browser.show("setup")
    browser.script("document.querySelector('#theme').scrollIntoView()")
    for what, end in _ENDS_OF_KEYS.items():
        if browser.script("store.keyboard.value"):
            browser.press("#keyboard")
        browser.press("#keyboard")
        hold_key(browser, lambda: is_driving(robot))
        end(browser)
        eventually(lambda: is_stopped_by_zero(robot), f"the robot to stop: {what}")
        if what.endswith("the switch"):
            assert not browser.script("store.keyboard.value")
        elif what == "the control is released":
            eventually(lambda: browser.text("#owner") == "Nobody has control", "the release")
        # the key is still down, and repeats; the browser may have kept its end for itself
        key(browser, "rawKeyDown", "ArrowUp", autoRepeat=True)
        assert not browser.script(_HELD), what
        key(browser, "keyUp", "ArrowUp")
        key(browser, "keyUp", "Meta")
        assert is_stopped_by_zero(robot), what
        browser.script("document.activeElement.blur()")


def test_a_key_is_known_by_its_place_whatever_it_means_when_it_is_let_go(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.press("#keyboard")
    key(browser, "rawKeyDown", "ArrowUp", "Numpad8")
    key(browser, "keyUp", "8", "Numpad8")  # with Shift, its end has another name
    assert not browser.script(_HELD)
    hold_key(browser, lambda: is_driving(robot))
    # another size of the window does not end it
    browser.set_screen(1300, 800)
    eventually(lambda: browser.script("innerWidth") == 1300, "the other size")
    hold_key(browser, lambda: is_driving(robot))
    assert "resized" not in browser.text("#answer")
    key(browser, "keyUp", "8", "ArrowUp")
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    assert not browser.script(_HELD)


def test_the_held_stick_drives_no_more_after(robot: SimulatedPage, browser: Browser) -> None:
    x, y = browser.middle("#stick")
    for end in ("another button", "lost release", "another place", "Tab"):
        browser.drive(robot)
        if end == "another button":
            mouse(browser, "mousePressed", x, y - 50, "right", 3)
        elif end == "lost release":
            mouse(browser, "mouseMoved", x, y - 40, "none", 0)
        elif end == "another place":  # by another pointer
            browser.script(
                "document.querySelector('#answer').dispatchEvent(new PointerEvent('pointerdown',"
                " {pointerId: 7, bubbles: true}))",
            )
        else:
            key(browser, "rawKeyDown", "Tab")
            key(browser, "keyUp", "Tab")
        eventually(lambda: is_stopped_by_zero(robot), f"the robot to stop: {end}")
        # the pointer is still down
        mouse(browser, "mouseMoved", x, y - 45, "left", 1)
        assert not browser.script(_HELD), end
        if end == "another button":
            mouse(browser, "mouseReleased", x, y - 45, "left", 2)
            mouse(browser, "mouseMoved", x, y - 50, "right", 2)
            assert not browser.script(_HELD)
            mouse(browser, "mouseReleased", x, y - 50, "right", 0)
        browser.drive(robot)  # another press drives
        browser.release()
        eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")


def test_another_robot_is_not_driven_by_the_keys_of_the_former(
    serve: Serve, window: Browser
) -> None:
    served = serve({"robot_id": 7}, {"robot_id": 8})
    first, second = served.robots
    window.open(served.url)
    window.press("#keyboard")
    hold_key(window, lambda: first.state.velocity.forward > 0.05)
    window.element("#robots option[value='1']").click()
    eventually(lambda: first.last(full_name(Twist)) == Twist(), "the first robot to stop")
    eventually(lambda: window.script("document.title").startswith("8 "), "the other robot")
    assert not window.script("store.keyboard.value")
    for kind in ("keyUp", "rawKeyDown", "keyUp"):
        window.script("document.activeElement.blur()")
        key(window, kind, "ArrowUp")
        assert not window.script(_HELD)
    assert second.counts[full_name(Twist)] == 0


def test_what_is_pressed_without_a_connection_drives_nothing_later(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.press("#keyboard")
    for what in ("stick", "key"):
        browser.script("(connection.connect = () => connection.socket, connection.socket.close())")
        eventually(lambda: browser.script("store.problem.value"), "the loss")
        if what == "key":
            key(browser, "rawKeyDown", "ArrowUp")
        else:
            browser.push_stick()
        assert not browser.script(_HELD)
        browser.script("(delete connection.connect, connection.connect(), 0)")
        eventually(lambda: browser.script("!store.outdated.value"), "the connection")
        clock = browser.script("connection.clock")
        eventually(lambda: browser.script("connection.clock") > clock + 300, "some time")  # noqa: B023
        if what == "key":
            key(browser, "keyUp", "ArrowUp")
        else:
            browser.release()
    assert robot.counts[full_name(Twist)] == 0
    browser.drive(robot)
    browser.release()


def check_keys_are_off(robot: SimulatedPage, browser: Browser) -> None:
    """Wait until the arrow keys are off, and check that they do not drive."""
    eventually(lambda: not browser.script("store.keyboard.value"), "the keys to be off")
    eventually(lambda: "arrow keys no longer drive" in browser.text("#answer"), "why")
    key(browser, "rawKeyDown", "ArrowUp")
    assert not browser.script(_HELD)
    key(browser, "keyUp", "ArrowUp")
    assert robot.counts[full_name(Twist)] == 0


def test_keys_whose_switch_goes_out_of_sight_are_off(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.press("#keyboard")
    assert browser.script("store.keyboard.value")
    browser.press("#marks li:nth-child(2) button")
    check_keys_are_off(robot, browser)
    browser.press("#dismiss")
    browser.press("#keyboard")
    browser.script("store.answer.value = null")
    browser.show("map")
    browser.press("#set-pose")
    check_keys_are_off(robot, browser)


def test_a_page_that_is_hidden_or_killed_drives_no_more(robot: SimulatedPage) -> None:
    running = contextlib.ExitStack()
    try:
        browser = running.enter_context(chromium(with_tabs=True))
        driver = browser.driver
        browser.open(robot.url)
        shown = driver.current_window_handle
        browser.press("#keyboard")
        driver.switch_to.new_window("tab")
        driver.switch_to.window(shown)
        check_keys_are_off(robot, browser)
        driver.switch_to.window(driver.window_handles[1])
        driver.close()
        driver.switch_to.window(shown)
        browser.drive(robot)
        driver.switch_to.new_window("tab")
        eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
        driver.close()
        driver.switch_to.window(shown)
        browser.release()
        browser.drive(robot)
        os.kill(driver.capabilities["goog:processID"], signal.SIGKILL)
        eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    finally:
        with contextlib.suppress(Exception):  # the end of the browser fails after the kill
            running.close()


def test_a_slow_stick_drives_at_a_third_also_after_a_reload(
    robot: SimulatedPage, browser: Browser
) -> None:
    def fastest() -> float:
        """Return the greatest velocity since the last call."""
        sent = velocities(robot)[seen[0] :]
        seen[0] += len(sent)
        return max((each.linear for each in sent), default=0.0)

    seen = [0]
    slow = "document.querySelector('#slow')"
    for reload in (False, True):
        if reload:
            browser.driver.refresh()
            browser.wait_for_map()
        else:
            browser.press("#slow")
        assert browser.script(f"{slow}.ariaPressed") == "true"
        eventually(lambda: "up to 0.17 m/s" in browser.text("#now"), "the hint")
        browser.drive(robot)
        assert browser.text("#now .speed").endswith(" m/s")
        assert 0.0 < fastest() <= 0.17
        browser.release()
    browser.press("#keyboard")
    hold_key(browser, lambda: is_driving(robot))
    assert 0.15 < fastest() <= 0.17
    browser.script(f"{slow}.click()")  # as an assistive technology does
    assert browser.script("store.held.value === null"), "no press gets faster"
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    assert fastest() <= 0.17
    key(browser, "keyUp", "ArrowUp")
    assert browser.script(f"{slow}.ariaPressed") == "false"
    browser.drive(robot)
    eventually(lambda: fastest() > 0.3, "the full speed")
    browser.release()

"""The places of the stick and of STOP, at the sizes of phones, tablets and computers."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.quick_chassis import quick_config
from tests.tools.dashboard.browsers import (
    SharedBrowser,
    element,
    eventually,
    is_enabled,
    press,
    script,
    set_screen,
    text,
    touch,
    wait_for_map,
)
from tests.tools.dashboard.pages import page, program
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator import SimulatorThread

pytestmark = pytest.mark.timeout(300)
_SCREENS = [(360, 640), (390, 844), (667, 375), (768, 1024), (844, 390), (1024, 768), (1440, 900)]
_SMALL = [(320, 568), (640, 400), (427, 267)]
"""An old phone, and a window of 1280 x 800 pixels at 200 % and 300 %."""
_STICK_RADIUS = 68.0
"""Radius of the stick on a phone, in pixels."""

_OBSERVE = """
globalThis.boxes = {"#stop": new Set(), "#stick": new Set()};
globalThis.shifts = [];
new PerformanceObserver((list) => {
  for (const {sources} of list.getEntries()) {
    for (const {node, previousRect, currentRect} of sources) {
      for (const selector in boxes) {
        if (!node?.contains?.(document.querySelector(selector))) continue;
        shifts.push(`${selector} by ${node.nodeName} ${node.id}: ` +
          `${JSON.stringify(previousRect)} ${JSON.stringify(currentRect)}`);
      }
    }
  }
}).observe({type: "layout-shift", buffered: true});
(function look() {
  for (const [selector, seen] of Object.entries(boxes)) {
    const box = document.querySelector(selector)?.getBoundingClientRect();
    if (box?.width) seen.add([box.x, box.y, box.width, box.height].join(" "));
  }
  requestAnimationFrame(look);
})();
"""
"""Collects the boxes of the stick and STOP in all frames, and the shifts of the layout."""

_COVERED = """["#stop", "#stick", ".line"].flatMap((selector) => {
  const target = document.querySelector(selector);
  const {x, y, width, height} = target.getBoundingClientRect();
  return [[.5, .5], [.5, .06], [.5, .94], [.06, .5], [.94, .5]]
    .map(([right, down]) => document.elementFromPoint(x + right * width, y + down * height))
    .filter((found) => !target.contains(found))
    .map((found) => `${selector} is covered by ${found?.outerHTML}`);
})
"""


_CUT = """[
  ...[...document.querySelectorAll(".chip :is(span, small), #alarm span, #stop small, .kind")]
    .filter(({scrollWidth, clientWidth, scrollHeight, clientHeight}) =>
      scrollWidth > clientWidth || scrollHeight > clientHeight + 2),
  ...[...document.querySelectorAll("#direction")].filter((each) => {
    const context = new OffscreenCanvas(1, 1).getContext("2d");
    const {fontSize, fontFamily} = getComputedStyle(each);
    context.font = `${fontSize} ${fontFamily}`;
    return context.measureText(each.selectedOptions[0].text).width > each.clientWidth - 24;
  }),
].filter((each) => each.checkVisibility() && !each.matches(".hidden")).map((each) => each.outerHTML)
"""
"""Lists what cannot be read in full of the bar, the alarm and the kind of a task."""


class _Served:
    """Simulated robots, and a program that serves their page."""

    def __init__(self, robots: list[SimulatorThread], process: Any, url: str) -> None:
        self.robots = robots
        self._process = process
        self.url = url

    @contextmanager
    def silent(self) -> Iterator[None]:
        """Stop the program for a while; the connections stay open."""
        os.kill(self._process.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self._process.pid, signal.SIGCONT)

    @contextmanager
    def commanded_by_another(self) -> Iterator[None]:
        """Let another page have the control."""
        loop = asyncio.new_event_loop()
        other = page(self.url)
        viewer = loop.run_until_complete(other.__aenter__())
        try:
            loop.run_until_complete(viewer.command("pause"))
            yield
        finally:
            loop.run_until_complete(other.__aexit__(None, None, None))
            loop.close()


@contextmanager
def served(number_of_robots: int) -> Iterator[_Served]:
    """Serve a page for simulated robots."""
    with contextlib.ExitStack() as running:
        robots = [
            running.enter_context(
                SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=number))
            )
            for number in range(30001, 30001 + number_of_robots)
        ]
        process, url = running.enter_context(program(*robots))
        yield _Served(robots, process, url)


@contextmanager
def opened(shared_browser: SharedBrowser, url: str, width: int, height: int) -> Iterator[Any]:
    """Open the page on a screen of this size, observed by `_OBSERVE` from the beginning."""
    with shared_browser.window() as browser:
        set_screen(browser, width, height, mobile=width < 1000)
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _OBSERVE})
        browser.get(url)
        eventually(lambda: script(browser, "[innerWidth, innerHeight]") == [width, height], "size")
        wait_for_map(browser)
        eventually(lambda: element(browser, "#stop").is_displayed(), "STOP")
        yield browser


def hold_stick(browser: Any, x: float, y: float, beside: float = 0.0) -> tuple[float, float]:
    """Press the stick with a finger and move it; return where the finger is then.

    End the touch and call it again if the page has let go: on a busy machine, the connection may
    be too slow for a moment.

    Args:
        browser: the browser.
        x: how far to move to the right, in pixels.
        y: how far to move down, in pixels.
        beside: how far below the middle of the stick to press, in pixels.
    """
    across, down = middle(browser, "#stick")
    touch(browser, "touchStart", (across, down + beside))
    end = across + x, down + beside + y
    touch(browser, "touchMove", end)
    return end


def middle(browser: Any, selector: str) -> tuple[float, float]:
    box = element(browser, selector).rect
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.mark.parametrize(("width", "height"), _SCREENS + _SMALL)
def test_nothing_lies_over_anything_that_is_pressed(
    shared_browser: SharedBrowser, width: int, height: int
) -> None:
    with served(1) as page_, opened(shared_browser, page_.url, width, height) as browser:
        assert script(browser, "[document.body.scrollWidth, document.body.scrollHeight]") == [
            width,
            height,
        ]
        parts = ("#stop", "#stick", ".tools", "#map", ".line", ".tabs", ".doing")
        boxes = {selector: element(browser, selector).rect for selector in parts}
        for one, other in itertools.combinations(parts, 2):
            assert are_apart(boxes[one], boxes[other]), (one, other)
        if (width, height) != (427, 267):
            scrolls = "(({scrollHeight, clientHeight}) => scrollHeight > clientHeight)"
            assert not script(browser, f"{scrolls}(document.querySelector('.tools'))")
        # with the sheet open, the whole map is still shown beside it, if there is room
        if (is_small := width < 1000 or height < 600) and (width, height) != (427, 267):
            press(browser, "#tab-go")
        press(browser, "#fit")
        panel, canvas = element(browser, ".panel").rect, boxes["#map"]
        assert are_apart(panel, boxes["#stick"])
        corners = script(
            browser,
            "mapCanvas.corners(mapCanvas.area).map(({x, y}) => mapCanvas.view.toScreen(x, y))"
            ".map(({x, y}) => [x, y])",
        )
        over = {"x": canvas["x"], "y": canvas["y"], "width": 0.0, "height": 0.0}
        for x, y in corners:
            at = {**over, "x": canvas["x"] + x, "y": canvas["y"] + y}
            assert are_apart(at, panel) or not is_small, (at, panel)
            assert 0 <= x <= canvas["width"], (x, y)
            assert 0 <= y <= canvas["height"], (x, y)


_MAP_BOX = """(() => {
  const over = document.querySelector("#map").getBoundingClientRect();
  const corners = mapCanvas.corners(mapCanvas.area).map(({x, y}) => mapCanvas.view.toScreen(x, y));
  const [across, down] = [corners.map(({x}) => x + over.x), corners.map(({y}) => y + over.y)];
  const [x, y] = [Math.min(...across), Math.min(...down)];
  return {x, y, width: Math.max(...across) - x, height: Math.max(...down) - y};
})()"""
"""The box of the map's picture on the screen."""


def test_a_whole_map_is_fitted_beside_what_lies_over_it_and_not_moved_by_notices(
    shared_browser: SharedBrowser,
) -> None:
    def is_beside(selector: str) -> bool:
        box = script(browser, f"document.querySelector('{selector}').getBoundingClientRect()")
        return box["height"] > 0 and are_apart(script(browser, _MAP_BOX), box)

    with served(1) as page_, opened(shared_browser, page_.url, 390, 844) as browser:
        press(browser, "#tab-go")
        eventually(lambda: is_beside(".panel"), "the map beside the sheet")
        before = script(browser, _MAP_BOX)
        page_.robots[0].set_emergency_stop(True)
        page_.robots[0].inject("lost_localisation")
        eventually(lambda: script(browser, "store.robot.value.objections.length") == 2, "both")
        assert "1 more" not in text(browser, "#notice"), "one line"
        eventually(lambda: script(browser, "mapCanvas.covered.top > 0"), "its size")
        assert script(browser, _MAP_BOX) == before
        press(browser, "#fit")
        assert is_beside("#notice")
        assert is_beside(".panel")
        assert script(browser, _MAP_BOX)["height"] > 100
        press(browser, ".panel [aria-label=Close]")
        eventually(lambda: is_beside("#notice"), "the map beside the banner")
        page_.robots[0].clear_faults()
        page_.robots[0].set_emergency_stop(True)
        for width, height in ((390, 844), (1440, 900)) * 3:
            set_screen(browser, width, height, mobile=width < 1000)
            browser.refresh()
            wait_for_map(browser)
            eventually(lambda: is_beside("#notice"), "the map beside the banner after a load")
        set_screen(browser, 390, 844, mobile=True)
        eventually(lambda: is_beside("#notice"), "the map on the phone")
        press(browser, "#zoom-in")
        scale = script(browser, "mapCanvas.view.scale")
        press(browser, "#tab-go")
        eventually(lambda: script(browser, "mapCanvas.view.inset.bottom > 0"), "the sheet")
        assert script(browser, "mapCanvas.view.scale") == scale


@pytest.mark.parametrize("width", [1440, 390])
def test_the_bar_stands_still_when_its_numbers_get_more_digits(
    shared_browser: SharedBrowser, width: int
) -> None:
    change = """(({delay, power}) => {
        store.link.value = {...store.link.value, delay};
        const {battery} = store.robot.value;
        store.robot.value = {...store.robot.value, battery: {...battery, power}};
        return new Promise((resolve) => setTimeout(() => requestAnimationFrame(() => resolve(
          [...document.querySelectorAll(".chip")].map((each) => each.getBoundingClientRect().x)
        ))));
      })(%s)
    """
    with served(1) as page_, opened(shared_browser, page_.url, width, 900) as browser:
        numbers = ("{delay: 4, power: 7}", "{delay: 45, power: 70}", "{delay: 4567, power: 100}")
        places = [script(browser, change % each) for each in numbers]
        assert len(places[0]) == 4
        assert places[0] == places[1] == places[2]


def test_an_unconfirmed_stop_and_a_lost_link_are_counted_as_alarms(
    shared_browser: SharedBrowser,
) -> None:
    with served(1) as page_, opened(shared_browser, page_.url, 1440, 900) as browser:
        assert text(browser, "button.chip") == "0 alarms"
        page_.robots[0].stop_listening()
        eventually(lambda: text(browser, "button.chip") == "1 alarm", "the lost link")
        press(browser, "#stop")
        eventually(lambda: text(browser, "#alarm"), "the unconfirmed stop")
        assert text(browser, "button.chip") == "2 alarms"
        assert "bad" in element(browser, "button.chip").get_attribute("class")


_SMALL_TARGETS = """[...document.querySelectorAll("button, select, input, summary, [role=tab]")]
  .map((each) => [each, (each.closest("label") ?? each).getBoundingClientRect()])
  .filter(([, box]) => box.width && (box.height < 43.5 || box.width < 43.5))
  .map(([each, box]) => `${each.outerHTML}: ${box.width} x ${box.height}`)
"""
"""Lists what is pressed and is smaller than 44 pixels."""


@pytest.mark.parametrize(("width", "height"), [(360, 640), (1440, 900)])
def test_whatever_is_pressed_has_44_pixels(
    shared_browser: SharedBrowser, width: int, height: int
) -> None:
    with served(2) as page_, opened(shared_browser, page_.url, width, height) as browser:
        for tab in ("fleet", "go", "tasks", "state", "map", "setup"):
            press(browser, f"#tab-{tab}")
            assert script(browser, _SMALL_TARGETS) == [], tab
        press(browser, "#tab-setup") if width < 1000 else None
        press(browser, "#layers")
        assert script(browser, _SMALL_TARGETS) == []


def are_apart(one: dict[str, float], other: dict[str, float]) -> bool:
    """Return True if two boxes do not overlap."""
    return any(
        first[start] + first[size] <= second[start]
        for first, second in ((one, other), (other, one))
        for start, size in (("x", "width"), ("y", "height"))
    )


@pytest.mark.parametrize(("width", "height"), _SCREENS)
def test_nothing_moves_or_covers_the_stick_and_stop(
    shared_browser: SharedBrowser, width: int, height: int
) -> None:
    number = 1 + _SCREENS.index((width, height)) % 2
    with (
        served(number) as served_,
        opened(shared_browser, served_.url, width, height) as browser,
    ):
        first = served_.robots[0]

        def check(state: str) -> None:
            assert script(browser, _COVERED) == [], state
            assert script(browser, _CUT) == [], state
            for selector in ("#stop", "#stick"):
                boxes = script(browser, f"[...boxes['{selector}']]")
                assert len(boxes) == 1, (state, selector, boxes)
            assert script(browser, "shifts") == [], state
            assert script(browser, "document.documentElement.scrollWidth") <= width, state

        stop = element(browser, "#stop").rect
        assert stop["height"] >= 64
        assert stop["width"] >= 98
        assert script(browser, "document.querySelector('#robots') !== null") == (number > 1)
        shown = "30001" if number > 1 else ""
        eventually(lambda: text(browser, "#stop small") == shown, "the robot that STOP stops")
        check("standing")
        with served_.commanded_by_another():
            eventually(lambda: text(browser, "#owner").startswith("Viewer "), "the other owner")
            check("control of another viewer")
        eventually(lambda: "Nobody" in text(browser, "#owner"), "the end of the other's control")

        hold_stick(browser, 30, 0)  # turns in place

        def has_control() -> bool:
            if script(browser, "store.held.value === null"):
                touch(browser, "touchEnd")
                hold_stick(browser, 30, 0)
            return text(browser, "#owner") == "You have control"

        eventually(has_control, "the control")
        assert element(browser, "#release").is_displayed()
        check("control taken")
        touch(browser, "touchEnd")
        script(
            browser,
            "store.answer.value = {ok: false, time: 0, robot: 0, text: {key: 'reason.said',"
            " values: {text: 'a long reason '.repeat(30)}}}",
        )
        check("a long answer")
        element(browser, "#answer").click()
        shown = "{scrollWidth, clientWidth, scrollHeight, clientHeight}"
        fits = "scrollWidth <= clientWidth && scrollHeight <= clientHeight"
        assert script(browser, f"(({shown}) => {fits})(document.querySelector('#answer'))")
        script(browser, "document.activeElement.blur()")
        press(browser, "#tab-go")
        press(browser, "#marks button")
        eventually(lambda: is_enabled(browser, "#go"), "the preview")
        check("a preview")
        element(browser, "#kind option[value='carry 0']").click()
        check("a preview of carrying")
        press(browser, "#dismiss")
        if width < 1000:
            press(browser, ".panel [aria-label=Larger]")
            check("a large panel")
            press(browser, ".panel [aria-label=Close]")

        freeze = first.inject("freeze")
        eventually(lambda: "No data for " in text(browser, "#link"), "the silence of the robot")
        check("no data")
        freeze.clear()
        eventually(lambda: script(browser, "!store.outdated.value"), "the robot")
        first.stop_listening()
        eventually(lambda: "lost" in text(browser, "#link"), "the loss of the link")
        if width < 480 or height < 600:
            press(browser, "#notice summary")
        assert "last known state" in text(browser, "#notice")
        check("link lost")
        first.listen()
        eventually(lambda: script(browser, "!store.outdated.value"), "the link")
        first.set_emergency_stop(True)
        eventually(lambda: "emergency stop" in text(browser, "#notice"), "the emergency stop")
        check("emergency stop")
        first.set_emergency_stop(False)

        with served_.silent():
            eventually(lambda: "No answer from" in text(browser, "#link"), "the silence")
            check("dashboard silent")
            element(browser, "#stop").click()
            eventually(lambda: text(browser, "#alarm"), "the alarm")
            line = element(browser, "#alarm").rect
            assert line["height"] < 48, "one line"
            alarm = "document.querySelector('#alarm')"
            assert script(browser, f"{alarm}.scrollWidth <= {alarm}.clientWidth")
            assert "Press the emergency stop" in text(browser, "#alarm")
            assert "stands still" not in text(browser, "#alarm")
            check("alarm")
            element(browser, "#alarm summary").click()
            assert re.search("no answer|was lost", text(browser, "#alarm"))
            assert "stands still" in text(browser, "#alarm")
            assert element(browser, "#alarm").rect["height"] > line["height"]
            check("alarm read in full")
            element(browser, "#alarm summary").click()
            assert element(browser, "#alarm").rect == line
        eventually(lambda: not text(browser, "#alarm"), "the end of the alarm")
        check("after the alarm")


def test_long_names_of_two_robots_leave_room_in_the_bar(shared_browser: SharedBrowser) -> None:
    port_lines = """((label) => {
      const range = document.createRange();
      range.selectNodeContents([...label.childNodes].findLast((each) => each.nodeType === 3));
      return range.getClientRects().length;
    })(document.querySelector("#stop small"))"""
    with contextlib.ExitStack() as running:
        same = quick_config(port=0, tcp_port=0)
        robots = [running.enter_context(SimulatorThread(same)) for _ in range(2)]
        _, url = running.enter_context(program(*robots))
        browser = running.enter_context(opened(shared_browser, url, 1024, 768))
        eventually(lambda: "127.0.0.1" in text(browser, "#stop"), "the robot that STOP stops")
        assert script(browser, port_lines) == 1
        robots[0].stop_listening()
        eventually(lambda: "lost" in text(browser, "#link"), "the loss of the link")
        assert script(browser, _CUT) == []
        set_screen(browser, 768, 1024, mobile=True)
        eventually(lambda: script(browser, "innerWidth") == 768, "the small screen")
        assert script(browser, port_lines) == 1


@pytest.mark.parametrize("width", [360, 390])
def test_the_first_press_of_the_stick_drives_where_the_finger_goes(
    shared_browser: SharedBrowser, width: int
) -> None:
    with (
        SimulatorThread(quick_config(port=0, tcp_port=0)) as robot,
        program(robot) as (_, url),
        opened(shared_browser, url, width, 700) as browser,
    ):
        beside = 0.4 * _STICK_RADIUS  # the finger need not hit the middle
        hold_stick(browser, 0, 0, beside)
        assert script(browser, "[store.held.value.linear, store.held.value.angular]") == [0, 0]
        back = 0.25 * _STICK_RADIUS
        touch(browser, "touchEnd")
        x, y = hold_stick(browser, 0, back, beside)

        def drives_back() -> bool:
            if script(browser, "store.held.value === null"):
                touch(browser, "touchEnd")
                hold_stick(browser, 0, back, beside)
            return robot.state.velocity.forward < -0.05

        eventually(drives_back, "the robot to drive back")
        eventually(lambda: text(browser, "#owner") == "You have control", "the control")
        touch(browser, "touchMove", (x, y + 1))
        touch(browser, "touchEnd")
        eventually(lambda: robot.last(full_name(Twist)) == Twist(), "the end")
        sent = [each.message for each in robot.received if each.type == full_name(Twist)]
        limit = script(browser, "store.control.value.limits.linear")
        assert min(each.linear for each in sent) >= -0.3 * limit
        assert max(each.linear for each in sent) == 0.0
        assert {each.angular for each in sent} == {0.0}


def test_stop_works_for_a_finger_while_another_one_holds_the_stick(
    shared_browser: SharedBrowser,
) -> None:
    with (
        SimulatorThread(quick_config(port=0, tcp_port=0)) as robot,
        program(robot) as (_, url),
        opened(shared_browser, url, 390, 800) as browser,
    ):
        x, y = hold_stick(browser, 0, -40)

        def drives() -> bool:
            if script(browser, "store.held.value === null"):
                touch(browser, "touchEnd")
                hold_stick(browser, 0, -40)
            return robot.state.velocity.forward > 0.05

        eventually(drives, "the robot to drive")
        touch(browser, "touchStart", (x, y), middle(browser, "#stop"))
        eventually(lambda: "stopped" in text(browser, "#answer"), "the answer")
        assert script(browser, "store.held.value === null")
        touch(browser, "touchEnd")


_HIDDEN = """(selector) => {
  const target = document.querySelector(selector);
  const range = document.createRange();
  range.selectNodeContents(target);
  return [...range.getClientRects()].filter(({x, y, width, height}) =>
    [[.1, .5], [.5, .5], [.9, .5]].some(([right, down]) =>
      !target.contains(document.elementFromPoint(x + right * width, y + down * height)))
  ).map((each) => JSON.stringify(each));
}"""
"""Lists the lines of an element's text that something lies over."""
_UNDER_NOTICES = """(selector) => {
  const {x, y, width, height} = document.querySelector(selector).getBoundingClientRect();
  return document.elementFromPoint(x + width / 2, y + height / 2).closest(".notices") !== null;
}"""


@pytest.mark.parametrize(
    ("width", "height", "larger"),
    [
        *[(390, 844, True), (360, 640, True), (768, 1024, True)],
        *[(640, 360, False), (844, 390, False)],
    ],
)
def test_an_open_sheet_hides_neither_an_alarm_nor_what_is_wrong(
    shared_browser: SharedBrowser, width: int, height: int, larger: bool
) -> None:
    def is_seen(selector: str) -> bool:
        assert text(browser, selector)
        return bool(script(browser, f"({_HIDDEN})('{selector}').length === 0"))

    with served(1) as page_, opened(shared_browser, page_.url, width, height) as browser:
        press(browser, "#tab-tasks")
        if larger:
            press(browser, ".panel [aria-label=Larger]")
        top = "document.querySelector('#panel').getBoundingClientRect().top"
        begin = script(browser, top)
        page_.robots[0].set_emergency_stop(True)
        eventually(lambda: "emergency stop" in text(browser, "#notice"), "the banner")
        eventually(lambda: is_seen("#notice summary b"), "the banner over the sheet")
        size = f".panel [aria-label={'Smaller' if larger else 'Larger'}]"
        script(browser, "document.querySelector('.panel').scrollTo(0, 0)")
        eventually(lambda: not script(browser, f"({_UNDER_NOTICES})('{size}')"), "the handle")
        page_.robots[0].set_emergency_stop(False)
        eventually(lambda: not text(browser, "#notice"), "the end of the banner")
        eventually(lambda: script(browser, top) == begin, "the former place")
        page_.robots[0].inject("freeze")
        press(browser, "#stop")
        eventually(lambda: text(browser, "#alarm"), "the alarm")
        eventually(lambda: is_seen("#alarm summary span"), "the alarm over the sheet")
        assert script(browser, _CUT) == []
        # the number of alarms leads to them
        press(browser, "button.chip")
        eventually(lambda: "STOP is not confirmed" in text(browser, "#problems"), "the list")
        assert "No data for" in text(browser, "#problems")
        assert "not known" in text(browser, "#new-task")
        for tab in ("go", "tasks", "state", "map", "setup"):
            element(browser, f"#tab-{tab}").click()
            assert "last known state" in text(browser, ".stale"), tab
            assert script(browser, "document.querySelector('#panel.old') !== null"), tab

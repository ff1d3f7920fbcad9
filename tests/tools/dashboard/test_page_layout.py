"""The places of the stick and of STOP, at the sizes of phones, tablets and computers."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.tools.dashboard.browsers import Browser, SimulatedPage, are_apart, eventually
from tests.tools.dashboard.conftest import Serve, Served
from tests.tools.dashboard.pages import page
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

pytestmark = pytest.mark.timeout(300)
_SCREENS = [(360, 640), (390, 844), (667, 375), (768, 1024), (844, 390), (1024, 768), (1440, 900)]
_SMALL = [(320, 568), (640, 400), (512, 330), (427, 267)]
"""An old phone, and windows of 1280 x 800 and 1024 x 660 pixels at 200 % and 300 %."""
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


_SECOND = {"robot_id": 30002}
"""Options of a second robot."""


@contextmanager
def silent(served: Served) -> Iterator[None]:
    """Stop the dashboard for a while; the connections stay open."""
    with served.silent():
        yield


def open_observed(browser: Browser, url: str, width: int, height: int) -> None:
    """Open the page on a screen of this size, observed by `_OBSERVE` from the beginning."""
    browser.set_screen(width, height)
    browser.send("Page.addScriptToEvaluateOnNewDocument", source=_OBSERVE)
    browser.driver.get(url)
    eventually(lambda: browser.script("[innerWidth, innerHeight]") == [width, height], "size")
    browser.wait_for_map()
    eventually(lambda: browser.element("#stop").is_displayed(), "STOP")


def touch_stick(browser: Browser, x: float, y: float, beside: float = 0.0) -> tuple[float, float]:
    """Press the stick with a finger and move it; return where the finger is then.

    Args:
        browser: the browser.
        x: how far to move to the right, in pixels.
        y: how far to move down, in pixels.
        beside: how far below the middle of the stick to press, in pixels.
    """
    across, down = browser.middle("#stick")
    browser.touch("touchStart", (across, down + beside))
    end = across + x, down + beside + y
    browser.touch("touchMove", end)
    return end


def hold_stick(
    browser: Browser, until: Callable[[], Any], x: float, y: float, beside: float = 0.0
) -> tuple[float, float]:
    """Hold the stick as with `touch_stick` until a condition is true.

    On a busy machine, the connection may be too slow for a moment.
    """
    end = touch_stick(browser, x, y, beside)

    def is_done() -> Any:
        if browser.script("store.held.value === null"):
            browser.touch("touchEnd")
            touch_stick(browser, x, y, beside)
        return until()

    eventually(is_done, "the effect of the stick")
    return end


@pytest.mark.parametrize(("width", "height"), _SCREENS + _SMALL)
def test_nothing_lies_over_anything_that_is_pressed(
    serve: Serve, window: Browser, width: int, height: int
) -> None:
    open_observed(window, serve({}).url, width, height)
    size = window.script("[document.body.scrollWidth, document.body.scrollHeight]")
    assert size == [width, height]
    parts = ("#stop", "#stick", ".tools", "#map", ".line", ".tabs", ".doing")
    boxes = {selector: window.element(selector).rect for selector in parts}
    for one, other in itertools.combinations(parts, 2):
        assert are_apart(boxes[one], boxes[other]), (one, other)
    if (width, height) != (427, 267):
        for side in ("Height", "Width"):
            scrolls = f"((each) => each.scroll{side} > each.client{side})"
            assert not window.script(f"{scrolls}(document.querySelector('.tools'))"), side
    # with the sheet open, the whole map is still shown beside it, if there is room
    if (is_small := width < 1000 or height < 600) and (width, height) != (427, 267):
        window.press("#tab-go")
    window.press("#fit")
    panel, canvas = window.element(".panel").rect, boxes["#map"]
    assert are_apart(panel, boxes["#stick"])
    for x, y in window.map_corners():
        at = {"x": canvas["x"] + x, "y": canvas["y"] + y, "width": 0.0, "height": 0.0}
        assert are_apart(at, panel) or not is_small, (at, panel)
        assert 0 <= x <= canvas["width"], (x, y)
        assert 0 <= y <= canvas["height"], (x, y)
    assert are_apart(window.script(_MAP_BOX), window.script(_SCALE_BOX))
    window.press("#layers")
    assert are_apart(window.element(".menu").rect, boxes["#stick"])


def test_the_bar_and_the_banner_of_a_window_at_200_percent_can_be_read(
    serve: Serve, window: Browser
) -> None:
    served = serve({})
    open_observed(window, served.url, 512, 330)
    dot, battery = (window.element(each).rect for each in ("#link .dot", ".battery"))
    assert are_apart(dot, battery)
    assert window.script(_CUT) == []
    served.robots[0].set_emergency_stop(True)
    served.robots[0].inject("lost_localisation")
    eventually(lambda: window.script("store.robot.value.objections.length") == 2, "both")
    assert window.element("#notice b").rect["height"] < 48, "two lines"
    window.press("#tab-go")
    wide = "filter(({scrollWidth, clientWidth}) => scrollWidth > clientWidth)"
    assert window.script(f"[...document.querySelectorAll('#charge, #park')].{wide}") == []


_MAP_BOX = """(() => {
  const over = document.querySelector("#map").getBoundingClientRect();
  const corners = mapCanvas.corners(mapCanvas.area).map(({x, y}) => mapCanvas.view.toScreen(x, y));
  const [across, down] = [corners.map(({x}) => x + over.x), corners.map(({y}) => y + over.y)];
  const [x, y] = [Math.min(...across), Math.min(...down)];
  return {x, y, width: Math.max(...across) - x, height: Math.max(...down) - y};
})()"""
"""The box of the map's picture on the screen."""
_SCALE_BOX = """import("/map/draw.js").then(({scaleBar}) => {
  const over = document.querySelector("#map").getBoundingClientRect();
  const {x, y, length} = scaleBar(mapCanvas.view);
  const width = length * mapCanvas.view.scale;
  return {x: over.x + x, y: over.y + y - 20, width, height: 20};
})"""
"""The box of the scale bar and its text on the screen."""


def test_a_whole_map_is_fitted_beside_what_lies_over_it_and_not_moved_by_notices(
    serve: Serve, window: Browser
) -> None:
    def is_beside(selector: str) -> bool:
        box = window.script(f"document.querySelector('{selector}')?.getBoundingClientRect()")
        return bool(box and box["height"]) and are_apart(window.script(_MAP_BOX), box)

    served = serve({})
    (robot,) = served.robots
    open_observed(window, served.url, 1440, 900)
    for width, height in ((1440, 900), (768, 1024), (844, 390)):
        window.set_screen(width, height)
        eventually(lambda width=width: window.script("mapCanvas.view.width") <= width, "the size")
        window.press("#fit")
        before = window.script(_MAP_BOX)
        robot.set_emergency_stop(True)
        eventually(lambda: is_beside("#notice"), "room for the banner")
        assert window.script(_MAP_BOX) == before
        robot.set_emergency_stop(False)
        eventually(lambda: not window.text("#notice"), "the end of the banner")
    window.set_screen(390, 844)
    eventually(lambda: window.script("mapCanvas.view.width") == 390, "the phone")
    window.press("#tab-go")
    eventually(lambda: is_beside(".panel"), "the map beside the sheet")
    before = window.script(_MAP_BOX)
    robot.set_emergency_stop(True)
    lost = robot.inject("lost_localisation")
    eventually(lambda: window.script("store.robot.value.objections.length") == 2, "both")
    assert "1 more" not in window.text("#notice"), "one line"
    eventually(lambda: window.text("#notice"), "the banner")
    assert window.script(_MAP_BOX) == before
    window.press("#fit")
    assert is_beside("#notice")
    assert is_beside(".panel")
    assert window.script(_MAP_BOX)["height"] > 100
    window.press(".panel [aria-label=Close]")
    eventually(lambda: is_beside("#notice"), "the map beside the banner")
    lost.clear()
    for width, height in ((390, 844), (1440, 900)):
        window.set_screen(width, height)
        window.driver.refresh()
        window.wait_for_map()
        eventually(lambda: is_beside("#notice"), "the map beside the banner after a load")
    window.set_screen(390, 844)
    eventually(lambda: is_beside("#notice"), "the map on the phone")
    window.press("#zoom-in")
    scale = window.script("mapCanvas.view.scale")
    window.press("#tab-go")
    eventually(lambda: window.script("mapCanvas.view.inset.bottom > 0"), "the sheet")
    assert window.script("mapCanvas.view.scale") == scale


@pytest.mark.parametrize("width", [1440, 390])
def test_the_bar_stands_still_when_its_numbers_get_more_digits(
    serve: Serve, window: Browser, width: int
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
    open_observed(window, serve({}).url, width, 900)
    numbers = ("{delay: 4, power: 7}", "{delay: 45, power: 70}", "{delay: 4567, power: 100}")
    places = [window.script(change % each) for each in numbers]
    assert len(places[0]) == 4
    assert places[0] == places[1] == places[2]


def test_a_long_delay_of_the_link_fits_in_the_bar(serve: Serve, window: Browser) -> None:
    show = """((delay) => {
        store.link.value = {...store.link.value, delay};
        return new Promise((resolve) => setTimeout(() => requestAnimationFrame(() => {
          const {textContent, scrollWidth, clientWidth} = document.querySelector("#link .delay");
          resolve([textContent, scrollWidth <= clientWidth]);
        })));
      })(%d)
    """
    open_observed(window, serve({}).url, 768, 1024)
    shown = [window.script(show % delay) for delay in (999, 1000, 11345)]
    assert shown == [["999 ms", True], ["1.0 s", True], ["11.3 s", True]]


def test_an_unconfirmed_stop_and_a_lost_link_are_counted_as_alarms(
    serve: Serve, window: Browser
) -> None:
    served = serve({})
    open_observed(window, served.url, 1440, 900)
    assert window.text("button.chip") == "No alarms"
    served.robots[0].stop_listening()
    eventually(lambda: window.text("button.chip") == "1 alarm", "the lost link")
    assert re.search(r"Since \d\d:\d\d:\d\d\.", window.text("#notice"))
    window.press("#stop")
    eventually(lambda: window.text("#alarm"), "the unconfirmed stop")
    assert window.text("button.chip") == "2 alarms"
    assert "bad" in window.element("button.chip").get_attribute("class")


def test_the_bar_the_banner_and_the_list_agree_how_much_is_wrong(
    serve: Serve, window: Browser
) -> None:
    def check(count: int) -> None:
        alarms = "1 alarm" if count == 1 else f"{count} alarms"
        eventually(lambda: window.text("button.chip") == alarms, alarms)
        assert len(window.elements("#problems > li")) == count
        assert window.text("#tab-state .badge") == str(count)
        assert "bad" in window.element("#tab-state .badge").get_attribute("class")
        more = [each.text for each in window.elements("#notice .actions .quiet")]
        assert more == ([f"{count - 1} more"] if count > 1 else [])

    served = serve({})
    (robot,) = served.robots
    open_observed(window, served.url, 1440, 900)
    window.press("#tab-state")
    robot.set_emergency_stop(True)
    eventually(lambda: "emergency stop" in window.text("#notice"), "the banner")
    check(1)
    robot.inject("key_switch")
    robot.inject("lost_localisation")
    check(3)
    code = StatusCode(code=110401000111, level=StatusCode.kWarn, msg="low voltage")
    robot.push(AbnormalCodes(scs=[code]))  # in no banner
    check(4)


_SMALL_TARGETS = """[...document.querySelectorAll("button, select, input, summary, [role=tab]")]
  .map((each) => [each, (each.closest("label") ?? each).getBoundingClientRect()])
  .filter(([, box]) => box.width && (box.height < 43.5 || box.width < 43.5))
  .map(([each, box]) => `${each.outerHTML}: ${box.width} x ${box.height}`)
"""
"""Lists what is pressed and is smaller than 44 pixels."""


@pytest.mark.parametrize(("width", "height"), [(360, 640), (1440, 900)])
def test_whatever_is_pressed_has_44_pixels(
    serve: Serve, window: Browser, width: int, height: int
) -> None:
    open_observed(window, serve({}, _SECOND).url, width, height)
    for tab in ("fleet", "go", "tasks", "state", "map", "setup"):
        window.press(f"#tab-{tab}")
        assert window.script(_SMALL_TARGETS) == [], tab
    if width < 1000:
        window.press("#tab-setup")  # closes the sheet
    window.press("#layers")
    assert window.script(_SMALL_TARGETS) == []


@pytest.mark.parametrize(("width", "height"), _SCREENS)
def test_nothing_moves_or_covers_the_stick_and_stop(
    serve: Serve, window: Browser, width: int, height: int
) -> None:
    number = 1 + _SCREENS.index((width, height)) % 2
    served = serve(*[{}, _SECOND][:number])
    first = served.robots[0]
    open_observed(window, served.url, width, height)

    def check(state: str) -> None:
        assert window.script(_COVERED) == [], state
        assert window.script(_CUT) == [], state
        for selector in ("#stop", "#stick"):
            boxes = window.script(f"[...boxes['{selector}']]")
            assert len(boxes) == 1, (state, selector, boxes)
        assert window.script("shifts") == [], state
        assert window.script("document.documentElement.scrollWidth") <= width, state

    stop = window.element("#stop").rect
    assert stop["height"] >= 64
    assert stop["width"] >= 98
    assert window.script("document.querySelector('#robots') !== null") == (number > 1)
    shown = "30001" if number > 1 else ""
    eventually(lambda: window.text("#stop small") == shown, "the robot that STOP stops")
    check("standing")

    def see_the_other() -> None:
        eventually(lambda: window.text("#owner").startswith("Viewer "), "the other owner")
        check("control of another viewer")

    async def command_with_another() -> None:
        async with page(served.url) as other:
            await other.command("pause")
            await asyncio.to_thread(see_the_other)

    asyncio.run(command_with_another())
    eventually(lambda: "Nobody" in window.text("#owner"), "the end of the other's control")

    # turns in place
    hold_stick(window, lambda: window.text("#owner") == "You have control", 30, 0)
    assert window.element("#release").is_displayed()
    check("control taken")
    window.touch("touchEnd")
    window.script(
        "store.answer.value = {ok: false, time: 0, robot: store.address.value,"
        " text: {key: 'reason.said', values: {text: 'a long reason '.repeat(30)}}}",
    )
    check("a long answer")
    window.element("#answer").click()
    shown = "{scrollWidth, clientWidth, scrollHeight, clientHeight}"
    fits = "scrollWidth <= clientWidth && scrollHeight <= clientHeight"
    assert window.script(f"(({shown}) => {fits})(document.querySelector('#answer'))")
    window.script("document.activeElement.blur()")
    window.press("#tab-go")
    window.press("#marks button")
    eventually(lambda: window.is_enabled("#go"), "the preview")
    check("a preview")
    window.element("#kind option[value='carry 0']").click()
    check("a preview of carrying")
    window.press("#dismiss")
    if width < 1000:
        window.press(".panel [aria-label=Larger]")
        check("a large panel")
        window.press(".panel [aria-label=Close]")

    freeze = first.inject("freeze")
    eventually(lambda: "No data for " in window.text("#link"), "the silence of the robot")
    check("no data")
    freeze.clear()
    eventually(lambda: window.script("!store.outdated.value"), "the robot")
    first.stop_listening()
    eventually(lambda: "lost" in window.text("#link"), "the loss of the link")
    if width < 480 or height < 600:
        window.press("#notice summary")
    assert "last known state" in window.text("#notice")
    check("link lost")
    first.listen()
    eventually(lambda: window.script("!store.outdated.value"), "the link")
    first.set_emergency_stop(True)
    eventually(lambda: "emergency stop" in window.text("#notice"), "the emergency stop")
    check("emergency stop")
    first.set_emergency_stop(False)

    with silent(served):
        eventually(lambda: "No answer from" in window.text("#link"), "the silence")
        check("dashboard silent")
        window.element("#stop").click()
        eventually(lambda: window.text("#alarm"), "the alarm")
        line = window.element("#alarm").rect
        assert line["height"] < 48, "one line"
        alarm = "document.querySelector('#alarm')"
        assert window.script(f"{alarm}.scrollWidth <= {alarm}.clientWidth")
        assert "Press the robot's emergency stop" in window.text("#alarm")
        assert "stands still" not in window.text("#alarm")
        check("alarm")
        window.element("#alarm summary").click()
        assert re.search("no answer|was lost", window.text("#alarm"))
        assert "stands still" in window.text("#alarm")
        assert window.element("#alarm").rect["height"] > line["height"]
        check("alarm read in full")
        eventually(lambda: "No connection" in window.text(".notices"), "the lost connection")
        window.script("document.querySelector('#alarm p').textContent = 'a long reason '.repeat(6)")
        check("alarm with a long reason")
        window.element("#alarm summary").click()
        assert window.element("#alarm").rect == line
    eventually(lambda: not window.text("#alarm"), "the end of the alarm")
    check("after the alarm")


def test_long_names_of_two_robots_leave_room_in_the_bar(serve: Serve, window: Browser) -> None:
    port_lines = """((label) => {
      const range = document.createRange();
      range.selectNodeContents([...label.childNodes].findLast((each) => each.nodeType === 3));
      return range.getClientRects().length;
    })(document.querySelector("#stop small"))"""
    served = serve({}, {})
    open_observed(window, served.url, 1024, 768)
    eventually(lambda: "127.0.0.1" in window.text("#stop"), "the robot that STOP stops")
    assert window.script(port_lines) == 1
    served.robots[0].stop_listening()
    eventually(lambda: "lost" in window.text("#link"), "the loss of the link")
    assert window.script(_CUT) == []
    window.set_screen(768, 1024)
    eventually(lambda: window.script("innerWidth") == 768, "the small screen")
    assert window.script(port_lines) == 1


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1440, 900)])
def test_a_long_name_of_a_robot_can_be_read_on_its_card(
    serve: Serve, window: Browser, width: int, height: int
) -> None:
    def rename(simulator: Any) -> None:
        simulator.chassis.setting.identity.name = "north_hall_shelf_carrier_" * 3
        simulator.drop()  # the name is requested after a reconnect

    served = serve({}, _SECOND)
    served.robots[0].call(rename)
    open_observed(window, served.url, width, height)
    window.show("fleet")
    eventually(lambda: "carrier" in window.text("#fleet .card"), "the name")
    cut = """[...document.querySelectorAll("#fleet .card *")].filter(
      (each) => each.getBoundingClientRect().right > innerWidth ||
        each.scrollWidth > each.clientWidth + 1 && each.clientWidth
    ).map((each) => each.outerHTML)"""
    assert window.script(cut) == []


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1440, 900)])
def test_a_long_name_of_a_mark_can_be_read(
    window: Browser, tmp_path: Path, width: int, height: int
) -> None:
    name = "north_hall_shelf_" * 4 + "17"
    (tmp_path / "scene.yaml").write_text(
        "name: hall\nmaps:\n  - name: ground\n    walls: [[-9, -9, 9, -9, 9, 9, -9, 9, -9, -9]]\n"
        f"    marks: [{{number: {name}, pose: [2, 2, 0]}}]\n"
    )
    cut = """[...document.querySelectorAll("#marks .row, #marks .row *, #now, #now *, .kind")]
      .filter((each) => each.scrollWidth > each.clientWidth + 1 && each.clientWidth ||
        each.getBoundingClientRect().right > innerWidth).map((each) => each.outerHTML)"""
    with SimulatedPage(scenes=(tmp_path,)) as robot:
        open_observed(window, robot.url, width, height)
        window.show("go")
        eventually(lambda: name in window.text("#marks"), "the mark")
        assert window.script(cut) == []
        window.choose_mark(1)
        assert window.script(cut) == []


def test_the_first_press_of_the_stick_drives_where_the_finger_goes(
    serve: Serve, window: Browser
) -> None:
    served = serve({})
    (robot,) = served.robots
    open_observed(window, served.url, 360, 700)
    beside = 0.4 * _STICK_RADIUS  # the finger need not hit the middle
    touch_stick(window, 0, 0, beside)
    assert window.script("[store.held.value.linear, store.held.value.angular]") == [0, 0]
    window.touch("touchEnd")
    back = 0.25 * _STICK_RADIUS
    x, y = hold_stick(window, lambda: robot.state.velocity.forward < -0.05, 0, back, beside)
    eventually(lambda: window.text("#owner") == "You have control", "the control")
    window.touch("touchMove", (x, y + 1))
    window.touch("touchEnd")
    eventually(lambda: robot.last(full_name(Twist)) == Twist(), "the end")
    sent = [each.message for each in robot.received if each.type == full_name(Twist)]
    limit = window.script("store.control.value.limits.linear")
    assert min(each.linear for each in sent) >= -0.3 * limit
    assert max(each.linear for each in sent) == 0.0
    assert {each.angular for each in sent} == {0.0}


def test_stop_works_for_a_finger_while_another_one_holds_the_stick(
    serve: Serve, window: Browser
) -> None:
    served = serve({})
    open_observed(window, served.url, 390, 800)
    finger = hold_stick(window, lambda: served.robots[0].state.velocity.forward > 0.05, 0, -40)
    window.touch("touchStart", finger, window.middle("#stop"))
    eventually(lambda: "stopped" in window.text("#answer"), "the answer")
    assert window.script("store.held.value === null")
    window.touch("touchEnd")


@pytest.mark.parametrize("change", ["turn", "zoom", "layout"])
def test_another_place_of_the_stick_on_the_screen_ends_the_press(
    serve: Serve, window: Browser, change: str
) -> None:
    served = serve({})
    (robot,) = served.robots
    open_observed(window, served.url, 390, 844)
    x, y = hold_stick(window, lambda: robot.state.velocity.forward < -0.05, 0, 40)
    if change == "turn":
        window.set_screen(844, 390)
    elif change == "zoom":
        window.set_screen(390, 844, 2)
    else:
        window.script("document.querySelector('#stick').style.marginBottom = '20px'")
    eventually(lambda: robot.last(full_name(Twist)) == Twist(), "the zero, without a touch")
    eventually(lambda: "turned, resized or zoomed" in window.text("#answer"), "why")
    window.touch("touchMove", (x, y - 1))
    assert window.script("store.held.value === null")
    window.touch("touchEnd")
    assert robot.last(full_name(Twist)) == Twist()
    hold_stick(window, lambda: robot.state.velocity.forward < -0.05, 0, 40)  # another press
    window.touch("touchEnd")


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
_ABOVE_HANDLE = """(() => {
  const panel = document.querySelector(".panel");
  const [top, handle] = [panel, panel.querySelector(".handle")]
    .map((each) => each.getBoundingClientRect().top);
  const found = new Set();
  for (let y = top + 2; y < handle; y += 4) {
    for (let x = 2; x < innerWidth; x += 8) {
      const [first] = document.elementsFromPoint(x, y).filter((each) => panel.contains(each));
      if (first?.closest("#panel")) found.add(first.outerHTML);
    }
  }
  return [...found];
})()"""
"""Lists what is seen of the panel's content between its top and the handle, but for the notices."""
_UNDER_NOTICES = """(selector) => {
  const {x, y, width, height} = document.querySelector(selector).getBoundingClientRect();
  return document.elementFromPoint(x + width / 2, y + height / 2).closest(".notices") !== null;
}"""


@pytest.mark.parametrize(
    ("width", "height", "larger"),
    [(360, 640, True), (768, 1024, True), (640, 360, False), (844, 390, False)],
)
def test_an_open_sheet_hides_neither_an_alarm_nor_what_is_wrong(
    serve: Serve, window: Browser, width: int, height: int, larger: bool
) -> None:
    def is_seen(selector: str) -> bool:
        assert window.text(selector)
        return bool(window.script(f"({_HIDDEN})('{selector}').length === 0"))

    served = serve({})
    (robot,) = served.robots
    open_observed(window, served.url, width, height)
    window.press("#tab-tasks")
    if larger:
        window.press(".panel [aria-label=Larger]")
    top = "document.querySelector('#panel').getBoundingClientRect().top"
    begin = window.script(top)
    robot.set_emergency_stop(True)
    eventually(lambda: "emergency stop" in window.text("#notice"), "the banner")
    eventually(lambda: is_seen("#notice summary b"), "the banner over the sheet")
    size = f".panel [aria-label={'Smaller' if larger else 'Larger'}]"
    window.script("document.querySelector('.panel').scrollTo(0, 0)")
    eventually(lambda: not window.script(f"({_UNDER_NOTICES})('{size}')"), "the handle")
    if larger:
        window.press("#tab-setup")
        window.script("document.querySelector('.panel').scrollTo(0, 9999)")
        assert window.script("document.querySelector('.panel').scrollTop > 50")
        eventually(lambda: window.script(_ABOVE_HANDLE) == [], "nothing above the handle")
        window.press("#tab-tasks")
    robot.set_emergency_stop(False)
    eventually(lambda: not window.text("#notice"), "the end of the banner")
    eventually(lambda: window.script(top) == begin, "the former place")
    robot.inject("freeze")
    window.press("#stop")
    eventually(lambda: window.text("#alarm"), "the alarm")
    eventually(lambda: is_seen("#alarm summary span"), "the alarm over the sheet")
    assert window.script(_CUT) == []
    # the number of alarms leads to them
    window.press("button.chip")
    eventually(lambda: "STOP is not confirmed" in window.text("#problems"), "the list")
    assert "No data for" in window.text("#problems")
    assert "not known" in window.text("#new-task")
    for tab in ("go", "tasks", "state", "map", "setup"):
        window.element(f"#tab-{tab}").click()
        assert "last known state" in window.text(".stale"), tab
        assert window.script("document.querySelector('#panel.old') !== null"), tab

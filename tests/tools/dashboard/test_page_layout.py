"""The places of the stick and of STOP, at the sizes of phones, tablets and computers."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.tools.dashboard.browsers import Browser, are_apart, eventually, write_scene
from tests.tools.dashboard.conftest import Serve
from tests.tools.dashboard.pages import page, velocities
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

pytestmark = pytest.mark.timeout(300)
_PHONE, _TURNED, _TABLET, _TURNED_TABLET = (360, 640), (844, 390), (768, 1024), (1024, 768)
_NOTEBOOK = (1440, 900)
_TINY = (427, 267)
"""A window of 1280 x 800 pixels at 300 %: it has no room for the tools and the map."""
_SMALL = [(320, 568), (667, 375), (512, 330), _TINY]
"""Old phones, and windows of 1024 x 660 pixels at 200 % and of 1280 x 800 at 300 %."""
_STICK_RADIUS = 68.0
"""Radius of the stick on a phone, in pixels."""
_SECOND = {"robot_id": 30002}
"""Options of a second robot."""

_OBSERVE = """
globalThis.boxes = {"#stop": new Set(), "#stick": new Set()};
const look = () => {
  for (const [selector, seen] of Object.entries(boxes)) {
    const box = document.querySelector(selector)?.getBoundingClientRect();
    if (box?.width) seen.add([box.x, box.y, box.width, box.height].join(" "));
  }
  if (document.getAnimations().length) requestAnimationFrame(look);
};
new MutationObserver(() => setTimeout(look)).observe(document.documentElement,
  {subtree: true, childList: true, attributes: true, characterData: true});
look();
"""
"""Collects the boxes of the stick and STOP in all frames in which something changes."""
_PLACES = """["#stop", "#stick"].map((selector) =>
  JSON.stringify(document.querySelector(selector).getBoundingClientRect()))"""
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
_SWITCHES = """[
  ["#keyboard", "#slow"].map((selector) =>
    JSON.stringify(document.querySelector(selector).getBoundingClientRect())),
  [...document.querySelectorAll(".owner > *")].filter((each) => each.offsetWidth > 1 &&
    (each.scrollWidth > each.clientWidth || each.scrollHeight > each.clientHeight + 2))
    .map((each) => each.outerHTML)]"""
"""Places of the switches at the stick, and what cannot be read beside them."""
_LOOK = f"[{_PLACES}, {_COVERED}, {_CUT}, document.documentElement.scrollWidth]"


def open_on(browser: Browser, url: str, width: int, height: int) -> None:
    """Open the page on a screen of this size."""
    browser.set_screen(width, height)
    browser.open(url)
    browser.resize(width, height)
    eventually(lambda: browser.element("#stop").is_displayed(), "STOP")


def hold_stick(
    browser: Browser, until: Callable[[], Any], x: float, y: float, beside: float = 0.0
) -> tuple[float, float]:
    """Press the stick with a finger, move it, and hold it until a condition is true.

    On a busy machine, the connection may be too slow for a moment, so that the page lets go.

    Args:
        browser: the browser.
        until: the condition.
        x: how far to move to the right, in pixels.
        y: how far to move down, in pixels.
        beside: how far below the middle of the stick to press, in pixels.

    Returns:
        Where the finger is then.
    """
    across, down = browser.middle("#stick")
    end = across + x, down + beside + y

    def press() -> None:
        browser.touch("touchStart", (across, down + beside))
        browser.touch("touchMove", end)

    def is_done() -> Any:
        if browser.script("store.held.value === null"):
            browser.touch("touchEnd")
            press()
        return until()

    press()
    eventually(is_done, "the effect of the stick")
    return end


def test_nothing_lies_over_anything_that_is_pressed(serve: Serve, window: Browser) -> None:
    parts = ["#stop", "#stick", ".tools", "#map", ".line", ".tabs", ".doing"]
    places = f"""Object.fromEntries({parts}.map((selector) =>
      [selector, document.querySelector(selector).getBoundingClientRect().toJSON()]))"""
    open_on(window, serve({}).url, *_TURNED)
    for width, height in (_TURNED, _TABLET, _NOTEBOOK, *_SMALL):
        window.resize(width, height)
        size = window.script("[document.body.scrollWidth, document.body.scrollHeight]")
        assert size == [width, height]
        boxes = window.script(places)
        for one, other in itertools.combinations(parts, 2):
            assert are_apart(boxes[one], boxes[other]), (width, height, one, other)
        is_small = width < 1000 or height < 600
        has_room = (width, height) != _TINY
        if has_room:
            for side in ("Height", "Width"):
                scrolls = f"((each) => each.scroll{side} > each.client{side})"
                assert not window.script(f"{scrolls}(document.querySelector('.tools'))"), size
        # with the sheet open, the whole map is still shown beside it, if there is room
        if is_small and has_room:
            window.press("#tab-go")
        window.press("#fit")
        panel, canvas = window.element(".panel").rect, boxes["#map"]
        assert are_apart(panel, boxes["#stick"]), size
        for x, y in window.map_corners():
            at = {"x": canvas["x"] + x, "y": canvas["y"] + y, "width": 0.0, "height": 0.0}
            assert are_apart(at, panel) or not is_small, (size, at, panel)
            assert 0 <= x <= canvas["width"], (size, x, y)
            assert 0 <= y <= canvas["height"], (size, x, y)
        assert are_apart(window.script(_MAP_BOX), window.script(_SCALE_BOX)), size
        window.press("#layers")
        assert are_apart(window.element(".menu").rect, boxes["#stick"]), size
        window.press("#layers")
        if is_small and has_room:
            window.press("#tab-go")  # closes the sheet


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
    open_on(window, served.url, 1440, 900)
    for width, height in ((1440, 900), (768, 1024), (844, 390)):
        window.resize(width, height)
        window.press("#fit")
        before = window.script(_MAP_BOX)
        robot.set_emergency_stop(True)
        eventually(lambda: is_beside("#notice"), "room for the banner")
        assert window.script(_MAP_BOX) == before
        robot.set_emergency_stop(False)
        eventually(lambda: not window.text("#notice"), "the end of the banner")
    window.resize(390, 844)
    window.press("#tab-go")
    eventually(lambda: is_beside(".panel"), "the map beside the sheet")
    before = window.script(_MAP_BOX)
    robot.set_emergency_stop(True)
    robot.inject("lost_localisation")
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
    window.driver.refresh()
    window.wait_for_map()
    eventually(lambda: is_beside("#notice"), "the map beside the banner after a load")
    window.press("#zoom-in")
    scale = window.script("mapCanvas.view.scale")
    window.press("#tab-go")
    eventually(lambda: window.script("mapCanvas.view.inset.bottom > 0"), "the sheet")
    assert window.script("mapCanvas.view.scale") == scale


def test_the_bar_can_be_read_and_stands_still_when_its_numbers_change(
    serve: Serve, window: Browser
) -> None:
    change = """(({delay, power}) => {
        store.link.value = {...store.link.value, delay};
        const {battery} = store.robot.value;
        store.robot.value = {...store.robot.value, battery: {...battery, power}};
        return new Promise((resolve) => setTimeout(() => requestAnimationFrame(() => {
          const {textContent, scrollWidth, clientWidth} = document.querySelector("#link .delay");
          const chips = [...document.querySelectorAll(".chip")];
          resolve([chips.map((each) => each.getBoundingClientRect().x).join(),
            textContent, scrollWidth <= clientWidth]);
        })));
      })(%s)
    """
    numbers = ["{delay: 4, power: 7}", "{delay: 999, power: 70}", "{delay: 11345, power: 100}"]

    def shown() -> Any:
        places, texts, fit = zip(*(window.script(change % each) for each in numbers), strict=True)
        # otherwise, an update by the dashboard has replaced a number
        return (places, fit) if texts[1:] == ("999 ms", "11.3 s") else None

    open_on(window, serve({}).url, 390, 900)
    for width, height in ((390, 900), (1440, 900), (768, 1024)):
        window.resize(width, height)
        places, fit = eventually(shown, "the numbers")
        assert places[0].count(",") == 3
        assert len(set(places)) == 1, (width, places)
        assert fit == (True, True, True)
    window.resize(512, 330)  # at 200 %
    dot, battery = (window.element(each).rect for each in ("#link .dot", ".battery"))
    assert are_apart(dot, battery)
    assert window.script(_CUT) == []


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
    open_on(window, served.url, 1440, 900)
    assert window.text("button.chip") == "No alarms"
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


def test_whatever_is_pressed_has_44_pixels(serve: Serve, window: Browser) -> None:
    open_on(window, serve({}, _SECOND).url, 360, 640)
    for width, height in ((360, 640), (1440, 900)):
        window.resize(width, height)
        for tab in ("fleet", "go", "tasks", "state", "map", "setup"):
            window.press(f"#tab-{tab}")
            assert window.script(_SMALL_TARGETS) == [], (width, tab)
        if width < 1000:
            window.press("#tab-setup")  # closes the sheet
        window.press("#layers")
        assert window.script(_SMALL_TARGETS) == [], width
        window.press("#layers")


@pytest.mark.parametrize(
    ("number", "home", "screens"),
    [(1, (390, 844), [_PHONE, _TABLET, _NOTEBOOK]), (2, _TURNED, [(667, 375), _TURNED_TABLET])],
)
def test_nothing_moves_or_covers_the_stick_and_stop(
    serve: Serve,
    window: Browser,
    number: int,
    home: tuple[int, int],
    screens: list[tuple[int, int]],
) -> None:
    """Watch all frames on one screen, and look at the others in each state."""
    served = serve(*[{}, _SECOND][:number])
    first = served.robots[0]
    open_on(window, served.url, *home)
    window.driver.execute_script(_OBSERVE)
    places: dict[tuple[int, int], Any] = {}
    switches: dict[tuple[int, int], Any] = {}

    def check(state: str, also: Callable[[tuple[int, int]], None] = lambda _: None) -> None:
        for selector in ("#stop", "#stick"):
            seen = window.script(f"[...boxes['{selector}']]")
            assert len(seen) == 1, (state, selector, seen)
        for size in (*screens, home):
            window.resize(*size)
            now, covered, cut, width = window.script(_LOOK)
            assert places.setdefault(size, now) == now, (state, size)
            assert (covered, width) == ([], size[0]), (state, size)
            assert cut == [], (state, size)
            also(size)
        window.script("Object.values(boxes).forEach((each) => each.clear())")
        window.wait_for_frame()

    def stop_is_large_and_switches_stay(size: tuple[int, int]) -> None:
        box = window.element("#stop").rect
        assert box["height"] >= 64
        assert box["width"] >= 98
        found, cut = window.script(_SWITCHES)
        assert switches.setdefault(size, found) == found, size
        assert cut == [], size

    assert window.script("document.querySelector('#robots') !== null") == (number > 1)
    shown = "30001" if number > 1 else ""
    eventually(lambda: window.text("#stop small") == shown, "the robot that STOP stops")
    check("standing", stop_is_large_and_switches_stay)
    other = first.enter(page(served.url))
    first.run(other.command("pause"))
    eventually(lambda: window.text("#owner").startswith("Viewer "), "the other owner")
    check("control of another viewer")
    first.run(other.socket.close())
    eventually(lambda: "Nobody" in window.text("#owner"), "the end of the other's control")

    # turns in place
    hold_stick(window, lambda: window.text("#owner") == "You have control", 30, 0)
    assert window.element("#release").is_displayed()
    window.touch("touchEnd")
    check("control taken", stop_is_large_and_switches_stay)
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
    window.element("#kind option[value='carry 0']").click()
    check("a preview of carrying")
    window.press("#dismiss")
    window.press(".panel [aria-label=Larger]")
    check("a large panel")
    window.press(".panel [aria-label=Close]")

    first.stop_listening()
    eventually(lambda: "lost" in window.text("#link"), "the loss of the link")
    window.press("#notice summary")
    assert "last known state" in window.text("#notice")
    assert re.search(r"Since \d\d:\d\d:\d\d\.", window.text("#notice"))
    check("link lost")
    first.listen()
    eventually(lambda: window.script("!store.outdated.value"), "the link")
    first.set_emergency_stop(True)
    eventually(lambda: "emergency stop" in window.text("#notice"), "the emergency stop")
    check("emergency stop")
    first.set_emergency_stop(False)

    def alarm_has_one_line(_: object = None) -> None:
        assert window.element("#alarm").rect["height"] < 48
        assert window.script("((each) => each.scrollWidth <= each.clientWidth)(alarm)")

    with first.silent():
        eventually(lambda: "No answer from" in window.text("#link"), "the silence")
        check("dashboard silent")
        window.element("#stop").click()
        eventually(lambda: window.text("#alarm"), "the alarm")
        assert "Press the robot's emergency stop" in window.text("#alarm")
        assert "stands still" not in window.text("#alarm")
        check("alarm", alarm_has_one_line)
        window.element("#alarm summary").click()
        assert re.search("no answer|was lost", window.text("#alarm"))
        assert "stands still" in window.text("#alarm")
        eventually(lambda: "No connection" in window.text(".notices"), "the lost connection")
        window.script("document.querySelector('#alarm p').textContent = 'a long reason '.repeat(6)")
        check("alarm read in full, with a long reason")
        window.element("#alarm summary").click()
        alarm_has_one_line()
    eventually(lambda: not window.text("#alarm"), "the end of the alarm")
    check("after the alarm")


_WIDE = """(within) => [...document.querySelectorAll(within)]
  .filter((each) => each.getBoundingClientRect().right > innerWidth ||
    each.scrollWidth > each.clientWidth + 1 && each.clientWidth)
  .map((each) => each.outerHTML)"""
"""Lists what is wider than its place."""


def test_long_names_can_be_read(serve: Serve, window: Browser, tmp_path: Path) -> None:
    name = "north_hall_shelf_" * 4 + "17"
    write_scene(tmp_path, [{"number": name, "pose": [2, 2, 0]}])
    served = serve({"scenes": (tmp_path,)}, {})  # both have the same number
    first = served.robots[0]
    first.rename("north_hall_shelf_carrier_" * 3)
    open_on(window, served.url, 1024, 768)
    for width, height in ((1024, 768), (390, 844)):
        window.resize(width, height)
        window.show("fleet")
        eventually(lambda: "carrier" in window.text("#fleet .card"), "the name")
        assert window.script(f"({_WIDE})('#fleet .card *')") == []
        window.show("go")
        eventually(lambda: name in window.text("#marks"), "the mark")
        window.choose_mark(1)
        assert window.script(f"({_WIDE})('#marks .row, #marks .row *, #now, #now *, .kind')") == []
        window.press("#dismiss")
    eventually(lambda: "127.0.0.1" in window.text("#stop"), "the robot that STOP stops")
    first.stop_listening()
    eventually(lambda: "lost" in window.text("#link"), "the loss of the link")
    for size in ((1024, 768), (768, 1024)):
        window.resize(*size)
        assert window.script(_CUT) == [], size


def test_a_finger_drives_where_it_goes_until_the_stick_gets_another_place(
    serve: Serve, window: Browser
) -> None:
    def is_stopped() -> bool:
        return robot.last(full_name(Twist)) == Twist()

    def is_driving_back() -> bool:
        return robot.state.velocity.forward < -0.05

    changes: dict[str, Callable[[], Any]] = {
        "turn": lambda: window.set_screen(844, 390),
        "zoom": lambda: window.set_screen(390, 844, 2),
        "layout": lambda: window.script(
            "document.querySelector('#stick').style.marginBottom = '20px'"
        ),
    }
    served = serve({})
    (robot,) = served.robots
    open_on(window, served.url, 390, 844)
    beside = 0.4 * _STICK_RADIUS  # the finger need not hit the middle
    held = "[store.held.value?.linear, store.held.value?.angular]"
    hold_stick(window, lambda: window.script(held) == [0, 0], 0, 0, beside)
    window.touch("touchEnd")
    x, y = hold_stick(window, is_driving_back, 0, 0.25 * _STICK_RADIUS, beside)
    eventually(lambda: window.text("#owner") == "You have control", "the control")
    window.touch("touchMove", (x, y + 1))
    window.touch("touchEnd")
    eventually(is_stopped, "the end")
    sent = velocities(robot)
    limit = window.script("store.control.value.limits.linear")
    assert min(each.linear for each in sent) >= -0.3 * limit
    assert max(each.linear for each in sent) == 0.0
    assert {each.angular for each in sent} == {0.0}
    for change, make in changes.items():
        window.resize(390, 844)
        window.script("store.answer.value = null")
        x, y = hold_stick(window, is_driving_back, 0, 40)
        make()
        eventually(is_stopped, f"the zero, without a touch: {change}")
        eventually(lambda: "turned, resized or zoomed" in window.text("#answer"), "why")
        window.touch("touchMove", (x, y - 1))
        assert window.script("store.held.value === null"), change
        window.touch("touchEnd")
        assert is_stopped(), change


def test_stop_works_for_a_finger_while_another_one_holds_the_stick(
    serve: Serve, window: Browser
) -> None:
    served = serve({})
    open_on(window, served.url, 390, 800)
    finger = hold_stick(window, lambda: served.robots[0].state.velocity.forward > 0.05, 0, -40)
    window.touch("touchStart", finger, window.middle("#stop"))
    eventually(lambda: "stopped" in window.text("#answer"), "the answer")
    assert window.script("store.held.value === null")
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


def test_an_open_sheet_hides_neither_an_alarm_nor_what_is_wrong(
    serve: Serve, window: Browser
) -> None:
    def is_seen(selector: str) -> bool:
        assert window.text(selector)
        return bool(window.script(f"({_HIDDEN})('{selector}').length === 0"))

    served = serve({})
    (robot,) = served.robots
    open_on(window, served.url, 360, 640)
    window.press("#tab-tasks")
    top = "document.querySelector('#panel').getBoundingClientRect().top"
    for width, height in (_PHONE, (640, 360)):
        window.resize(width, height)
        larger = width < height
        window.script(f"store.sheet.value = '{'full' if larger else 'half'}'")
        window.wait_for_frame()
        begin = window.script(top)
        robot.set_emergency_stop(True)
        eventually(lambda: "emergency stop" in window.text("#notice"), "the banner")
        eventually(lambda: is_seen("#notice summary b"), "the banner over the sheet")
        size = f".panel [aria-label={'Smaller' if larger else 'Larger'}]"
        window.script("document.querySelector('.panel').scrollTo(0, 0)")
        eventually(
            lambda size=size: not window.script(f"({_UNDER_NOTICES})('{size}')"), "the handle"
        )
        if larger:
            window.press("#tab-setup")
            window.script("document.querySelector('.panel').scrollTo(0, 9999)")
            assert window.script("document.querySelector('.panel').scrollTop > 50")
            eventually(lambda: window.script(_ABOVE_HANDLE) == [], "nothing above the handle")
            window.press("#tab-tasks")
        robot.set_emergency_stop(False)
        eventually(lambda: not window.text("#notice"), "the end of the banner")
        eventually(lambda begin=begin: window.script(top) == begin, "the former place")
    robot.inject("freeze")
    window.press("#stop")
    eventually(lambda: window.text("#alarm"), "the alarm")
    for width, height in (_TURNED, _TABLET, _PHONE):
        window.resize(width, height)
        eventually(lambda: is_seen("#alarm summary span"), "the alarm over the sheet")
        assert window.script(_CUT) == [], (width, height)
    # the number of alarms leads to them
    assert window.element("button.chip").accessible_name == "2 alarms"
    assert "bad" in window.element("button.chip").get_attribute("class")
    window.press("button.chip")
    eventually(lambda: "it may still move" in window.text("#problems"), "the list")
    assert "No data for" in window.text("#problems")
    assert "not known" in window.text("#new-task")
    for tab in ("go", "tasks", "state", "map", "setup"):
        window.element(f"#tab-{tab}").click()
        assert "last known state" in window.text(".stale"), tab
        assert window.script("document.querySelector('#panel.old') !== null"), tab

"""The page in a real browser, against a simulated robot.

With WOOSH_SCREENSHOTS=docs, the pictures of the documentation are made anew.
"""

from __future__ import annotations

import asyncio
import math
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.quick_chassis import quick_config
from tests.tools.dashboard.browsers import (
    SharedBrowser,
    SimulatedPage,
    actions,
    element,
    eventually,
    requested_urls,
    script,
    set_screen,
    text,
    touch,
)
from tests.tools.dashboard.pages import page, program
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, SetRobotPose, Twist
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard.control import TOO_SLOW

pytestmark = pytest.mark.timeout(300)
_SCREENSHOTS = os.environ.get("WOOSH_SCREENSHOTS")
_PLACE = (1.0, -6.0)
"""A place on the map where the robot can stand, in metres."""


@pytest.fixture
def robot() -> Iterator[SimulatedPage]:
    """A simulated robot with its page."""
    running = SimulatedPage()
    yield running
    running.close()


@pytest.fixture
def browser(robot: SimulatedPage, shared_browser: SharedBrowser) -> Iterator[Any]:
    """A browser that shows the page; at the end, its console and its requests are checked."""
    with shared_browser.window() as driver:
        driver.get(robot.url)
        eventually(lambda: script(driver, "mapView.image !== null && mapView.scan !== null"), "map")
        yield driver
        check_console_and_requests(driver, robot)


def check_console_and_requests(driver: Any, robot: SimulatedPage) -> None:
    host = urlsplit(robot.url).netloc
    # on a busy machine, the page may give up a connection, which Chromium reports by itself
    given_up = f"WebSocket connection to 'ws://{host}/live' failed"
    messages = [entry["message"] for entry in driver.get_log("browser")]
    assert [each for each in messages if given_up not in each] == []
    urls = requested_urls(driver)
    assert f"ws://{host}/live" in urls
    others = {url for url in urls if urlsplit(url).netloc != host}
    assert {url for url in others if not url.startswith(("data:", "chrome:"))} == set()


def click_at(
    driver: Any,
    x: float,
    y: float,
    drag: tuple[int, int] | None = None,
    *,
    double: bool = False,
) -> None:
    """Click a place of the map, in metres; or press there and release elsewhere, in pixels."""
    at = script(driver, f"mapView.toScreen({x}, {y})")
    size = script(driver, "[mapView.width, mapView.height]")
    offset = round(at["x"] - size[0] / 2), round(at["y"] - size[1] / 2)
    chain = actions(driver).move_to_element_with_offset(element(driver, "#map"), *offset)
    if drag is None:
        (chain.double_click() if double else chain.click()).perform()
    else:
        chain.click_and_hold().move_by_offset(*drag).release().perform()


def click_until(
    driver: Any,
    condition: Callable[[], Any],
    what: str,
    x: float,
    y: float,
    drag: tuple[int, int] | None = None,
    *,
    double: bool = False,
) -> None:
    """Click a place until a condition is true; see `click_at`.

    On a busy machine, the connection to the dashboard may be too slow for a moment.
    """
    click_at(driver, x, y, drag, double=double)

    def is_true() -> Any:
        if TOO_SLOW in text(driver, "#message"):
            click_at(driver, x, y, drag, double=double)
        return condition()

    eventually(is_true, what)


def choose(driver: Any, tool: str) -> None:
    element(driver, f"[name=tool][value={tool}]").click()


def hold_stick(driver: Any, robot: SimulatedPage) -> None:
    """Push the stick ahead and keep it there until the robot drives.

    On a busy machine, the connection to the dashboard may be too slow for a moment.
    """
    stick = element(driver, "#stick")

    def is_pressed() -> bool:
        if not script(driver, "controls.velocity !== null"):
            actions(driver).release().perform()
            actions(driver).move_to_element(stick).click_and_hold().move_by_offset(0, -50).perform()
        return is_driving(robot)

    eventually(is_pressed, "the robot to drive")


def is_driving(robot: SimulatedPage) -> bool:
    return robot.call(lambda simulator: simulator.state.velocity.forward) > 0.05


def is_stopped_by_zero(robot: SimulatedPage) -> bool:
    def stopped(simulator: Any) -> bool:
        zero = simulator.last(full_name(Twist)) == Twist()
        return zero and simulator.state.velocity.forward == 0.0

    return robot.call(stopped)


def take_picture(driver: Any, name: str, tmp_path: Path) -> None:
    folder = Path(_SCREENSHOTS) if _SCREENSHOTS else tmp_path
    path = folder / name
    assert driver.save_screenshot(str(path))
    assert path.read_bytes().startswith(b"\x89PNG")


def test_the_page_shows_the_robot_where_the_simulator_has_it(
    robot: SimulatedPage, browser: Any
) -> None:
    pose = robot.call(lambda simulator: simulator.state.pose)
    shown = eventually(lambda: script(browser, "mapView.pose"), "the pose")
    assert math.dist((shown["x"], shown["y"]), (pose.x, pose.y)) < 0.01
    # the pixels at this place have the colour of the robot
    at = script(browser, "mapView.toScreen(mapView.pose.x, mapView.pose.y)")
    pixel = script(
        browser,
        f"[...mapView.context.getImageData({round(at['x']) - 4}, {round(at['y'])}, 1, 1).data]",
    )
    assert pixel[2] > pixel[0] + 40, pixel
    assert text(browser, "#link").startswith("connected since ")
    assert "Robase200" in text(browser, "#title")
    assert "would be accepted" in text(browser, "#state")
    assert "93 %" in text(browser, "#state")


def test_a_click_sends_the_robot_there(robot: SimulatedPage, browser: Any, tmp_path: Path) -> None:
    choose(browser, "go")
    up = (0, -60)  # the direction
    click_until(browser, lambda: script(browser, "mapView.path.length > 1"), "path", *_PLACE, up)
    eventually(lambda: "executing" in text(browser, "#state"), "the task")
    eventually(lambda: script(browser, "mapView.trail.length > 8"), "the trail")
    take_picture(browser, "dashboard.png", tmp_path)

    def is_there() -> bool:
        pose = robot.call(lambda simulator: simulator.state.pose)
        return math.dist((pose.x, pose.y), _PLACE) < 0.15 and abs(pose.theta - math.pi / 2) < 0.15

    eventually(is_there, "the robot to be there")
    assert "you have control" in text(browser, "#owner")


def test_zoom_pan_and_fit(browser: Any) -> None:
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    choose(browser, "look")

    def scale() -> float:
        return float(script(browser, "mapView.scale"))

    def corners() -> list[float]:
        """Left and right end of the map, in pixels."""
        return list(
            script(
                browser,
                "[0, mapView.image.width].map((column) => {"
                "  const at = mapView.fromPicture(column, 0);"
                "  return mapView.toScreen(at.x, at.y).x; })",
            )
        )

    fitted = scale()
    element(browser, "#zoom-in").click()
    assert math.isclose(scale(), 1.4 * fitted)
    element(browser, "#zoom-out").click()
    assert math.isclose(scale(), fitted)
    # the wheel keeps the place under the pointer
    area = element(browser, "#map")
    width, height = script(browser, "[mapView.width, mapView.height]")
    x, y = round(width / 2) + 100, round(height / 2) + 50
    before = script(browser, f"mapView.toWorld({x}, {y})")
    actions(browser).scroll_from_origin(ScrollOrigin.from_element(area, 100, 50), 0, -400).perform()
    eventually(lambda: scale() > 1.2 * fitted, "the zoom")
    after = script(browser, f"mapView.toWorld({x}, {y})")
    assert math.dist((before["x"], before["y"]), (after["x"], after["y"])) < 2 / fitted
    # dragging moves the map with the pointer
    before = script(browser, "mapView.toScreen(0, 0)")
    actions(browser).move_to_element(area).click_and_hold().move_by_offset(80, -40).perform()
    actions(browser).release().perform()
    after = script(browser, "mapView.toScreen(0, 0)")
    assert math.dist((after["x"] - before["x"], after["y"] - before["y"]), (80, -40)) < 2
    assert corners()[1] > width
    element(browser, "#fit").click()
    assert math.isclose(scale(), fitted)
    assert -1 <= corners()[0] < corners()[1] <= width + 1
    # two fingers
    for kind, spread in (("touchStart", 20), ("touchMove", 40), ("touchMove", 80)):
        touch(browser, kind, *((300 + side * spread, 300) for side in (0, 1)))
    touch(browser, "touchEnd")
    assert scale() > 2 * fitted


def test_fit_shows_a_large_map(robot: SimulatedPage, browser: Any) -> None:
    script(browser, "mapView.map.resolution = 10000 / mapView.image.width")  # 10 km
    element(browser, "#fit").click()
    assert script(browser, "mapView.scale") * 10000 <= script(browser, "mapView.width")


def test_the_view_follows_the_robot_until_it_is_dragged(robot: SimulatedPage, browser: Any) -> None:
    def from_middle() -> float:
        at = script(
            browser,
            "(({x, y}) => ({x: x - mapView.width / 2, y: y - mapView.height / 2}))"
            "(mapView.toScreen(mapView.pose.x, mapView.pose.y))",
        )
        return math.hypot(at["x"], at["y"])

    choose(browser, "look")
    follow = element(browser, "#follow")
    follow.click()
    eventually(lambda: from_middle() < 1.0, "the robot in the middle")
    begin = script(browser, "mapView.pose")
    hold_stick(browser, robot)
    eventually(
        lambda: (
            script(
                browser, f"Math.hypot(mapView.pose.x - {begin['x']}, mapView.pose.y - {begin['y']})"
            )
            > 0.1
        ),
        "the robot to move",
    )
    assert from_middle() < 1.0
    actions(browser).release().perform()
    actions(browser).move_to_element(element(browser, "#map")).click_and_hold().perform()
    actions(browser).move_by_offset(80, 0).release().perform()
    assert not follow.is_selected()
    assert script(browser, "mapView.follow") is False
    assert from_middle() > 50.0
    follow.click()
    element(browser, "#fit").click()
    assert not follow.is_selected()
    assert not script(browser, "mapView.follow")


def test_a_click_on_a_mark_goes_there(robot: SimulatedPage, browser: Any) -> None:
    mark = script(browser, "mapView.marks.find((mark) => mark.number === 'A2')")
    choose(browser, "go")
    click_until(
        browser, lambda: "to A2" in text(browser, "#state"), "the task", mark["x"], mark["y"]
    )


def test_a_double_click_sends_one_task(robot: SimulatedPage, browser: Any) -> None:
    def sent() -> int:
        return robot.call(lambda simulator: simulator.counts[full_name(ExecTask)])

    mark = script(browser, "mapView.marks.find((mark) => mark.number === 'A2')")
    choose(browser, "go")
    x, y = mark["x"], mark["y"]
    click_until(browser, lambda: "to A2" in text(browser, "#state"), "the task", x, y, double=True)
    # the answer to this one comes after the second click
    script(browser, "controls.run('speak', {text: 'hello'})")
    eventually(lambda: "speak: accepted" in text(browser, "#message"), "the answer")
    assert sent() == 1
    # while the answer is pending, later clicks send none either, and the page says so
    robot.call(lambda simulator: simulator.mute(full_name(ExecTask)))
    refusal = "the robot has not answered the former one"
    eventually(lambda: click_at(browser, x, y) or refusal in text(browser, "#message"), "refusal")
    assert sent() == 2


def test_set_pose_needs_a_drag(robot: SimulatedPage, browser: Any) -> None:
    def told() -> Any:
        return robot.call(lambda simulator: simulator.last(full_name(SetRobotPose)))

    choose(browser, "setPose")
    for slip in (None, (0, -15)):  # a finger slips
        script(browser, "controls.show(true, '')")
        click_at(browser, *_PLACE, slip)
        eventually(lambda: "drag in its direction" in text(browser, "#message"), "the advice")
    script(browser, "controls.run('speak', {text: 'hello'})")
    eventually(lambda: "speak: accepted" in text(browser, "#message"), "the answer")
    assert told() is None
    click_until(browser, told, "the pose", *_PLACE, (0, -60))
    pose = told().pose
    assert math.dist((pose.x, pose.y), _PLACE) < 0.1
    assert pose.theta == pytest.approx(math.pi / 2, abs=0.05)


def test_a_result_has_its_time_and_turns_red_when_the_task_fails(
    robot: SimulatedPage, browser: Any
) -> None:
    def is_going() -> bool:
        # on a busy machine, the connection may be too slow for a moment
        script(browser, "controls.run('go', {x: 500, y: 500, theta: 0})")
        return "go: accepted" in text(browser, "#message")

    eventually(is_going, "the answer")
    assert re.fullmatch(r"\d\d:\d\d:\d\d go: accepted", text(browser, "#message"))
    assert element(browser, "#message").get_attribute("class") == ""
    eventually(lambda: "go: failed" in text(browser, "#result"), "the failure")
    eventually(lambda: "navigation did not succeed" in text(browser, "#result"), "the reason")
    assert re.match(r"\d\d:\d\d:\d\d go: failed", text(browser, "#result"))
    assert element(browser, "#result").get_attribute("class") == "bad"


def test_on_another_screen_everything_is_drawn_where_it_is_clicked(browser: Any) -> None:
    metrics = {"width": 1280, "height": 700, "deviceScaleFactor": 1.5, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    eventually(lambda: script(browser, "devicePixelRatio === 1.5"), "the other screen")
    # the canvas has as many pixels as the screen shows, so each is drawn where it is clicked
    eventually(
        lambda: script(browser, "Math.abs(mapView.canvas.width - 1.5 * mapView.width) <= 1"),
        "the pixels",
    )
    assert script(browser, "mapView.context.getTransform().a * mapView.width") == pytest.approx(
        script(browser, "mapView.canvas.width"), abs=1
    )
    same_size = {**metrics, "deviceScaleFactor": 2}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", same_size)
    eventually(
        lambda: script(browser, "Math.abs(mapView.canvas.width - 2 * mapView.width) <= 1"),
        "the pixels of a screen of the same size",
    )


@pytest.mark.parametrize("end", ["let go", "hidden"])
def test_the_stick_drives_until_the_driver_goes_away(
    robot: SimulatedPage, browser: Any, end: str
) -> None:
    hold_stick(browser, robot)
    if end == "let go":
        actions(browser).release().perform()
    else:
        browser.switch_to.new_window("tab")
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")


def test_the_space_bar_stops(robot: SimulatedPage, browser: Any) -> None:
    hold_stick(browser, robot)
    actions(browser).send_keys(" ").perform()
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    eventually(lambda: "stopped" in text(browser, "#message"), "the answer")
    # the stick is still held, and a space in a text is a space
    assert not is_driving(robot)
    actions(browser).release().perform()
    field = element(browser, "#speak-text")
    field.send_keys("hello you")
    assert field.get_property("value") == "hello you"
    for selector in ("#speak-text", "#fault-arguments"):
        element(browser, selector).send_keys("nonsense=1\n")
        assert script(browser, "document.activeElement === document.body"), selector
    script(browser, "controls.show(true, '')")
    element(browser, "#stop").send_keys("\n")
    eventually(lambda: "stopped" in text(browser, "#message"), "the answer to the enter key")


def test_a_stop_of_another_viewer_ends_the_press(robot: SimulatedPage, browser: Any) -> None:
    async def stop() -> tuple[bool, str]:
        async with page(robot.url) as other:
            return await other.command("stop")

    hold_stick(browser, robot)
    ok, reason = asyncio.run(stop())
    assert ok, reason
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    eventually(lambda: script(browser, "controls.velocity === null"), "the page to let go")
    # the pointer is still down
    actions(browser).move_by_offset(10, 10).move_by_offset(-10, -10).perform()
    assert script(browser, "controls.velocity === null")
    assert not script(browser, "controls.stick.hasPointerCapture(1)")
    hold_stick(browser, robot)  # another press drives


def test_a_silent_dashboard_is_noticed_and_a_stop_without_an_answer_raises_an_alarm(
    robot: SimulatedPage, browser: Any
) -> None:
    hold_stick(browser, robot)
    with robot.silent():
        eventually(lambda: element(browser, "#outdated").is_displayed(), "the warning")
        assert script(browser, "controls.velocity === null")
        assert "no answer from the dashboard" in text(browser, "#link")
        element(browser, "#stop").click()
        eventually(lambda: element(browser, "#alarm").is_displayed(), "the alarm")
        assert "emergency stop: STOP is not confirmed (no answer)" in text(browser, "#alarm")
    actions(browser).release().perform()
    eventually(lambda: not element(browser, "#outdated").is_displayed(), "the dashboard")
    # the robot is seen to stand still
    eventually(lambda: not element(browser, "#alarm").is_displayed(), "the end of the alarm")
    script(browser, "controls.show(false, 'refused')")
    hold_stick(browser, robot)
    assert text(browser, "#message") == ""


def test_a_list_switches_between_robots_and_a_stop_is_for_the_one_shown(
    shared_browser: SharedBrowser,
) -> None:
    with (
        SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=7)) as first,
        SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=8)) as second,
        program(first, second) as (_, url),
        shared_browser.window() as browser,
    ):
        browser.get(url)
        eventually(lambda: element(browser, "#tools").is_displayed(), "the tools")
        assert not element(browser, "[value=obstacle]").is_displayed()  # of a simulator's own page
        options = "[...document.querySelectorAll('#robots option')].map((each) => each.text)"

        def are_named() -> bool:
            return all(
                each.startswith(f"{name} ") and each.endswith(": idle")
                for name, each in zip((7, 8), script(browser, options), strict=True)
            )

        eventually(are_named, "names and states in the list")
        for index, name in enumerate(("7 ", "8 ")):
            eventually(lambda: element(browser, "#robots").is_displayed(), "the list")
            element(browser, f"#robots option[value='{index}']").click()
            eventually(lambda name=name: text(browser, "#title").startswith(name), "the robot")
            eventually(lambda: script(browser, "mapView.image !== null"), "its map")

            def is_going() -> bool:
                # on a busy machine, the connection may be too slow for a moment
                if "to A2" not in text(browser, "#state"):
                    script(browser, "controls.run('goMark', {mark: 'A2'})")
                return "to A2" in text(browser, "#state")

            eventually(is_going, "the task")
        element(browser, "#stop").click()
        eventually(lambda: "task cancelled" in text(browser, "#message"), "the answer")
        order = full_name(ActionOrder)
        assert (first.counts[order], second.counts[order] > 0) == (0, True)
        element(browser, "#robots option[value='0']").click()
        eventually(lambda: text(browser, "#title").startswith("7 "), "the first robot")
        eventually(lambda: "executing" in text(browser, "#state"), "its task, which goes on")


def test_names_are_shown_as_text(shared_browser: SharedBrowser, tmp_path: Path) -> None:
    evil = "<img src=x onerror=hacked=1>"
    (tmp_path / "scene.yaml").write_text(
        f"name: {evil!r}\nmaps:\n  - name: {evil!r}\n"
        "    walls: [[-9, -9, 9, -9, 9, 9, -9, 9, -9, -9]]\n"
        f"    marks: [{{number: {evil!r}, pose: [2, 2, 0], description: {evil!r}}}]\n"
    )
    robot = SimulatedPage(scenes=(tmp_path,))

    def rename(simulator: Any) -> None:
        simulator.chassis.setting.identity.name = evil
        simulator.drop()  # the name is requested after a reconnect

    robot.call(rename)
    try:
        with shared_browser.window() as browser:
            browser.get(robot.url)
            eventually(lambda: script(browser, "mapView.marks.length > 0"), "the mark")
            assert script(browser, "mapView.marks[0].number") == evil
            eventually(lambda: evil in text(browser, "#title"), "the name of the robot")
            assert f"{evil}, {evil}" in text(browser, "#state")  # scene and map
            robot.call(lambda simulator: simulator.push(StatusCode(code=1, msg=evil)))
            eventually(lambda: evil in text(browser, "#codes"), "the status code")

            def is_going() -> bool:
                # on a busy machine, the connection may be too slow for a moment
                script(browser, f"controls.run('goMark', {{mark: {evil!r}}})")
                return evil in text(browser, "#state")

            eventually(is_going, "the task")
            script(browser, f"controls.run('fault', {{text: {evil!r}}})")
            eventually(lambda: "unknown fault" in text(browser, "#message"), "the refusal")
            assert script(browser, "document.images.length") == 0
            assert script(browser, "globalThis.hacked === undefined")
            check_console_and_requests(browser, robot)
    finally:
        robot.close()


def test_an_obstacle_appears_and_disappears_by_a_click(
    robot: SimulatedPage, browser: Any, tmp_path: Path
) -> None:
    choose(browser, "obstacle")
    click_at(browser, *_PLACE)
    eventually(lambda: robot.call(lambda s: len(s.chassis.obstacles.names)) == 1, "the obstacle")
    assert robot.call(lambda s: s.chassis.obstacles.clearance(*_PLACE)) == 0.0
    eventually(lambda: script(browser, "mapView.obstacles.length") == 1, "its picture")
    take_picture(browser, "dashboard_obstacle.png", tmp_path)
    click_at(browser, *_PLACE)
    eventually(lambda: robot.call(lambda s: not s.chassis.obstacles.names), "the end")
    eventually(lambda: script(browser, "mapView.obstacles.length") == 0, "the end of its picture")


def test_a_message_moves_no_button(robot: SimulatedPage, browser: Any) -> None:
    place = "document.querySelector('#set-work-mode').getBoundingClientRect().top"
    before = script(browser, place)
    script(browser, "controls.show(false, 'a long reason '.repeat(30))")
    assert script(browser, place) == before


def test_the_mode_lists_follow_the_robot(robot: SimulatedPage, browser: Any) -> None:
    def shown() -> tuple[str, str]:
        return tuple(
            str(element(browser, selector).get_property("value"))
            for selector in ("#control-mode", "#work-mode")
        )

    eventually(lambda: shown() == ("1", "2"), "automatic and task")
    assert "control automatic, work task" in text(browser, "#state")
    element(browser, "#key-switch").click()
    eventually(lambda: shown()[0] == "2", "manual")
    assert "control manual" in text(browser, "#state")
    assert "set Control to automatic on a page with control" in text(browser, "#state")
    element(browser, "#control-mode option[value='3']").click()
    former = script(browser, "mapView.scan")
    eventually(lambda: script(browser, "mapView.scan") != former, "the next scan")
    assert shown()[0] == "3"  # a choice that is not set yet


def test_an_obstacle_far_away_disturbs_nothing(robot: SimulatedPage, browser: Any) -> None:
    script(browser, "controls.run('fault', {text: 'obstacle x=1e300 y=-1e300'})")
    eventually(lambda: script(browser, "mapView.obstacles.length") == 1, "the obstacle")
    scan = "globalThis.former !== mapView.scan"
    script(browser, "globalThis.former = mapView.scan")
    eventually(lambda: script(browser, scan), "the next scan")
    element(browser, "#faults button").click()
    eventually(lambda: script(browser, "mapView.obstacles.length") == 0, "its end")


def test_emergency_stop_key_and_faults(robot: SimulatedPage, browser: Any) -> None:
    element(browser, "#emergency-stop").click()
    eventually(lambda: robot.call(lambda s: s.chassis.readiness.emergency_stop), "the stop")
    eventually(lambda: "the emergency stop is pressed" in text(browser, "#state"), "its display")
    element(browser, "#emergency-stop").click()
    eventually(lambda: not robot.call(lambda s: s.chassis.readiness.emergency_stop), "the release")
    element(browser, "#key-switch").click()
    eventually(lambda: robot.call(lambda s: s.chassis.readiness.key_manual), "the key")
    element(browser, "#clear-faults").click()
    eventually(lambda: not robot.call(lambda s: s.chassis.readiness.key_manual), "the key's end")
    element(browser, "#fault-name").send_keys("lost_localisation")
    element(browser, "#fault button").click()
    eventually(lambda: robot.call(lambda s: s.faults), "the fault")
    eventually(lambda: "lost its localisation" in text(browser, "#state"), "its display")
    element(browser, "#faults button").click()
    eventually(lambda: not robot.call(lambda s: s.faults), "its end")


def test_the_page_comes_back_after_a_lost_link(robot: SimulatedPage, browser: Any) -> None:
    element(browser, "#fault-name").send_keys("off")
    element(browser, "#fault-arguments").send_keys("for=1")
    element(browser, "#fault button").click()
    eventually(lambda: element(browser, "#outdated").is_displayed(), "the warning")
    eventually(lambda: not element(browser, "#outdated").is_displayed(), "the link")


def test_the_page_fits_a_phone(
    robot: SimulatedPage, shared_browser: SharedBrowser, tmp_path: Path
) -> None:
    with shared_browser.window(500, 860) as driver:
        set_screen(driver, 390, 800, mobile=True)
        driver.execute_cdp_cmd(
            "Emulation.setEmulatedMedia",
            {"features": [{"name": "prefers-color-scheme", "value": "dark"}]},
        )
        driver.get(robot.url)
        eventually(lambda: script(driver, "mapView.scan !== null && mapView.image !== null"), "map")
        assert script(driver, "document.documentElement.scrollWidth") <= 390
        shade = "[...mapView.context.getImageData(195, 150, 1, 1).data]"
        assert max(script(driver, f"{shade}.slice(0, 3)")) < 100  # the map is dark, too
        for selector in ("#stop", "#stick", "#tools", "#fit"):
            box = element(driver, selector).rect
            assert 0 <= box["x"] <= 390 - box["width"], selector
            assert box["y"] + box["height"] <= 800, selector
        take_picture(driver, "dashboard_phone.png", tmp_path)
        check_console_and_requests(driver, robot)

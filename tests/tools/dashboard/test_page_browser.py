"""What a person does with the page in a real browser, against a simulated robot."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.tools.dashboard.browsers import (
    SharedBrowser,
    SimulatedPage,
    actions,
    click_at,
    element,
    eventually,
    firefox,
    hold_stick,
    is_driving,
    is_enabled,
    is_stopped_by_zero,
    open_page,
    press,
    script,
    set_screen,
    show,
    text,
    touch,
)
from tests.tools.dashboard.pages import TOO_SLOW
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask, SetRobotPose
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.robot.robot_setting_pb2 import Sound
from woosh_robot_agent.pb.util import task_pb2 as task

pytestmark = pytest.mark.timeout(300)
_REAL_SCENE = Path(__file__).parents[2] / "facts/real_scene"
_PLACE = (1.0, -6.0)
"""A place on the map where the robot can stand, in metres."""


def again_if_slow(driver: Any, do: Callable[[], None], done: Callable[[], Any], what: str) -> None:
    """Do something until a condition is true.

    On a busy machine, the connection to the dashboard may be too slow for a moment.
    """
    do()

    def is_done() -> Any:
        if TOO_SLOW in text(driver, "#answer"):
            do()
        return done()

    eventually(is_done, what)


def go(driver: Any) -> None:
    """Confirm the way that is shown."""
    again_if_slow(
        driver,
        lambda: element(driver, "#go").click(),
        lambda: script(driver, "Boolean(store.answer.value?.task)"),
        "the task",
    )


def test_the_page_shows_the_robot_where_the_simulator_has_it(
    robot: SimulatedPage, browser: Any
) -> None:
    pose = robot.call(lambda simulator: simulator.state.pose)
    shown = eventually(lambda: script(browser, "store.pose.value"), "the pose")
    assert math.dist((shown["x"], shown["y"]), (pose.x, pose.y)) < 0.01
    # the pixels at this place have the colour of the robot

    def is_blue() -> bool:
        red, _, blue, _ = _pixel_of_robot(browser)
        return blue > red + 40

    eventually(is_blue, "the robot in its colour")
    assert "Connected" in text(browser, "#link")
    assert "Robase200" in text(browser, "h1")
    assert "93 %" in text(browser, ".chips")
    show(browser, "state")
    assert "would be accepted" in text(browser, "#new-task")
    assert "nobody" in text(browser, "#facts")


def _pixel_of_robot(browser: Any) -> list[int]:
    x, y = script(
        browser,
        "(({x, y}) => [x, y])(mapCanvas.view.toScreen(store.pose.value.x, store.pose.value.y))",
    )
    return list(
        script(
            browser,
            "((copy) => { copy.drawImage(mapCanvas.canvas, 0, 0); return ["
            f"...copy.getImageData({round(x) - 5}, {round(y)}, 1, 1).data]; }})"
            "(new OffscreenCanvas(2000, 2000).getContext('2d', {willReadFrequently: true}))",
        )
    )


def test_a_press_shows_the_way_and_a_second_one_sends_the_robot(
    robot: SimulatedPage, browser: Any
) -> None:
    def sent() -> int:
        return robot.call(lambda simulator: simulator.counts[full_name(ExecTask)])

    click_at(browser, *_PLACE, drag=(0, -60))  # the direction
    eventually(lambda: " m" in text(browser, "#now .way"), "the length of the way")
    assert len(script(browser, "store.target.value.plan.path")) > 1
    assert sent() == 0
    element(browser, "#dismiss").click()
    assert script(browser, "store.target.value") is None
    click_at(browser, *_PLACE, drag=(0, -60))
    go(browser)
    eventually(lambda: script(browser, "store.path.value.length > 1"), "the path")
    eventually(lambda: re.match(r"To [01]\.\d\d, -[56]\.\d\d m", text(browser, "#now")), "the task")
    assert "You have control" in text(browser, "#owner")

    def is_there() -> bool:
        pose = robot.call(lambda simulator: simulator.state.pose)
        return math.dist((pose.x, pose.y), _PLACE) < 0.15 and abs(pose.theta - math.pi / 2) < 0.15

    eventually(is_there, "the robot to be there")
    show(browser, "tasks")
    eventually(lambda: "Completed" in text(browser, "#ended"), "its end in the list")
    assert "from this page" in text(browser, "#ended")


def test_a_mark_is_found_by_its_name_and_has_a_kind_of_task(
    robot: SimulatedPage, browser: Any
) -> None:
    field = element(browser, "#search")
    field.send_keys("roller conv")
    eventually(lambda: text(browser, "#marks").split()[0] == "K10", "the mark")
    press(browser, "#marks button")
    eventually(lambda: " m" in text(browser, "#now .way"), "the way")
    assert "Roller station" in text(browser, "#now")
    element(browser, "#kind option[value='carry 0']").click()
    element(browser, "#direction option[value='feeding']").click()
    go(browser)
    sent = robot.call(lambda simulator: simulator.last(full_name(ExecTask)))
    assert (sent.mark_no, sent.type, sent.direction) == ("K10", task.kCarry, task.kFeeding)
    # the buttons do something, or are disabled
    show(browser, "tasks")
    eventually(lambda: is_enabled(browser, "#pause"), "the pause")
    for name in ("pause", "continue"):
        again_if_slow(
            browser,
            lambda name=name: press(browser, f".doing #{name}"),
            lambda name=name: f"{name}: accepted" in text(browser, "#answer").lower(),
            name,
        )
        other = "continue" if name == "pause" else "pause"
        eventually(lambda other=other: is_enabled(browser, f".doing #{other}"), other)
        if name == "pause":  # while the emergency stop is pressed, a task cannot go on
            robot.call(lambda simulator: simulator.inject("emergency_stop"))
            eventually(lambda: not is_enabled(browser, ".doing #continue"), "the emergency stop")
            robot.call(lambda simulator: simulator.clear_faults())
            eventually(lambda: is_enabled(browser, ".doing #continue"), "its release")
    press(browser, ".panel #cancel")
    eventually(lambda: "Cancelled" in text(browser, "#ended"), "the end")
    assert not is_enabled(browser, ".panel #cancel")
    press(browser, "#ended button")  # repeat
    go(browser)
    eventually(lambda: "K10" in text(browser, "#running"), "the task again")


def test_charge_goes_to_the_charger(robot: SimulatedPage, browser: Any) -> None:
    press(browser, "#charge")
    eventually(lambda: "C1" in text(browser, "#now"), "the charger")
    go(browser)
    sent = robot.call(lambda simulator: simulator.last(full_name(ExecTask)))
    assert (sent.mark_no, sent.type) == ("C1", task.kCharge)


def test_a_double_click_sends_one_task(robot: SimulatedPage, browser: Any) -> None:
    def sent() -> int:
        return robot.call(lambda simulator: simulator.counts[full_name(ExecTask)])

    press(browser, "#marks li:nth-child(2) button")
    eventually(lambda: " m" in text(browser, "#now .way"), "the way")
    actions(browser).double_click(element(browser, "#go")).perform()
    eventually(lambda: "To A2" in text(browser, "#now"), "the task")
    assert sent() == 1
    # while the answer is pending, later clicks send none either, and the page says so
    press(browser, ".doing #cancel")
    for fault in ("refuse", "lose_answer"):
        robot.call(lambda s, fault=fault: s.inject(fault, type=full_name(ExecTask)))
    press(browser, "#marks li:nth-child(1) button")
    refusal = "the robot has not answered the former command"
    eventually(lambda: press(browser, "#go") or refusal in text(browser, "#answer"), "refusal")
    assert not is_enabled(browser, "#go")
    assert refusal in text(browser, "#now")
    assert sent() == 2


def test_the_pose_is_shown_with_the_laser_before_it_is_told(
    robot: SimulatedPage, browser: Any
) -> None:
    def told() -> Any:
        return robot.call(lambda simulator: simulator.last(full_name(SetRobotPose)))

    show(browser, "map")
    press(browser, "#set-pose")
    for slip in (None, (0, -15)):  # a finger slips
        script(browser, "store.answer.value = null")
        click_at(browser, *_PLACE, drag=slip)
        eventually(lambda: "drag in its direction" in text(browser, "#answer"), "the advice")
        assert not is_enabled(browser, "#confirm")
    click_at(browser, *_PLACE, drag=(0, -60))
    eventually(lambda: "Is the robot here?" in text(browser, "#now"), "the question")
    drawn = script(browser, "(({x, y, theta}) => [x, y, theta])(mapCanvas.picture().scan.pose)")
    assert drawn == pytest.approx([*_PLACE, math.pi / 2], abs=0.05)
    assert told() is None
    clipped = (
        "[...document.querySelectorAll('.doing .act button')]"
        ".filter((each) => each.scrollWidth > each.clientWidth).map((each) => each.innerText)"
    )
    for size in ((1440, 900), (844, 390), (360, 640), (1280, 800)):
        set_screen(browser, *size)
        eventually(lambda size=size: script(browser, "innerWidth") == size[0], "the size")
        assert script(browser, clipped) == [], size
    press(browser, ".doing .act button:first-child")  # turn left
    again_if_slow(browser, lambda: press(browser, "#confirm"), told, "the pose")
    pose = told().pose
    assert math.dist((pose.x, pose.y), _PLACE) < 0.1
    assert pose.theta == pytest.approx(math.pi / 2 + math.radians(1), abs=0.005)
    there = "store.pose.value && Math.hypot(store.pose.value.x - 1, store.pose.value.y + 6) < 0.1"
    eventually(lambda: script(browser, there), "the robot there")
    trail = script(browser, "mapCanvas.trail")
    assert all(math.dist(place, _PLACE) < 0.1 for place in trail), "no line from the former pose"


def test_the_map_is_used_without_a_pointer(robot: SimulatedPage, browser: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    def at_cross() -> list[float]:
        middle = "(({x, y}) => mapCanvas.view.toWorld(x, y))(mapCanvas.view.middle)"
        return list(script(browser, f"(({{x, y}}) => [x, y])({middle})"))

    def enter(*keys: str) -> None:
        actions(browser).send_keys(*keys, Keys.ENTER).perform()

    for size in ((1280, 800), (720, 450)):
        set_screen(browser, *size)
        show(browser, "map")
        element(browser, "#set-pose").send_keys(Keys.ENTER)
        assert script(browser, "document.activeElement.id") == "map"
        assert script(browser, "mapCanvas.picture().cross")
        enter(Keys.ARROW_LEFT)
        place = at_cross()
        enter(Keys.ARROW_UP)
        pose = script(browser, "(({x, y, theta}) => [x, y, theta])(store.draft.value)")
        assert pose == pytest.approx([*place, math.pi / 2], abs=0.01)
        element(browser, "#dismiss").send_keys(Keys.ENTER)
        # the control that was pressed is gone
        eventually(lambda: script(browser, "document.activeElement.matches('.doing')"), "focus")
        element(browser, "[data-tool=measure]").send_keys(Keys.ENTER)
        element(browser, "#map").send_keys(Keys.ENTER)
        actions(browser).key_down(Keys.SHIFT).send_keys(Keys.ARROW_RIGHT).key_up(
            Keys.SHIFT
        ).perform()
        enter(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
        length = "(([one, other]) => other.x - one.x)(store.measured.value)"
        pixels = script(browser, f"{length} * mapCanvas.view.scale")
        assert pixels == pytest.approx(125, abs=0.1)
        assert element(browser, "#keyboard").is_displayed()
    element(browser, "[data-tool=go]").send_keys(Keys.ENTER)
    element(browser, "#map").send_keys("0", Keys.ENTER)
    eventually(lambda: is_enabled(browser, "#go"), "the preview")
    again_if_slow(
        browser,
        lambda: element(browser, "#go").send_keys(Keys.ENTER),
        lambda: script(browser, "document.activeElement.matches('.doing')"),
        "the focus after the control that was pressed",
    )


def test_a_real_scene_whose_map_has_the_id_0_and_tasks_without_a_mark(
    shared_browser: SharedBrowser,
) -> None:
    robot = SimulatedPage(scenes=(_REAL_SCENE,))
    try:
        with shared_browser.window() as browser:
            open_page(browser, robot.url)
            eventually(lambda: "has the id 0" in text(browser, "#notice"), "the doubt")
            press(browser, "#notice button")
            eventually(lambda: not text(browser, "#notice"), "its end")
            ended = TaskProc(robot_task_id=1795612722129, state=task.kCompleted, type=task.kPick)
            robot.call(lambda simulator: simulator.push(ended))
            show(browser, "tasks")
            eventually(lambda: "Pick" in text(browser, "#ended b"), "the task of another program")
            assert "1795612722129" not in text(browser, "#ended")
    finally:
        robot.close()


def switch_map(driver: Any, scene: str) -> None:
    """Let the robot use the map of another scene, as another program may, and find itself there."""
    run = f"connection.command('switchMap', {{scene: {scene!r}, map: {scene!r}}})"
    known = f"store.robot.value.map === {scene!r} && store.map.value.name === {scene!r}"
    eventually(lambda: script(driver, run)["ok"], "the switch of the map")
    eventually(lambda: script(driver, known), "the other map")
    pose = "connection.command('setPose', {x: 1, y: 1, theta: 0, ...store.shownMap.value})"
    eventually(lambda: script(driver, pose)["ok"], "the pose")
    eventually(lambda: script(driver, "store.robot.value.objections.length === 0"), "the robot")


def test_what_was_about_to_be_done_on_a_map_ends_with_it(
    robot: SimulatedPage, browser: Any
) -> None:
    press(browser, "#marks li:nth-child(2) button")
    eventually(lambda: " m" in text(browser, "#now .way"), "the way")
    switch_map(browser, "scenex")
    assert script(browser, "store.target.value") is None
    show(browser, "map")
    press(browser, "#set-pose")
    click_at(browser, 1.0, 1.0, drag=(0, -60))
    eventually(lambda: script(browser, "store.draft.value !== null"), "the pose")
    switch_map(browser, "wooshmap")
    assert script(browser, "store.draft.value") is None
    press(browser, "#dismiss")  # the tool stays, to show the pose on the other map
    former = "store.map.value = {...store.map.value, name: 'scenex', scene: 'scenex'}"

    def is_refused() -> bool:
        # while the picture of the former map is still shown, its places are not sent
        script(browser, former)
        click_at(browser, *_PLACE)
        script(browser, f"({former}, document.querySelector('#go')?.click())")
        return "another map" in text(browser, "#answer")

    eventually(is_refused, "the refusal")
    assert robot.call(lambda simulator: simulator.counts[full_name(ExecTask)]) == 0


def test_repeat_shows_what_is_known_of_the_task_before_it_is_sent(
    robot: SimulatedPage, browser: Any
) -> None:
    def sent() -> int:
        return robot.call(lambda simulator: simulator.counts[full_name(ExecTask)])

    repeat = "#ended li:first-child .quiet"
    give = (
        "connection.command('goMark', {mark: 'A2', type: 'carry', number: 2, direction: 'feeding',"
        " ...store.shownMap.value})"
    )
    show(browser, "tasks")
    again_if_slow(
        browser, lambda: script(browser, give), lambda: text(browser, "#running"), "the task"
    )
    press(browser, "#panel #cancel")
    eventually(lambda: is_enabled(browser, repeat), "its end")
    before = sent()
    press(browser, repeat)
    eventually(lambda: " m" in text(browser, "#now .way"), "the way")
    kind = "document.querySelector('#kind').selectedOptions[0].innerText"
    assert script(browser, kind) == "Carry: unload a trailer or trolley"
    assert script(browser, "document.querySelector('#direction').value") == "feeding"
    assert sent() == before
    go(browser)
    eventually(lambda: sent() == before + 1, "the task")
    again = robot.call(lambda simulator: simulator.last(full_name(ExecTask)))
    assert (again.mark_no, again.type, again.task_type_no) == ("A2", task.kCarry, 2)
    assert again.direction == task.kFeeding
    press(browser, "#panel #cancel")
    eventually(lambda: is_enabled(browser, repeat), "its end")
    switch_map(browser, "scenex")
    assert not is_enabled(browser, repeat)
    title = f"document.querySelector({repeat!r}).title"
    assert script(browser, title) == "A2 is on another map"


def test_a_failed_task_has_its_time_and_its_reason(robot: SimulatedPage, browser: Any) -> None:
    click_at(browser, -5.0, 7.0)  # a wall
    eventually(lambda: "no path" in text(browser, "#now"), "why there is no path")
    go(browser)
    show(browser, "tasks")
    eventually(lambda: "Failed" in text(browser, "#ended"), "the failure")
    eventually(lambda: "navigation did not succeed" in text(browser, "#ended"), "the reason")
    assert ":" in text(browser, "#ended small")  # the time


def test_zoom_pan_fit_measure_and_turn(browser: Any) -> None:
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    def scale() -> float:
        return float(script(browser, "mapCanvas.view.scale"))

    def corners() -> list[list[float]]:
        """The corners of the map, in pixels."""
        return list(
            script(
                browser,
                "mapCanvas.corners(mapCanvas.area).map(({x, y}) => mapCanvas.view.toScreen(x, y))"
                ".map(({x, y}) => [x, y])",
            )
        )

    width, height = script(browser, "[mapCanvas.view.width, mapCanvas.view.height]")
    press(browser, "[data-tool=move]")
    fitted = scale()
    assert all(0 <= x <= width and 0 <= y <= height for x, y in corners())
    press(browser, "#zoom-in")
    assert math.isclose(scale(), 1.4 * fitted)
    press(browser, "#zoom-out")
    assert math.isclose(scale(), fitted)
    # the wheel keeps the place under the pointer
    area = element(browser, "#map")
    x, y = round(width / 2) + 100, round(height / 2) + 50
    before = script(browser, f"mapCanvas.view.toWorld({x}, {y})")
    actions(browser).scroll_from_origin(ScrollOrigin.from_element(area, 100, 50), 0, -400).perform()
    eventually(lambda: scale() > 1.2 * fitted, "the zoom")
    after = script(browser, f"mapCanvas.view.toWorld({x}, {y})")
    assert math.dist((before["x"], before["y"]), (after["x"], after["y"])) < 2 / fitted
    # dragging moves the map with the pointer
    before = script(browser, "mapCanvas.view.toScreen(0, 0)")
    actions(browser).move_to_element(area).click_and_hold().move_by_offset(80, -40).perform()
    actions(browser).release().perform()
    after = script(browser, "mapCanvas.view.toScreen(0, 0)")
    assert math.dist((after["x"] - before["x"], after["y"] - before["y"]), (80, -40)) < 2
    press(browser, "#fit")
    assert math.isclose(scale(), fitted)
    # two fingers zoom and pan, also with a tool that does something else
    press(browser, "[data-tool=go]")
    for kind, spread in (("touchStart", 20), ("touchMove", 40), ("touchMove", 80)):
        touch(browser, kind, *((300 + side * spread, 400) for side in (0, 1)))
    touch(browser, "touchEnd")
    assert scale() > 2 * fitted
    assert script(browser, "store.target.value") is None
    press(browser, "#fit")
    press(browser, "[data-tool=measure]")
    click_at(browser, 0.0, 0.0)
    click_at(browser, 3.0, 4.0)
    ends = script(browser, "store.measured.value.map(({x, y}) => [x, y])")
    assert math.dist(*ends) == pytest.approx(5.0, abs=0.1)
    assert text(browser, "#pointed").startswith(("3.0", "2.9"))
    # the front of the robot at the top: its nose is above its middle
    press(browser, "#layers")
    press(browser, "[name=robotUp]")
    nose = script(
        browser,
        "(({x, y, theta}) => [mapCanvas.view.toScreen(x, y), mapCanvas.view.toScreen("
        "x + Math.cos(theta), y + Math.sin(theta))])(store.pose.value)",
    )
    assert nose[0]["x"] == pytest.approx(nose[1]["x"], abs=1)
    assert nose[1]["y"] < nose[0]["y"]
    # a layer that is off is not drawn
    assert script(browser, "mapCanvas.picture().marks.length") > 0
    press(browser, "[name=marks]")
    assert script(browser, "mapCanvas.picture().marks.length") == 0


def test_the_view_follows_the_robot_until_it_is_dragged(robot: SimulatedPage, browser: Any) -> None:
    def from_middle() -> float:
        at = script(
            browser,
            "(({x, y}) => [x - mapCanvas.view.width / 2, y - mapCanvas.view.height / 2])"
            "(mapCanvas.view.toScreen(store.pose.value.x, store.pose.value.y))",
        )
        return math.hypot(*at)

    press(browser, "[data-tool=move]")
    press(browser, "#follow")
    eventually(lambda: from_middle() < 1.0, "the robot in the middle")
    begin = script(browser, "store.pose.value")
    hold_stick(browser, robot)
    moved = f"Math.hypot(store.pose.value.x - {begin['x']}, store.pose.value.y - {begin['y']})"
    eventually(lambda: script(browser, moved) > 0.1, "the robot to move")
    assert from_middle() < 1.0
    actions(browser).release().perform()
    area = element(browser, "#map")
    actions(browser).move_to_element(area).click_and_hold().move_by_offset(
        80, 0
    ).release().perform()
    assert not script(browser, "store.follow.value")
    assert from_middle() > 50.0


def test_on_another_screen_everything_is_drawn_where_it_is_clicked(browser: Any) -> None:
    for ratio in (1.5, 2):
        metrics = {"width": 1280, "height": 700, "deviceScaleFactor": ratio, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        same = f"Math.abs(mapCanvas.canvas.width - {ratio} * mapCanvas.view.width) <= 1"
        eventually(lambda same=same: script(browser, same), "the pixels")
        drawn = "mapCanvas.context.getTransform().a * mapCanvas.view.width"
        width = script(browser, "mapCanvas.canvas.width")
        assert script(browser, drawn) == pytest.approx(width, abs=1)


def test_escape_stops_and_the_other_keys_do_what_the_focused_control_does(
    robot: SimulatedPage, browser: Any
) -> None:
    from selenium.webdriver.common.keys import Keys

    hold_stick(browser, robot)
    actions(browser).send_keys(Keys.ESCAPE).perform()
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    eventually(lambda: "stopped" in text(browser, "#answer"), "the answer")
    assert not is_driving(robot)  # the stick is still held
    actions(browser).release().perform()
    element(browser, "#zoom-in").send_keys(" ")
    assert script(browser, "document.activeElement.id") == "zoom-in"
    show(browser, "setup")
    field = element(browser, "#speak-text")
    field.send_keys("hello you")
    assert field.get_property("value") == "hello you"
    # the arrow keys drive only after their switch, and never while somebody writes
    arrows = actions(browser).key_down(Keys.ARROW_UP).pause(0.3).key_up(Keys.ARROW_UP)
    before = robot.call(lambda simulator: simulator.state.pose)
    arrows.perform()
    press(browser, "#keyboard")
    field.send_keys(Keys.ARROW_LEFT)
    assert robot.call(lambda simulator: simulator.state.pose) == before
    press(browser, "#keyboard")
    press(browser, "#keyboard")

    def drives() -> bool:
        if not script(browser, "store.held.value !== null"):
            actions(browser).key_up(Keys.ARROW_UP).key_down(Keys.ARROW_UP).perform()
        return is_driving(robot)

    eventually(drives, "the robot to drive")
    actions(browser).key_up(Keys.ARROW_UP).perform()
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    element(browser, "#stop").send_keys("\n")
    eventually(lambda: "stopped" in text(browser, "#answer"), "the answer to the enter key")


def test_modes_speed_limit_and_volume(robot: SimulatedPage, browser: Any) -> None:
    show(browser, "setup")

    def pressed(group: str) -> list[str]:
        return [
            each.text
            for each in browser.find_elements("css selector", f"#{group} [aria-pressed=true]")
        ]

    eventually(
        lambda: (pressed("controlMode"), pressed("workMode")) == (["Automatic"], ["Task"]), ""
    )
    press(browser, "#workMode button:nth-child(2)")
    eventually(lambda: pressed("workMode") == ["Deployment"], "the other mode")
    press(browser, "#workMode button:nth-child(1)")
    element(browser, "#speed-limit option[value='0.3']").click()
    eventually(lambda: script(browser, "store.control.value.speedLimit") == 0.3, "the limit")
    assert script(browser, "store.control.value.limits.linear") == 0.3
    from selenium.webdriver.common.keys import Keys

    element(browser, "#volume").send_keys(Keys.ARROW_RIGHT)
    eventually(lambda: robot.call(lambda s: s.last(full_name(Sound))), "the volume")
    assert robot.call(lambda s: s.last(full_name(Sound)).volume) == 55
    press(browser, "#mute")
    eventually(lambda: robot.call(lambda s: s.last(full_name(Sound)).mute), "silence")
    # the key switch overrides the mode, and the page says what to do
    robot.call(lambda simulator: simulator.inject("key_switch"))
    eventually(lambda: pressed("controlMode") == ["Manual"], "manual")
    assert "manual mode" in text(browser, "#notice")
    assert "key switch" in text(browser, "#notice")


def test_a_map_is_made(robot: SimulatedPage, browser: Any) -> None:
    show(browser, "map")
    press(browser, "#deploy")
    eventually(lambda: is_enabled(browser, "#map-name"), "the name of the map")
    element(browser, "#map-name").send_keys("ground")
    press(browser, "#add-map")
    eventually(
        lambda: "state" and script(browser, "store.robot.value.state") == "mapping", "mapping"
    )
    hold_stick(browser, robot)
    eventually(lambda: script(browser, "store.map.value.resolution > 0"), "the growing map")
    actions(browser).release().perform()
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    press(browser, "#save-map")
    eventually(lambda: "ground" in text(browser, "#maps"), "the new map in the list")
    eventually(lambda: is_enabled(browser, "#collect-mark"), "the next step")
    assert "collect it" in text(browser, "#mapping [aria-current=step]")
    assert script(browser, "document.querySelector('#map-name').value") == ""
    row = next(
        each
        for each in browser.find_elements("css selector", "#maps li")
        if each.text.startswith("ground")
    )
    if "in use" not in row.text:
        row.find_element("css selector", "button").click()
        assert row.find_element("css selector", "b").rect["height"] < 30  # one line
        row.find_element("css selector", "button.primary").click()
    eventually(lambda: script(browser, "store.robot.value.map") == "ground", "the new map in use")


def test_emergency_stop_lost_position_faults_and_obstacles(
    robot: SimulatedPage, browser: Any
) -> None:
    show(browser, "simulator")
    press(browser, "#emergency-stop")
    eventually(lambda: "emergency stop is pressed" in text(browser, "#notice"), "the banner")
    assert "release the button" in text(browser, "#notice")
    assert script(browser, "document.querySelectorAll('.notice').length") == 1
    show(browser, "state")
    eventually(lambda: "emergency stop" in text(browser, "#problems"), "its status code")
    show(browser, "simulator")
    press(browser, "#emergency-stop")
    eventually(lambda: robot.call(lambda s: s.faults == []), "the release")
    element(browser, "#fault-name").send_keys("lost_localisation")
    press(browser, "#begin-fault")
    eventually(lambda: "lost its position" in text(browser, ".notices"), "the banner")
    press(browser, "#notice button")
    assert script(browser, "store.tool.value") == "pose"
    press(browser, "#dismiss")
    press(browser, "#clear-faults")
    eventually(lambda: not robot.call(lambda s: s.faults), "the end of the faults")
    # the map, which nobody has moved, takes the place of the banner
    eventually(lambda: script(browser, "mapCanvas.view.inset.top === 0"), "the end of the banner")
    press(browser, "#obstacle")
    click_at(browser, *_PLACE)
    eventually(lambda: robot.call(lambda s: len(s.chassis.obstacles.names)) == 1, "the obstacle")
    assert robot.call(lambda s: s.chassis.obstacles.clearance(*_PLACE)) == 0.0
    eventually(lambda: script(browser, "mapCanvas.picture().obstacles.length") == 1, "its picture")
    click_at(browser, *_PLACE)
    eventually(lambda: robot.call(lambda s: not s.chassis.obstacles.names), "the end")
    show(browser, "go")  # where no tool is marked that puts obstacles
    assert script(browser, "store.tool.value") == "go"
    # one far away disturbs nothing
    robot.call(lambda simulator: simulator.inject("obstacle", x=1e300, y=-1e300))
    eventually(lambda: script(browser, "mapCanvas.picture().obstacles.length") == 1, "the obstacle")
    script(browser, "globalThis.former = store.scan.value")
    eventually(lambda: script(browser, "globalThis.former !== store.scan.value"), "the next scan")


def test_codes_are_filtered_and_plots_have_the_history(robot: SimulatedPage, browser: Any) -> None:
    show(browser, "state")
    robot.call(lambda simulator: simulator.inject("emergency_stop"))
    eventually(lambda: "emergency stop 1" in text(browser, "#codes"), "the status code")
    found = len(browser.find_elements("css selector", "#codes li"))
    element(browser, "[aria-label=Level] option[value=fault]").click()
    faults = len(browser.find_elements("css selector", "#codes li"))
    assert 0 < faults <= found
    eventually(lambda: len(browser.find_elements("css selector", "#plots canvas")) == 3, "plots")
    eventually(lambda: "93 %" in text(browser, "#plots"), "the battery")


def test_the_language_changes_everywhere(browser: Any) -> None:
    assert text(browser, "#tab-go") == "Go"
    press(browser, "#language")
    eventually(lambda: text(browser, "#tab-go") == "前往", "Chinese")
    assert script(browser, "document.documentElement.lang") == "zh"
    show(browser, "state")
    assert "可以接受新任务" in text(browser, "#new-task")
    browser.refresh()
    eventually(lambda: text(browser, "#tab-go") == "前往", "Chinese, which is remembered")
    press(browser, "#language")
    eventually(lambda: text(browser, "#tab-go") == "Go", "English")


def test_the_page_works_in_firefox(robot: SimulatedPage) -> None:
    with firefox() as driver:
        open_page(driver, robot.url)
        press(driver, "#marks li:nth-child(2) button")
        eventually(lambda: " m" in text(driver, "#now .way"), "the way")
        press(driver, "#dismiss")
        hold_stick(driver, robot)
        assert text(driver, "#owner") == "You have control"
        element(driver, "#stop").click()
        eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
        assert script(driver, "store.held.value === null")
        actions(driver).release().perform()
        click_at(driver, *_PLACE)
        go(driver)
        show(driver, "tasks")
        eventually(lambda: text(driver, "#running"), "the task")
        show(driver, "state")
        eventually(lambda: driver.find_elements("css selector", "#plots canvas"), "the plots")
        press(driver, "#language")
        eventually(lambda: text(driver, "#tab-go") == "前往", "Chinese")

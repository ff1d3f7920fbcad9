"""What a person does with the page in a real browser, against a simulated robot."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.quick_chassis import set_speed
from tests.tools.dashboard.browsers import Browser, SimulatedPage, eventually, firefox, webkit
from tests.tools.dashboard.conftest import Serve
from tests.tools.dashboard.pages import is_driving, is_stopped_by_zero, last
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMap, ExecTask, SetRobotPose, SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.robot.robot_setting_pb2 import Sound
from woosh_robot_agent.pb.util import task_pb2 as task

pytestmark = pytest.mark.timeout(300)
_REAL_SCENE = Path(__file__).parents[2] / "facts/real_scene"
_NAMES = ("#scene", "#map-name")
"""Fields for the names of the scene and of the map."""
_PLACE = (1.0, -6.0)
"""A place on the map where the robot can stand, in metres."""


def count_tasks(robot: SimulatedPage) -> int:
    """Return how many tasks the robot was sent."""
    return robot.counts[full_name(ExecTask)]


def go(browser: Browser) -> None:
    """Confirm the way that is shown, and wait until the robot has accepted the task."""
    browser.press("#go")
    eventually(lambda: browser.script("Boolean(store.answer.value?.task)"), "the task")


_COLLECT_ERRORS = """(window.errors = [],
  console.error = (...parts) => window.errors.push(parts.join(" ")),
  addEventListener("error", ({message}) => window.errors.push(message)),
  addEventListener("unhandledrejection", ({reason}) => window.errors.push(String(reason))))"""
"""Notes the errors from now on; the drivers of Firefox and WebKit have no log of the console."""


def test_a_press_shows_the_way_and_a_second_one_sends_the_robot(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.click_at(*_PLACE, drag=(0, -60))  # the direction
    eventually(lambda: " m" in browser.text("#now .way"), "the length of the way")
    assert len(browser.script("store.target.value.plan.path")) > 1
    assert count_tasks(robot) == 0
    browser.element("#dismiss").click()
    assert browser.script("store.target.value") is None
    browser.click_at(*_PLACE, drag=(0, -60))
    go(browser)
    eventually(lambda: browser.script("store.path.value.length > 1"), "the path")
    eventually(lambda: re.match(r"To [01]\.\d\d, -[56]\.\d\d m", browser.text("#now")), "the task")
    assert "You have control" in browser.text("#owner")
    set_speed(robot, 10.0)

    def is_there() -> bool:
        pose = robot.state.pose
        return math.dist((pose.x, pose.y), _PLACE) < 0.15 and abs(pose.theta - math.pi / 2) < 0.15

    eventually(is_there, "the robot to be there")
    browser.show("tasks")
    eventually(lambda: "Completed" in browser.text("#ended"), "its end in the list")
    assert "from this page" in browser.text("#ended")


_DRIVEN = """((path, steps, lost) => {
  const along = [];
  let from = 0;
  for (let at = 0; at <= steps; at++) {
    if (at > lost && at < lost + 30) continue;
    const [x, y] = place(at / 10);
    const rest = store.restOfPath(path, {x, y: y + 0.1}, from);
    from = rest.along;
    along.push([at / 10, rest.along, rest.along + rest.length]);
  }
  return along;
  function place(metres) {
    for (let index = 1; ; index++) {
      const [[x, y], [a, b]] = [path[index - 1], path[index]];
      const length = Math.hypot(a - x, b - y);
      if (metres <= length) return [x + (a - x) * metres / length, y + (b - y) * metres / length];
      metres -= length;
    }
  }
})"""
"""Follows a path beside it, from place to place, once with a gap; lists what is seen of it."""


def test_the_path_begins_at_the_robot_even_where_it_crosses_itself(
    robot: SimulatedPage, browser: Browser
) -> None:
    # ahead, round to the left, across the first metres, and back to the beginning
    loop = [[0, 0], [6, 0], [6, 0], [6, 4], [3, 4], [3, -3], [0, -3], [0, 0]]
    for gap in (1000, 70):
        for driven, seen, whole in browser.script(f"{_DRIVEN}({loop}, 259, {gap})"):
            assert seen == pytest.approx(driven, abs=0.3)
            assert whole == pytest.approx(26.0)
    back = "store.restOfPath([[0, 0], [10, 0]], {x: 3, y: 0}, 8).along"  # somebody drove it back
    assert browser.script(back) == pytest.approx(3.0)
    begin = browser.script("store.pose.value")
    browser.click_at(*_PLACE)
    go(browser)
    left = "Number(store.wayLeft.value)"
    first = eventually(lambda: browser.script(left), "the way left")
    # in one script: between two, on a busy machine, the robot may arrive
    less = f"0 < {left} && {left} < {first} - 0.2"
    driven = f"Math.hypot(path[0][0] - {begin['x']}, path[0][1] - {begin['y']}) > 0.5"
    both = f"(({{path}}) => {less} && {driven})(mapCanvas.picture())"
    eventually(lambda: browser.script(both), "less of it, drawn from where the robot is")
    robot.inject("lost_localisation")
    eventually(lambda: browser.script("mapCanvas.picture().lost"), "the lost position")
    assert "to go" not in browser.text("#now")
    assert browser.script("mapCanvas.picture().path === store.path.value")


def test_a_task_has_the_kind_and_the_direction_that_were_chosen(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.element("#search").send_keys("roller conv")
    eventually(lambda: browser.text("#marks").split()[0] == "K10", "the mark")
    browser.press("#marks button")
    eventually(lambda: " m" in browser.text("#now .way"), "the way")
    assert "Roller station" in browser.text("#now")
    browser.element("#kind option[value='carry 0']").click()
    browser.element("#direction option[value='feeding']").click()
    # a direction belongs to the kind of task for which it was chosen
    browser.element("#kind option[value='pick 0']").click()
    eventually(lambda: not browser.elements("#direction"), "the end of the direction")
    go(browser)
    sent = last(robot, ExecTask)
    assert (sent.mark_no, sent.type) == ("K10", task.kPick)
    assert sent.direction == task.kDirectionUndefined
    browser.press(".doing #cancel")
    browser.press("#charge")
    eventually(lambda: "C1" in browser.text("#now"), "the charger")
    go(browser)
    sent = last(robot, ExecTask)
    assert (sent.mark_no, sent.type) == ("C1", task.kCharge)


def test_what_is_begun_while_an_answer_is_awaited_is_not_forgotten_with_it(
    browser: Browser,
) -> None:
    def press(button: str, begin: str, what: str) -> None:
        """Press a button, begin something else at once, and wait for the answer to the button."""
        browser.script(f"(document.querySelector('{button}').click(), {begin})")
        eventually(lambda: f"{what}: accepted" in browser.text("#answer"), "the answer")

    draft = "store.draft.value = {...store.pose.value}"
    browser.press("[data-tool=move]")
    browser.script(f"(store.tool.value = 'pose', {draft})")
    eventually(lambda: browser.is_enabled("#confirm"), "the confirmation")
    press("#confirm", draft, "Set pose")
    assert browser.script("[store.tool.value, store.draft.value !== null]") == ["pose", True]
    browser.press("#dismiss")
    browser.choose_mark()
    press("#go", "document.querySelector('#marks li:nth-child(3) button').click()", "Go")
    assert browser.script("store.target.value?.mark") == browser.text("#marks li:nth-child(3) b")


def test_a_double_click_sends_one_task(robot: SimulatedPage, browser: Browser) -> None:
    browser.choose_mark()
    browser.actions().double_click(browser.element("#go")).perform()
    eventually(lambda: "To A2" in browser.text("#now"), "the task")
    assert count_tasks(robot) == 1
    # while the answer is pending, later clicks send none either, and the page says so
    browser.press(".doing #cancel")
    for fault in ("refuse", "lose_answer"):
        robot.inject(fault, type=full_name(ExecTask))
    browser.press("#marks li:nth-child(1) button")
    refusal = "the robot has not answered the former command"
    eventually(lambda: browser.press("#go") or refusal in browser.text("#answer"), "refusal")
    assert not browser.is_enabled("#go")
    assert refusal in browser.text("#now")
    assert count_tasks(robot) == 2


def test_the_pose_is_shown_with_the_laser_before_it_is_told(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.show("map")
    browser.press("#set-pose")
    for slip in (None, (0, -15)):  # a finger slips
        browser.script("store.answer.value = null")
        browser.click_at(*_PLACE, drag=slip)
        eventually(lambda: "drag in its direction" in browser.text("#answer"), "the advice")
        assert not browser.is_enabled("#confirm")
    browser.click_at(*_PLACE, drag=(0, -60))
    eventually(lambda: "Is the robot here?" in browser.text("#now"), "the question")
    drawn = browser.script("(({x, y, theta}) => [x, y, theta])(mapCanvas.picture().scan.pose)")
    assert drawn == pytest.approx([*_PLACE, math.pi / 2], abs=0.05)
    assert last(robot, SetRobotPose) is None
    clipped = (
        "[...document.querySelectorAll('.doing .act button')]"
        ".filter((each) => each.scrollWidth > each.clientWidth).map((each) => each.innerText)"
    )
    for size in ((1440, 900), (844, 390), (360, 640), (1280, 800)):
        browser.resize(*size)
        assert browser.script(clipped) == [], size
    browser.press(".doing .act button:first-child")  # turn left
    browser.press("#confirm")
    pose = eventually(lambda: last(robot, SetRobotPose), "the pose").pose
    assert math.dist((pose.x, pose.y), _PLACE) < 0.1
    assert pose.theta == pytest.approx(math.pi / 2 + math.radians(1), abs=0.005)
    there = "store.pose.value && Math.hypot(store.pose.value.x - 1, store.pose.value.y + 6) < 0.1"
    eventually(lambda: browser.script(there), "the robot there")
    trail = browser.script("mapCanvas.trail")
    assert all(math.dist(place, _PLACE) < 0.1 for place in trail), "no line from the former pose"


def test_the_map_is_used_without_a_pointer(robot: SimulatedPage, browser: Browser) -> None:
    from selenium.webdriver.common.keys import Keys

    def at_cross() -> list[float]:
        middle = "(({x, y}) => mapCanvas.view.toWorld(x, y))(mapCanvas.view.middle)"
        return list(browser.script(f"(({{x, y}}) => [x, y])({middle})"))

    def enter(*keys: str) -> None:
        browser.actions().send_keys(*keys, Keys.ENTER).perform()

    browser.resize(720, 450)
    browser.show("map")
    browser.element("#set-pose").send_keys(Keys.ENTER)
    assert browser.script("document.activeElement.id") == "map"
    assert browser.script("mapCanvas.picture().cross")
    enter(Keys.ARROW_LEFT)
    place = at_cross()
    enter(Keys.ARROW_UP)
    pose = browser.script("(({x, y, theta}) => [x, y, theta])(store.draft.value)")
    assert pose == pytest.approx([*place, math.pi / 2], abs=0.01)
    browser.element("#dismiss").send_keys(Keys.ENTER)
    # the control that was pressed is gone
    eventually(lambda: browser.script("document.activeElement.matches('.doing')"), "focus")
    browser.element("[data-tool=measure]").send_keys(Keys.ENTER)
    browser.element("#map").send_keys(Keys.ENTER)
    browser.actions().key_down(Keys.SHIFT).send_keys(Keys.ARROW_RIGHT).key_up(Keys.SHIFT).perform()
    enter(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    length = "(([one, other]) => other.x - one.x)(store.measured.value)"
    pixels = browser.script(f"{length} * mapCanvas.view.scale")
    assert pixels == pytest.approx(125, abs=0.1)
    assert browser.element("#keyboard").is_displayed()
    # shortcuts of the browser do nothing to the map
    view = "[mapCanvas.view.scale, mapCanvas.view.centre]"
    before = browser.script(view)
    for key, held in (("+", "ctrlKey"), ("0", "metaKey"), ("ArrowLeft", "altKey")):
        event = f"new KeyboardEvent('keydown', {{key: '{key}', {held}: true, cancelable: true}})"
        assert browser.script(f"document.querySelector('#map').dispatchEvent({event})")
    assert browser.script(view) == before
    browser.element("[data-tool=go]").send_keys(Keys.ENTER)
    browser.element("#map").send_keys("0", Keys.ENTER)
    eventually(lambda: browser.is_enabled("#go"), "the preview")
    browser.element("#go").send_keys(Keys.ENTER)
    # the control that was pressed is gone
    eventually(lambda: browser.script("document.activeElement.matches('.doing')"), "focus")


def test_a_real_scene_whose_map_has_the_id_0_and_tasks_without_a_mark(window: Browser) -> None:
    with SimulatedPage(scenes=(_REAL_SCENE,)) as robot:
        window.open(robot.url)
        eventually(lambda: "has the id 0" in window.text("#notice"), "the doubt")
        window.press("#notice button")
        eventually(lambda: not window.text("#notice"), "its end")
        ended = TaskProc(robot_task_id=1795612722129, state=task.kCompleted, type=task.kPick)
        robot.push(ended)
        window.show("tasks")
        eventually(lambda: "Pick" in window.text("#ended b"), "the task of another program")
        assert "1795612722129" not in window.text("#ended")


def test_what_was_about_to_be_done_on_a_map_ends_with_it(
    robot: SimulatedPage, browser: Browser
) -> None:
    def switch_map(scene: str) -> None:
        """Use the map of another scene, as another program may, and find itself there."""
        run = f"connection.command('switchMap', {{scene: {scene!r}, map: {scene!r}}})"
        known = f"store.robot.value.map === {scene!r} && store.map.value.name === {scene!r}"
        assert browser.script(run)["ok"]
        eventually(lambda: browser.script(known), "the other map")
        pose = "connection.command('setPose', {x: 1, y: 1, theta: 0, ...store.shownMap.value})"
        eventually(lambda: browser.script(pose)["ok"], "the pose")
        eventually(lambda: browser.script("store.robot.value.objections.length === 0"), "the robot")

    browser.choose_mark()
    switch_map("scenex")
    assert browser.script("store.target.value") is None
    browser.show("map")
    browser.press("#set-pose")
    browser.click_at(1.0, 1.0, drag=(0, -60))
    eventually(lambda: browser.script("store.draft.value !== null"), "the pose")
    switch_map("wooshmap")
    assert browser.script("store.draft.value") is None
    browser.press("#dismiss")  # the tool stays, to show the pose on the other map
    former = "store.map.value = {...store.map.value, name: 'scenex', scene: 'scenex'}"

    def is_refused() -> bool:
        # while the picture of the former map is still shown, its places are not sent
        browser.script(former)
        browser.click_at(*_PLACE)
        browser.script(f"({former}, document.querySelector('#go')?.click())")
        return "another map" in browser.text("#answer")

    eventually(is_refused, "the refusal")
    assert count_tasks(robot) == 0


def test_without_the_map_that_the_robot_uses_the_former_one_is_gone(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.hold_stick(lambda: browser.script("mapCanvas.trail.length > 2"))
    browser.release()
    robot.refuse(full_name(SceneData), "the scene is damaged")
    switch = "connection.command('switchMap', {scene: 'scenex', map: 'scenex2'})"
    eventually(lambda: browser.script(switch)["ok"], "the switch of the map")
    eventually(lambda: "No map" in browser.text("#notice"), "the banner")
    assert browser.script("[mapCanvas.area, mapCanvas.keepout]") == [None, None]
    assert browser.script("mapCanvas.trail.length") < 2
    assert not browser.elements("#marks li")
    pose = "connection.command('setPose', {x: 1, y: 1, theta: 0, ...store.shownMap.value})"
    eventually(lambda: browser.script(pose)["ok"], "the pose")
    eventually(lambda: browser.script("store.pose.value.y") == 1.0, "the pose in the page")
    browser.click_at(2.0, 1.0)
    eventually(lambda: " m" in browser.text("#now .way"), "the way")
    assert not browser.is_enabled("#go")
    assert "The robot's map is not loaded" in browser.text("#now")
    browser.show("map")
    assert not browser.is_enabled("#set-pose")
    robot.clear_faults()
    browser.wait_for_map()
    assert browser.is_enabled("#set-pose")
    browser.show("go")  # this map has no charger
    assert not browser.is_enabled("#charge")
    assert "no charger" in browser.text("#no-charger")


def test_repeat_shows_what_is_known_of_the_task_before_it_is_sent(
    robot: SimulatedPage, browser: Browser
) -> None:
    def move_mark(simulator: Any) -> None:
        area = simulator.chassis.map
        moved = replace(area.marks["A2"], pose=area.marks["A1"].pose)
        marks = {**area.marks, "A2": moved}
        simulator.chassis.change_map(marks=marks)

    repeat = "#ended li:first-child .quiet"
    give = (
        "connection.command('goMark', {mark: 'A2', type: 'carry', number: 2, direction: 'feeding',"
        " ...store.shownMap.value})"
    )
    browser.show("tasks")
    assert browser.script(give)["ok"]
    eventually(lambda: browser.text("#running"), "the task")
    browser.press(".doing #cancel")
    browser.press(repeat)
    eventually(lambda: " m" in browser.text("#now .way"), "the way")
    kind = "document.querySelector('#kind').selectedOptions[0].innerText"
    assert browser.script(kind) == "Carry: unload a trailer or trolley"
    assert browser.script("document.querySelector('#direction').value") == "feeding"
    assert count_tasks(robot) == 1
    go(browser)
    again = last(robot, ExecTask)
    assert (again.mark_no, again.type, again.task_type_no) == ("A2", task.kCarry, 2)
    assert (count_tasks(robot), again.direction) == (2, task.kFeeding)
    title = f"document.querySelector({repeat!r}).title"
    eventually(lambda: "Repeat is off" in browser.script(title), "why it is off")
    assert "Repeat is off" in browser.text("#panel")
    browser.press(".doing #cancel")
    browser.press(repeat)
    eventually(lambda: browser.is_enabled("#go"), "Go")
    # a change of the map ends what was chosen, and what can be repeated
    robot.call(move_mark)
    eventually(lambda: not browser.is_enabled("#go"), "the end of what was chosen")
    assert browser.script("store.target.value") is None
    eventually(lambda: browser.elements(repeat), "the list")
    assert not browser.is_enabled(repeat)
    assert browser.script(title) == "A2 is on another map, or the map was changed"


def test_zoom_pan_fit_measure_and_turn(browser: Browser) -> None:
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    def scale() -> float:
        return float(browser.script("mapCanvas.view.scale"))

    width, height = browser.script("[mapCanvas.view.width, mapCanvas.view.height]")
    browser.press("[data-tool=move]")
    fitted = scale()
    assert all(0 <= x <= width and 0 <= y <= height for x, y in browser.map_corners())
    browser.press("#zoom-in")
    assert math.isclose(scale(), 1.4 * fitted)
    browser.press("#zoom-out")
    assert math.isclose(scale(), fitted)
    # the wheel keeps the place under the pointer
    area = browser.element("#map")
    x, y = round(width / 2) + 100, round(height / 2) + 50
    before = browser.script(f"mapCanvas.view.toWorld({x}, {y})")
    browser.actions().scroll_from_origin(
        ScrollOrigin.from_element(area, 100, 50), 0, -400
    ).perform()
    eventually(lambda: scale() > 1.2 * fitted, "the zoom")
    after = browser.script(f"mapCanvas.view.toWorld({x}, {y})")
    assert math.dist((before["x"], before["y"]), (after["x"], after["y"])) < 2 / fitted
    # dragging moves the map with the pointer
    before = browser.script("mapCanvas.view.toScreen(0, 0)")
    browser.actions().move_to_element(area).click_and_hold().move_by_offset(80, -40).perform()
    browser.release()
    after = browser.script("mapCanvas.view.toScreen(0, 0)")
    assert math.dist((after["x"] - before["x"], after["y"] - before["y"]), (80, -40)) < 2
    browser.press("#fit")
    assert math.isclose(scale(), fitted)
    # two fingers zoom and pan, also with a tool that does something else
    browser.press("[data-tool=go]")
    for kind, spread in (("touchStart", 20), ("touchMove", 40), ("touchMove", 80)):
        browser.touch(kind, *((300 + side * spread, 400) for side in (0, 1)))
    browser.touch("touchEnd")
    assert scale() > 2 * fitted
    assert browser.script("store.target.value") is None
    browser.press("#fit")
    browser.press("[data-tool=measure]")
    browser.click_at(0.0, 0.0)
    browser.click_at(3.0, 4.0)
    ends = browser.script("store.measured.value.map(({x, y}) => [x, y])")
    assert math.dist(*ends) == pytest.approx(5.0, abs=0.1)
    assert browser.text("#pointed").startswith(("3.0", "2.9"))
    # the front of the robot at the top: its nose is above its middle
    browser.press("#layers")
    browser.press("[name=robotUp]")
    nose = browser.script(
        "(({x, y, theta}) => [mapCanvas.view.toScreen(x, y), mapCanvas.view.toScreen("
        "x + Math.cos(theta), y + Math.sin(theta))])(store.pose.value)",
    )
    assert nose[0]["x"] == pytest.approx(nose[1]["x"], abs=1)
    assert nose[1]["y"] < nose[0]["y"]
    # a layer that is off is not drawn
    assert browser.script("mapCanvas.picture().marks.length") > 0
    browser.press("[name=marks]")
    assert browser.script("mapCanvas.picture().marks.length") == 0


def test_the_view_follows_the_robot_until_it_is_dragged(
    robot: SimulatedPage, browser: Browser
) -> None:
    def from_middle() -> float:
        at = browser.script(
            "(({x, y}, middle) => [x - middle.x, y - middle.y])(mapCanvas.view.toScreen("
            "store.pose.value.x, store.pose.value.y), mapCanvas.view.middle)",
        )
        return math.hypot(*at)

    browser.press("#follow")
    eventually(lambda: from_middle() < 1.0, "the robot in the middle")
    # a press means the place where it began, though the map moves meanwhile
    width, height = browser.script("[mapCanvas.view.width, mapCanvas.view.height]")
    place = browser.script(f"mapCanvas.view.toWorld({width / 2 + 80}, {height / 2 - 60})")
    area = browser.element("#map")
    press = browser.actions().move_to_element_with_offset(area, 80, -60).click_and_hold()
    press.move_by_offset(0, -40).perform()  # northwards
    browser.script("store.pose.value = {...store.pose.value, x: store.pose.value.x + 1}")
    browser.release()
    target = browser.script("store.target.value.pose")
    assert math.dist((target["x"], target["y"]), (place["x"], place["y"])) < 0.1
    assert math.isclose(target["theta"], math.pi / 2, abs_tol=0.1)
    browser.press("[data-tool=move]")
    # the robot moves, and the map with it
    begin = browser.script("store.pose.value")
    browser.drive(robot)
    moved = f"Math.hypot(store.pose.value.x - {begin['x']}, store.pose.value.y - {begin['y']})"
    eventually(lambda: browser.script(moved) > 0.1, "the robot to move")
    browser.release()
    eventually(lambda: from_middle() < 1.0, "the robot in the middle")
    # the middle is that of the part which the panel leaves free
    browser.resize(390, 844)
    whole = browser.script("mapCanvas.view.middle.y")
    browser.show("state")
    eventually(lambda: browser.script("mapCanvas.view.middle.y") < whole, "the panel")
    eventually(lambda: from_middle() < 1.0, "the robot in the middle")
    # everything is drawn where it is clicked
    browser.resize(1280, 700, 1.5)
    same = "Math.abs(mapCanvas.canvas.width - 1.5 * mapCanvas.view.width) <= 1"
    eventually(lambda: browser.script(same), "the pixels")
    drawn = "mapCanvas.context.getTransform().a * mapCanvas.view.width - mapCanvas.canvas.width"
    assert abs(browser.script(drawn)) <= 1
    eventually(lambda: from_middle() < 1.0, "the robot in the middle")
    browser.actions().drag_and_drop_by_offset(area, 80, 0).perform()
    assert not browser.script("store.follow.value")
    assert from_middle() > 50.0


def test_escape_stops_and_the_other_keys_do_what_the_focused_control_does(
    robot: SimulatedPage, browser: Browser
) -> None:
    from selenium.webdriver.common.keys import Keys

    browser.drive(robot)
    browser.actions().send_keys(Keys.ESCAPE).perform()
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    eventually(lambda: "stopped" in browser.text("#answer"), "the answer")
    assert not is_driving(robot)  # the stick is still held
    browser.release()
    browser.element("#zoom-in").send_keys(" ")
    assert browser.script("document.activeElement.id") == "zoom-in"
    browser.show("setup")
    field = browser.element("#speak-text")
    field.send_keys("hello you")
    assert field.get_property("value") == "hello you"
    # Esc while an input method composes text is no stop
    browser.script("store.answer.value = null")
    compose = "new KeyboardEvent('keydown', {key: 'Escape', bubbles: true, isComposing: true})"
    browser.script(f"document.activeElement.dispatchEvent({compose})")
    assert not browser.script("store.isPending('stop')")
    assert browser.text("#answer") == ""
    # the arrow keys drive only after their switch, and never while somebody writes
    arrows = browser.actions().key_down(Keys.ARROW_UP).pause(0.3).key_up(Keys.ARROW_UP)
    before = robot.state.pose
    arrows.perform()
    browser.press("#keyboard")
    field.send_keys(Keys.ARROW_LEFT)
    assert robot.state.pose == before
    browser.script("store.answer.value = null")
    browser.element("#stop").send_keys("\n")
    eventually(lambda: "stopped" in browser.text("#answer"), "the answer to the enter key")


def test_modes_speed_limit_and_volume(robot: SimulatedPage, browser: Browser) -> None:
    from selenium.webdriver.common.keys import Keys

    def pressed(group: str) -> list[str]:
        return [each.text for each in browser.elements(f"#{group} [aria-pressed=true]")]

    browser.show("setup")
    eventually(lambda: pressed("controlMode") == ["Automatic"], "the control mode")
    eventually(lambda: pressed("workMode") == ["Task"], "the work mode")
    browser.press("#workMode button:nth-child(2)")
    eventually(lambda: pressed("workMode") == ["Deployment"], "the other mode")
    browser.element("#speed-limit option[value='0.3']").click()
    eventually(lambda: browser.script("store.control.value.limits.linear") == 0.3, "the limit")
    # the last of several choices within a moment
    browser.script(
        """["0.1", "", "0.1"].forEach((value) => {
          const list = document.querySelector("#speed-limit");
          list.value = value;
          list.dispatchEvent(new Event("change", {bubbles: true}));
        })"""
    )
    eventually(lambda: browser.script("connection.replies.size === 0"), "the answers")
    known = "[store.control.value.speedLimit, document.querySelector('#speed-limit').value]"
    eventually(lambda: browser.script(known) == [0.1, "0.1"], "the last choice")
    browser.element("#volume").send_keys(Keys.ARROW_RIGHT)
    eventually(lambda: last(robot, Sound), "the volume")
    assert last(robot, Sound).volume == 55
    browser.press("#mute")
    eventually(lambda: last(robot, Sound).mute, "silence")
    assert last(robot, Sound).volume == 55
    eventually(lambda: browser.script("store.robot.value.sound.volume") == 55, "the report")
    robot.refuse(full_name(Sound), "not now")
    browser.element("#volume").send_keys(Keys.ARROW_RIGHT)
    eventually(lambda: "not now" in browser.text("#answer"), "the refusal")
    volume = "document.querySelector('#volume').value"
    eventually(lambda: browser.script(volume) == "55", "the former volume")


def test_the_form_of_a_map_is_of_the_chosen_robot(serve: Serve, window: Browser) -> None:
    def fields() -> list[str]:
        return [str(window.script(f"document.querySelector({each!r}).value")) for each in _NAMES]

    served = serve({}, {"robot_id": 30002, "scenes": (_REAL_SCENE,)})
    window.open(served.url)
    window.show("map")
    window.press("#deploy")
    eventually(lambda: window.is_enabled("#scene"), "the form")
    for each in _NAMES:
        window.element(each).send_keys("x")
    window.press("#add-map")
    eventually(lambda: window.script("store.robot.value.state") == "mapping", "mapping")
    served.robots[0].inject("delay", seconds=4.0, type=full_name(BuildMap))
    window.press("#save-map")
    window.element("#robots option:nth-child(2)").click()
    window.press("#deploy")
    eventually(lambda: window.is_enabled("#scene"), "the form")
    assert fields() == [window.script("store.robot.value.scene"), ""]
    assert fields() != ["wooshmap", ""]
    eventually(lambda: window.script("store.pending.value.size === 0"), "the end of the save")
    assert window.text("#mapping [aria-current=step]").startswith("Name the map")


def test_a_map_is_begun_only_if_the_robot_can_and_switched_by_no_double_press(
    robot: SimulatedPage, browser: Browser
) -> None:
    def state() -> tuple[bool, bool, str]:
        on = [browser.is_enabled(each) for each in ("#add-map", "#update-map")]
        return on[0], on[1], browser.text("#mapping-off")

    def name(scene: str, area: str) -> None:
        for selector, text in zip(_NAMES, (scene, area), strict=True):
            browser.element(selector).clear()
            browser.element(selector).send_keys(text)

    browser.show("map")
    browser.press("#deploy")
    eventually(lambda: browser.is_enabled("#map-name"), "the form")
    unnamed = "Both are off until the scene and the map have a name."
    assert state() == (False, False, unnamed)
    for names, on, reason in (
        (("wooshmap", "wooshmap"), (False, True), "New map is off"),  # the map in use
        (("scenex", "scenex"), (False, False), "does not use it"),
        (("hall", "ground"), (True, False), "Improve this map is off"),  # a new map
    ):
        name(*names)
        eventually(lambda on=on: state()[:2] == on, reason)
        assert reason in state()[2]
    switch = "#maps li:not(.chosen) button"
    browser.actions().double_click(browser.element(switch)).perform()
    assert not browser.is_enabled("#maps .asks .primary")
    eventually(lambda: browser.is_enabled("#maps .asks .primary"), "the confirmation")
    assert robot.counts[full_name(SwitchMap)] == 0
    browser.press("#maps .asks .primary")
    eventually(lambda: robot.counts[full_name(SwitchMap)] == 1, "the switch")


def test_a_map_is_made(robot: SimulatedPage, browser: Browser) -> None:
    discard = ".steps [aria-current] .act :last-child"
    browser.show("map")
    browser.press("#deploy")
    eventually(lambda: browser.is_enabled("#map-name"), "the name of the map")
    browser.element("#scene").clear()
    for selector, text in zip(_NAMES, ("hall", "ground"), strict=True):
        browser.element(selector).send_keys(text)
    browser.press("#add-map")
    eventually(lambda: browser.script("store.robot.value.state") == "mapping", "mapping")
    browser.drive(robot)
    eventually(lambda: browser.script("store.map.value.resolution > 0"), "the growing map")
    browser.release()
    eventually(lambda: browser.text("#now").startswith("The robot is making a map"), "the state")
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    eventually(lambda: browser.is_enabled(discard), "the choice")
    robot.inject("delay", seconds=2.0, type=full_name(BuildMap))
    browser.press("#save-map")
    eventually(lambda: browser.text("#mapping-ends") == "The map is being saved", "the save")
    assert not browser.is_enabled(discard)
    eventually(lambda: "ground" in browser.text("#maps"), "the new map in the list")
    eventually(lambda: browser.is_enabled("#collect-mark"), "the next step")
    eventually(lambda: "Collect a mark" in browser.text("#mapping [aria-current=step]"), "its name")
    # the next map is in the scene that the robot uses now
    fields = "['#scene', '#map-name'].map((each) => document.querySelector(each).value)"
    eventually(lambda: browser.script(fields) == ["hall", ""], "the new scene")
    # a page that does not know whether a map was made urges to nothing
    browser.driver.refresh()
    browser.show("map")
    eventually(lambda: browser.is_enabled("#collect-mark"), "the page to be loaded again")
    assert not browser.elements("#mapping [aria-current=step], #mapping .primary")
    eventually(lambda: browser.script("store.robot.value.map") == "ground", "the new map in use")


def test_faults_and_obstacles_of_the_simulator(robot: SimulatedPage, browser: Browser) -> None:
    browser.show("simulator")
    browser.press("#emergency-stop")
    eventually(lambda: "emergency stop is pressed" in browser.text("#notice"), "the banner")
    browser.show("state")
    eventually(lambda: "emergency stop 1" in browser.text("#codes"), "its status code")
    found = len(browser.elements("#codes li"))
    browser.element("[aria-label=Level] option[value=fault]").click()
    assert 0 < len(browser.elements("#codes li")) <= found
    browser.show("simulator")
    browser.press("#emergency-stop")
    eventually(lambda: robot.faults == [], "the release")
    browser.element("#fault-name").send_keys("lost_localisation")
    browser.press("#begin-fault")
    eventually(lambda: "lost its position" in browser.text(".notices"), "the banner")
    browser.press("#notice button")
    assert browser.script("store.tool.value") == "pose"
    browser.press("#dismiss")
    browser.press("#clear-faults")
    eventually(lambda: not robot.faults, "the end of the faults")
    browser.press("#obstacle")
    browser.click_at(*_PLACE)
    eventually(lambda: browser.script("mapCanvas.picture().obstacles.length") == 1, "its picture")
    walls = robot.call(lambda s: s.chassis.obstacles.walls)
    assert walls
    assert all(wall.distance(*_PLACE) < 0.5 for wall in walls)
    browser.click_at(*_PLACE)
    eventually(lambda: robot.call(lambda s: not s.chassis.obstacles.names), "the end")
    browser.show("go")  # where no tool is marked that puts obstacles
    assert browser.script("store.tool.value") == "go"
    # one far away disturbs nothing
    robot.inject("obstacle", x=1e300, y=-1e300)
    eventually(lambda: browser.script("mapCanvas.picture().obstacles.length") == 1, "the obstacle")
    browser.script("globalThis.former = store.scan.value")
    eventually(lambda: browser.script("globalThis.former !== store.scan.value"), "the next scan")
    # another dashboard at the address, which takes the robot for a real one
    browser.show("simulator")
    browser.press("#obstacle")
    robot.close_page()
    with robot.serving(port=urlsplit(robot.url).port):
        eventually(lambda: not browser.elements("#tab-simulator"), "the end of the tab")
        eventually(lambda: browser.elements("#marks button"), "the tab in its place")
        assert browser.script("[store.tool.value, mapCanvas.picture().obstacles.length]") == [
            "move",
            0,
        ]


@pytest.mark.parametrize("start", [firefox, webkit])
def test_the_page_works_in_other_browsers(
    robot: SimulatedPage, start: Callable[[], AbstractContextManager[Browser]]
) -> None:
    with start() as browser:
        from selenium.webdriver.common.keys import Keys

        browser.open(robot.url)
        browser.script(_COLLECT_ERRORS)
        for text in ("前往", "Go"):
            browser.press("#language")
            eventually(lambda: browser.text("#tab-go") == text, text)  # noqa: B023
        browser.choose_mark()
        go(browser)
        browser.show("tasks")
        eventually(lambda: browser.text("#running"), "the task")
        browser.press("#stop")
        eventually(lambda: "task cancelled" in browser.text("#answer"), "the robot to stop")
        eventually(lambda: not browser.text("#running"), "the end of the task")
        browser.show("state")
        eventually(lambda: browser.elements("#plots canvas"), "the plots")
        browser.drive(robot)
        assert browser.text("#owner") == "You have control"
        browser.release()
        eventually(lambda: is_stopped_by_zero(robot), "the robot to stop after the release")
        browser.drive(robot)
        browser.actions().send_keys(Keys.ESCAPE).perform()
        eventually(lambda: is_stopped_by_zero(robot), "the robot to stop after Esc")
        assert browser.script("store.held.value === null")
        browser.release()
        assert browser.script("window.errors") == []

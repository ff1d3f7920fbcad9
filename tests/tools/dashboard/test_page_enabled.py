"""What can be pressed when, what a repeated press does, and what the page says meanwhile."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.asynchronous import TIMEOUT
from tests.quick_chassis import set_speed
from tests.tools.dashboard.browsers import Browser, SimulatedPage, are_apart, eventually
from tests.tools.dashboard.pages import page
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, InitRobot
from woosh_robot_agent.pb.util import action_pb2 as action

pytestmark = pytest.mark.timeout(300)
_GO = "connection.command('goMark', {mark: 'A2', ...store.shownMap.value})"
_BOXES = """Object.fromEntries(["#pause", "#continue", "#cancel", "#go"].map((id) =>
  [id, document.querySelector(".doing " + id)?.getBoundingClientRect().toJSON()]))"""
_SIZES = ((360, 640), (844, 390), (1024, 768), (1440, 900))
"""Sizes of the screens of a phone, of one that is turned, of a tablet and of a notebook."""
_CLIPPED = """[...document.querySelectorAll(".doing .act button")]
  .filter((each) => each.scrollWidth > each.clientWidth).map((each) => each.innerText)"""


def start_task(browser: Browser, robot: SimulatedPage) -> None:
    """Send the robot on a long way."""
    set_speed(robot, 0.05)
    eventually(lambda: browser.script(_GO)["ok"], "the task")
    eventually(lambda: browser.is_enabled(".doing #pause"), "the pause")


def pause_a_task(browser: Browser, robot: SimulatedPage) -> None:
    """Send the robot on a long way, and pause that."""
    start_task(browser, robot)
    eventually(lambda: browser.script("connection.command('pause')")["ok"], "the pause")
    eventually(lambda: browser.is_enabled(".doing #continue"), "the paused task")
    set_speed(robot, 1.0)


def is_stick_off(browser: Browser) -> bool:
    return "off" in browser.element("#stick").get_attribute("class").split()


def enter(browser: Browser, *, repeat: bool) -> None:
    event = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13, "text": "\r"}
    down = {"type": "keyDown", "autoRepeat": repeat, **event}
    browser.send("Input.dispatchKeyEvent", **down)


def test_a_repeated_press_of_pause_starts_nothing(robot: SimulatedPage, window: Browser) -> None:
    def continued() -> bool:
        orders = [each.message for each in robot.received]
        return ActionOrder(order=action.kContinue) in orders

    def boxes() -> Any:
        """Return where the buttons are, by the size of the screen."""
        found = {}
        for size in _SIZES:
            window.resize(*size)
            found[size] = window.script(_BOXES)
            assert window.script(_CLIPPED) == []
        return found

    window.open(robot.url)
    window.show("go")
    window.choose_mark()
    before = boxes()
    start_task(window, robot)
    during = boxes()
    for size in _SIZES:
        assert during[size]["#go"] is None
        for other in ("#pause", "#cancel"):
            assert are_apart(before[size]["#go"], during[size][other]), (size, other)
    pause = window.middle(".doing #pause")
    window.touch("touchStart", pause)
    window.touch("touchEnd")
    eventually(lambda: window.is_enabled(".doing #continue"), "the pause")
    window.touch("touchStart", pause)
    window.touch("touchEnd")
    assert not window.is_enabled(".doing #pause")
    assert boxes() == during
    # a key that is held presses once, whatever it finds
    scale = window.script("mapCanvas.view.scale")
    window.script("document.querySelector('#zoom-in').focus()")
    for repeat in (False, True, True):
        enter(window, repeat=repeat)
    assert window.script("mapCanvas.view.scale") == pytest.approx(1.4 * scale)
    assert window.script("store.robot.value.task.state") == "paused"
    assert not continued()
    window.press(".doing #continue")
    eventually(lambda: window.is_enabled(".doing #pause"), "the task to go on")
    assert continued()


def test_an_unconfirmed_stop_is_an_alarm_of_the_robot(
    robot: SimulatedPage, browser: Browser
) -> None:
    start_task(browser, robot)  # takes the control
    set_speed(robot, 1.0)  # it turns first
    eventually(lambda: browser.script("store.pose.value.linear") > 0, "the robot to drive")
    other = robot.enter(page(robot.url))
    freeze = robot.inject("freeze")
    stop = robot.begin(other.command("stop"))
    eventually(lambda: browser.text("#answer").endswith("stopping"), "the stop")
    eventually(lambda: browser.text("#alarm"), "the alarm of the other's stop")
    assert browser.text("#answer").endswith("if the robot moves, press its emergency stop")
    assert browser.script("answer.scrollWidth <= answer.clientWidth"), "it is not cut"
    browser.press("#alarm summary")
    assert "NOT STOPPED: the chassis did not answer the request" in browser.text("#alarm")
    assert "woosh." not in browser.text("#alarm")
    assert not stop.result(TIMEOUT)[0]
    set_speed(robot, 20.0)
    freeze.clear()
    eventually(lambda: not browser.text("#alarm"), "the robot to be seen to stand still")
    assert "The alarm has ended" in browser.text("#answer")


def test_a_go_is_off_while_it_is_sent_and_a_task_keeps_its_buttons(
    robot: SimulatedPage, browser: Browser
) -> None:
    set_speed(robot, 0.05)
    robot.mute(full_name(ExecTask))
    browser.choose_mark()
    browser.press("#go")
    eventually(lambda: "waiting for the answer" in browser.text("#answer"), "the sending")
    eventually(lambda: browser.is_enabled(".doing #pause"), "the task")
    assert "To A2" in browser.text("#now")
    browser.click_at(1.0, -6.0)
    eventually(lambda: re.search(r"[01]\.\d\d, -[56]\.\d\d m", browser.text("#now")), "the place")
    assert browser.is_enabled(".doing #pause")
    assert browser.is_enabled(".doing #cancel")
    assert not browser.is_enabled("#go")
    eventually(lambda: "executing a task" in browser.text("#now"), "why it is off")


def check_whole(browser: Browser) -> None:
    """Check that the dock shows all of its texts on screens of several sizes."""
    for size in ((360, 740), (1024, 768), (1440, 900)):
        browser.resize(*size)
        hidden = browser.script("now.scrollHeight - now.clientHeight")
        assert hidden == 0, (size, browser.text("#now"))


def test_the_dock_shows_all_of_its_texts(robot: SimulatedPage, browser: Browser) -> None:
    start_task(browser, robot)
    keeps = "Pause keeps the task; STOP ends it"
    eventually(lambda: re.search(rf"\d m to go · {keeps}$", browser.text("#now")), "the way left")
    assert "cancel its task" in browser.element("#stop").get_attribute("title")
    assert "set" in browser.element(".doing #cancel").get_attribute("title")
    check_whole(browser)
    browser.script("connection.command('speedLimit', {limit: 0.2})")
    eventually(lambda: "Speed limit: 0.2 m/s." in browser.text("#now"), "the speed limit")
    browser.script("store.control.value = {...store.control.value, speedRefusal: 'not today'}")
    eventually(lambda: "Speed limit refused" in browser.text("#now"), "the refusal")
    check_whole(browser)
    browser.show("state")
    assert "not taken the limit: not today" in browser.text("#facts")
    browser.script("connection.command('speedLimit', {limit: null})")
    eventually(lambda: "limit" not in browser.text("#now"), "its end")
    # a target beside the task, which can be dropped
    boxes = browser.script(_BOXES)
    browser.click_at(1.0, -6.0)
    eventually(lambda: browser.script("store.target.value?.plan?.length > 0"), "its way")
    eventually(lambda: "executing a task" in browser.text("#now"), "why Go is off")
    check_whole(browser)
    assert browser.script(_BOXES) == boxes
    title, dismiss = (browser.element(each).rect for each in ("#now b", "#dismiss"))
    assert title["y"] + title["height"] <= dismiss["y"]
    browser.press("#dismiss")
    assert browser.script("store.target.value === null && !document.querySelector('#dismiss')")
    browser.press(".doing #pause")
    eventually(lambda: browser.is_enabled(".doing #continue"), "the paused task")
    assert keeps in browser.text("#now")
    # a long name leaves room for the state
    browser.resize(640, 360)
    name = "{...each, to: 'the mark with a very long name in the hall of the north'}"
    browser.script(f"(store.tasks.value = store.tasks.value.map((each) => ({name})))")
    eventually(lambda: "very long name" in browser.text("#now"), "the name")
    now, state = (browser.element(each).rect for each in ("#now", "#now p"))
    assert state["y"] + state["height"] <= now["y"] + now["height"]


def test_what_became_of_a_go_replaces_its_acceptance(
    robot: SimulatedPage, browser: Browser
) -> None:
    set_speed(robot, 0.3)
    for place, plan, became in (
        ((-5.0, 7.0), "no path", "navigation did not succeed"),  # a wall
        ((1.0, -6.0), " m", "Cancelled"),
    ):
        browser.click_at(*place)
        eventually(lambda plan=plan: plan in browser.text("#now .way"), plan)
        eventually(lambda: browser.is_enabled("#go"), "the preview")
        browser.press("#go")
        if became == "Cancelled":
            eventually(lambda: "accepted" in browser.text("#answer"), "the task")
            assert browser.script("connection.command('cancel')")["ok"]
        eventually(lambda b=became: b in browser.text("#answer"), became)
    browser.show("tasks")
    failed = browser.text("#ended li:nth-child(2)")
    assert "Failed" in failed
    assert "navigation did not succeed" in failed
    assert ":" in browser.text("#ended li:nth-child(2) small")  # the time


def test_the_dock_says_what_the_banner_says(robot: SimulatedPage, browser: Browser) -> None:
    assert "Press a place" in browser.text("#now")
    assert "Hold the stick" in browser.text("#now")
    for fault, says, remedy, drives in (
        ("emergency_stop", "The emergency stop is pressed", "release the button", False),
        ("key_switch", "The robot is in manual mode", "Turn the key switch", True),
        ("lost_localisation", "The robot has lost its position", "Choose Set pose", True),
    ):
        pause_a_task(browser, robot)
        hindrance = robot.inject(fault)
        eventually(lambda: not browser.is_enabled(".doing #continue"), "Continue to be off")
        assert is_stick_off(browser) != drives
        assert remedy in browser.text("#now")
        # what the stick may need is not hidden
        assert browser.element("#slow").is_displayed()
        assert browser.element("#keyboard").is_displayed()
        browser.press(".doing #cancel")
        eventually(lambda: "Paused" not in browser.text("#now"), "the end of the task")
        assert says in browser.text("#now")
        assert remedy in browser.text("#now")
        assert "Press a place" not in browser.text("#now")
        assert browser.script("mapCanvas.picture().lost") == (fault == "lost_localisation")
        assert ("Hold the stick" in browser.text("#now")) == (fault == "lost_localisation")
        browser.click_at(1.0, -6.0)
        eventually(lambda says=says: says in browser.text("#now"), "the reason in the preview")
        assert not browser.is_enabled("#go")
        browser.press("#dismiss")
        hindrance.clear()
        eventually(lambda: "Press a place" in browser.text("#now"), "the end of the fault")


def test_the_dock_says_what_drives_and_what_is_off_says_why(
    robot: SimulatedPage, browser: Browser
) -> None:
    def with_change(name: str, change: str, shown: str) -> Any:
        """Return the value of an expression after a change of what the robot has reported."""
        changed = f"store.{name}.value = {{...store.{name}.value, {change}}}"
        later = "setTimeout(() => requestAnimationFrame(() => setTimeout(resolve)))"
        return browser.script(f"({changed}, new Promise((resolve) => {later}).then(() => {shown}))")

    browser.press("#layers")
    assert "this page shows one robot" in browser.text(".menu")
    # the menu closes when the focus leaves it
    browser.script("document.querySelector('.menu label:last-child').click()")
    assert browser.element(".menu").is_displayed()
    browser.script("document.querySelector('.menu input').focus()")
    browser.script("document.querySelector('#map').focus()")
    eventually(lambda: browser.script("!document.querySelector('.menu')"), "its end")
    assert browser.is_enabled("#park")
    why = "document.querySelector('#no-parking').innerText"
    assert "no parking place" in with_change("map", "marks: []", why)
    for name, title in (("strafe", "Driven by strafe"), ("unknown", "Ready"), ("nobody", "Ready")):
        driver = f"driver: {{name: '{name}', detail: ''}}"
        assert with_change("control", driver, "document.querySelector('#now b').innerText") == title
    busy = "state: 'task', task: null, objections: [{name: 'busy'}]"
    accepted = with_change("robot", busy, "now.innerText")
    assert "executing a task" in accepted
    assert "Hold the stick" not in accepted  # the report of the task comes later
    browser.show("setup")
    assert not browser.is_enabled("#speak")
    browser.element("#speak-text").send_keys("hello")
    eventually(lambda: browser.is_enabled("#speak"), "a text to speak")
    start_task(browser, robot)
    browser.show("map")
    assert not browser.is_enabled("#maps li:not(.chosen) button")
    browser.press(".doing #pause")
    eventually(lambda: browser.is_enabled(".doing #continue"), "the paused task")
    deployed = "objections: [{name: 'deployment'}]"
    assert "in deployment mode" in with_change("robot", deployed, "now.innerText")
    # a task that waits for an obstacle is not paused
    waits = "task: {...store.robot.value.task, state: 'held up'}, objections: []"
    texts = (
        "[now.innerText, ...['#set-pose', '#stick'].map((of) => document.querySelector(of).title)]"
    )
    assert all("drives on by itself" in each for each in with_change("robot", waits, texts))


def test_what_ends_a_motion_is_on_though_the_page_is_no_longer_updated(
    robot: SimulatedPage, browser: Browser
) -> None:
    start_task(browser, robot)
    order = "{id: '', node: 'hall', nodesLeft: 1, paused: false, errors: []}"
    browser.script(
        "void (connection.onPart = ((former) => (name, data) => former(name,"
        " name === 'link' ? {...data, good: false, state: 'failed'} :"
        f" name === 'fleet' ? data.map((card) => ({{...card, order: {order}}})) : data))"
        "(connection.onPart))"
    )
    browser.script("connection.onPart('fleet', store.fleet.value)")
    eventually(lambda: browser.script("store.link.value.state === 'failed'"), "the failure")
    browser.show("fleet")
    eventually(lambda: browser.elements("#panel.old .card"), "the old cards")
    assert browser.is_enabled(".doing #pause")
    assert browser.is_enabled(".doing #cancel")


def test_a_mark_ends_set_pose_and_keep_pose_shows_that_it_runs(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.show("map")
    browser.press("#set-pose")
    eventually(lambda: browser.text("#confirm"), "the tool")
    browser.show("go")
    browser.choose_mark()
    assert browser.script("store.tool.value") == "go"
    for fault in ("refuse", "lose_answer"):
        robot.inject(fault, type=full_name(InitRobot))
    robot.inject("lost_localisation")
    eventually(lambda: "Choose Set pose" in browser.text("#notice"), "the banner")
    browser.show("map")
    browser.press("#keep-pose")
    eventually(lambda: "Keep pose: sent" in browser.text("#answer"), "the sending")
    assert not browser.is_enabled("#keep-pose")
    assert "Set pose" not in browser.text("#notice")


def test_a_press_that_was_aimed_at_continue_starts_no_new_drive(
    robot: SimulatedPage, browser: Browser
) -> None:
    start_task(browser, robot)
    eventually(lambda: browser.script("connection.command('pause')")["ok"], "the pause")
    eventually(lambda: browser.is_enabled(".doing #continue"), "the paused task")
    browser.click_at(1.0, -6.0)
    eventually(lambda: "m" in browser.text("#now p ~ p"), "the next place")
    browser.script(
        """new MutationObserver(() => {
          const go = document.querySelector("#go");
          if (go) globalThis.wasOff ??= [go, document.querySelector("#dismiss")]
            .every((each) => each.matches(":disabled"));
        }).observe(document.body, {childList: true, subtree: true})""",
    )
    eventually(lambda: browser.script("connection.command('cancel')")["ok"], "the cancel")
    eventually(lambda: browser.is_enabled("#go"), "Go, a moment later")
    assert browser.script("globalThis.wasOff")


def test_a_way_is_planned_anew_once_the_robot_stands_elsewhere(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.click_at(1.0, -6.0)
    eventually(lambda: browser.is_enabled("#go"), "the preview")
    eventually(lambda: browser.script("store.target.value.plan?.length > 0"), "the way")
    browser.script("globalThis.former = store.target.value.plan.path[0]")
    moved = "Math.hypot(store.pose.value.x - former[0], store.pose.value.y - former[1]) > 0.6"
    browser.hold_stick(lambda: browser.script(moved), "0.6 m")
    browser.release()
    near = """store.target.value.plan?.path?.length &&
      Math.hypot(store.pose.value.x - store.target.value.plan.path[0][0],
                 store.pose.value.y - store.target.value.plan.path[0][1]) < 0.3"""
    eventually(lambda: browser.script(near), "the way from where the robot stands")

"""What can be pressed when, what a repeated press does, and what the page says meanwhile."""

from __future__ import annotations

import asyncio
import re
from typing import Any

import pytest

from tests.tools.dashboard.browsers import (
    SharedBrowser,
    SimulatedPage,
    actions,
    click_at,
    element,
    eventually,
    hold_stick,
    is_enabled,
    open_page,
    press,
    script,
    set_screen,
    show,
    text,
    touch,
)
from tests.tools.dashboard.pages import page
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, InitRobot
from woosh_robot_agent.pb.util import action_pb2 as action

pytestmark = pytest.mark.timeout(300)
_GO = "connection.command('goMark', {mark: 'A2', ...store.shownMap.value})"
_BOXES = """Object.fromEntries(["#pause", "#continue", "#cancel", "#go"].map((id) =>
  [id, document.querySelector(".doing " + id)?.getBoundingClientRect().toJSON()]))"""
_CLIPPED = """[...document.querySelectorAll(".doing .act button")]
  .filter((each) => each.scrollWidth > each.clientWidth).map((each) => each.innerText)"""


def start_task(driver: Any, robot: SimulatedPage) -> None:
    """Send the robot on a long way."""
    robot.call(lambda simulator: setattr(simulator, "speed", 0.05))
    eventually(lambda: script(driver, _GO)["ok"], "the task")
    eventually(lambda: is_enabled(driver, ".doing #pause"), "the pause")


def middle(driver: Any, selector: str) -> tuple[float, float]:
    box = element(driver, selector).rect
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def enter(driver: Any, *, repeat: bool) -> None:
    event = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13, "text": "\r"}
    down = {"type": "keyDown", "autoRepeat": repeat, **event}
    driver.execute_cdp_cmd("Input.dispatchKeyEvent", down)


@pytest.mark.parametrize(("width", "height"), [(360, 640), (844, 390), (1024, 768), (1440, 900)])
def test_a_repeated_press_of_pause_starts_nothing(
    robot: SimulatedPage, shared_browser: SharedBrowser, width: int, height: int
) -> None:
    def continued() -> bool:
        orders = robot.call(lambda simulator: [each.message for each in simulator.received])
        return ActionOrder(order=action.kContinue) in orders

    with shared_browser.window() as driver:
        set_screen(driver, width, height, mobile=width < 1000)
        open_page(driver, robot.url)
        show(driver, "go")
        press(driver, "#marks li:nth-child(2) button")
        eventually(lambda: is_enabled(driver, "#go"), "the preview")
        go = script(driver, _BOXES)["#go"]
        start_task(driver, robot)
        boxes = script(driver, _BOXES)
        assert boxes["#go"] is None
        for other in ("#pause", "#cancel"):
            ends = (("left", "right"), ("top", "bottom"))
            box = boxes[other]
            assert any(go[b] <= box[a] or box[b] <= go[a] for a, b in ends), other
        assert script(driver, _CLIPPED) == []
        pause = middle(driver, ".doing #pause")
        touch(driver, "touchStart", pause)
        touch(driver, "touchEnd")
        eventually(lambda: is_enabled(driver, ".doing #continue"), "the pause")
        touch(driver, "touchStart", pause)
        touch(driver, "touchEnd")
        assert script(driver, _BOXES) == boxes
        assert not is_enabled(driver, ".doing #pause")
        # a key that is held presses once, whatever it finds
        scale = script(driver, "mapCanvas.view.scale")
        script(driver, "document.querySelector('#zoom-in').focus()")
        for repeat in (False, True, True):
            enter(driver, repeat=repeat)
        assert script(driver, "mapCanvas.view.scale") == pytest.approx(1.4 * scale)
        assert script(driver, "store.robot.value.task.state") == "paused"
        assert not continued()
        press(driver, ".doing #continue")
        eventually(lambda: is_enabled(driver, ".doing #pause"), "the task to go on")
        assert continued()
        assert script(driver, _BOXES) == boxes


@pytest.mark.parametrize("reload", [False, True])
def test_an_unconfirmed_stop_is_an_alarm_of_the_robot(
    robot: SimulatedPage, browser: Any, reload: bool
) -> None:
    def watch() -> None:
        eventually(lambda: text(browser, "#answer").endswith("stopping"), "the stop")
        eventually(lambda: text(browser, "#alarm"), "the alarm of the other's stop")
        assert "NOT STOPPED" in text(browser, "#answer")
        if reload:
            browser.refresh()
            eventually(lambda: text(browser, "#alarm"), "the alarm after a reload")

    async def stop_meanwhile() -> None:
        async with page(robot.url) as other:
            robot.call(lambda simulator: simulator.inject("freeze"))
            ok, _ = (await asyncio.gather(other.command("stop"), asyncio.to_thread(watch)))[0]
            assert not ok

    start_task(browser, robot)  # takes the control
    eventually(lambda: script(browser, "store.pose.value.linear") > 0, "the robot to drive")
    asyncio.run(stop_meanwhile())
    robot.call(lambda simulator: (setattr(simulator, "speed", 1.0), simulator.clear_faults()))
    eventually(lambda: not text(browser, "#alarm"), "the robot to be seen to stand still")
    assert reload or "The alarm has ended" in text(browser, "#answer")


def test_a_go_is_off_while_it_is_sent_and_a_task_keeps_its_buttons(
    robot: SimulatedPage, browser: Any
) -> None:
    robot.call(lambda simulator: setattr(simulator, "speed", 0.05))
    robot.call(lambda simulator: simulator.mute(full_name(ExecTask)))
    press(browser, "#marks li:nth-child(2) button")
    eventually(lambda: is_enabled(browser, "#go"), "the preview")
    press(browser, "#go")
    eventually(lambda: "waiting for the answer" in text(browser, "#answer"), "the sending")
    eventually(lambda: is_enabled(browser, ".doing #pause"), "the task")
    assert "To A2" in text(browser, "#now")
    click_at(browser, 1.0, -6.0)
    eventually(lambda: re.search(r"[01]\.\d\d, -[56]\.\d\d m", text(browser, "#now")), "the place")
    assert is_enabled(browser, ".doing #pause")
    assert is_enabled(browser, ".doing #cancel")
    assert not is_enabled(browser, "#go")
    eventually(lambda: "executing a task" in text(browser, "#now"), "why it is off")


def test_what_became_of_a_go_replaces_its_acceptance(robot: SimulatedPage, browser: Any) -> None:
    robot.call(lambda simulator: setattr(simulator, "speed", 0.3))
    for place, became in (((-5.0, 7.0), "navigation did not succeed"), ((1.0, -6.0), "Cancelled")):
        click_at(browser, *place)
        eventually(lambda: is_enabled(browser, "#go"), "the preview")
        press(browser, "#go")
        if became == "Cancelled":
            eventually(lambda: "accepted" in text(browser, "#answer"), "the task")
            assert script(browser, "connection.command('cancel')")["ok"]
        eventually(lambda b=became: b in text(browser, "#answer"), became)


@pytest.mark.parametrize(
    ("fault", "says", "drives"),
    [
        ("emergency_stop", "The emergency stop is pressed", False),
        ("key_switch", "The robot is in manual mode", True),
        ("lost_localisation", "The robot has lost its position", True),
        ("freeze", "No data for", False),
        ("off", "Connection lost", False),
    ],
)
def test_the_dock_says_what_the_banner_says(
    robot: SimulatedPage, browser: Any, fault: str, says: str, drives: bool
) -> None:
    assert "Press a place" in text(browser, "#now")
    assert "Hold the stick" in text(browser, "#now")
    start_task(browser, robot)
    eventually(lambda: script(browser, "connection.command('pause')")["ok"], "the pause")
    eventually(lambda: is_enabled(browser, ".doing #continue"), "the paused task")
    robot.call(lambda simulator: setattr(simulator, "speed", 1.0))
    robot.call(lambda simulator: simulator.inject(fault))
    eventually(lambda: not is_enabled(browser, ".doing #continue"), "Continue to be off")
    assert is_enabled(browser, ".doing #cancel") == (fault != "off")
    stick = element(browser, "#stick")
    assert ("off" in stick.get_attribute("class").split()) != drives
    show(browser, "setup")
    assert is_enabled(browser, "#mute") == (fault not in ("freeze", "off"))
    if fault in ("freeze", "off"):
        assert "last known state" in text(browser, "#now")
        return
    press(browser, ".doing #cancel")
    eventually(lambda: says in text(browser, "#now"), "the reason")
    assert "Press a place" not in text(browser, "#now")
    assert ("Hold the stick" in text(browser, "#now")) == (fault == "lost_localisation")
    click_at(browser, 1.0, -6.0)
    eventually(lambda: says in text(browser, "#now"), "the reason in the preview")
    assert not is_enabled(browser, "#go")


def test_what_another_viewer_controls_is_off(robot: SimulatedPage, browser: Any) -> None:
    def see() -> None:
        eventually(lambda: not is_enabled(browser, ".doing #pause"), "Pause to be off")
        assert "off" in element(browser, "#stick").get_attribute("class").split()
        assert is_enabled(browser, "#stop")
        show(browser, "state")
        eventually(lambda: "0.5 m/s" in text(browser, "#facts"), "the other's speed limit")

    async def control_meanwhile() -> None:
        async with page(robot.url) as other:
            script(browser, "connection.send({do: 'release'})")
            await other.until(lambda parts: parts["control"]["owner"] is None)
            await other.command("speedLimit", limit=0.5)
            await asyncio.to_thread(see)

    show(browser, "setup")
    assert not is_enabled(browser, "#speak")
    element(browser, "#speak-text").send_keys("hello")
    eventually(lambda: is_enabled(browser, "#speak"), "a text to speak")
    start_task(browser, robot)
    asyncio.run(control_meanwhile())
    eventually(lambda: is_enabled(browser, ".doing #pause"), "the end of the other's control")
    press(browser, ".doing #cancel")
    eventually(lambda: "Speed limit: 0.5 m/s" in text(browser, "#now"), "the limit in the dock")


def test_what_is_off_says_why(robot: SimulatedPage, browser: Any) -> None:
    def shown_with(name: str, change: str, selector: str) -> str:
        """Return a text that the page shows after a change of what the robot has reported."""
        shown = f"document.querySelector('{selector}')?.innerText"
        changed = f"store.{name}.value = {{...store.{name}.value, {change}}}"
        later = "setTimeout(() => requestAnimationFrame(() => setTimeout(resolve)))"
        return str(
            script(browser, f"({changed}, new Promise((resolve) => {later}).then(() => {shown}))")
        )

    press(browser, "#layers")
    assert "this page shows one robot" in text(browser, ".menu")
    press(browser, "#layers")
    assert is_enabled(browser, "#park")
    assert "no parking place" in shown_with("map", "marks: []", "#no-parking")
    start_task(browser, robot)
    show(browser, "map")
    assert not is_enabled(browser, "#maps li:not(.chosen) button")
    press(browser, ".doing #pause")
    eventually(lambda: is_enabled(browser, ".doing #continue"), "the paused task")
    deployed = "objections: [{name: 'deployment'}]"
    assert "in deployment mode" in shown_with("robot", deployed, "#now")


def test_a_button_that_is_off_looks_off_and_a_mark_ends_set_pose(browser: Any) -> None:
    colours = """((button) => {
      const {backgroundColor, color} = getComputedStyle(button);
      const probe = document.body.appendChild(document.createElement("i"));
      probe.style.cssText = "background: var(--raised); color: var(--faint)";
      const wanted = {...getComputedStyle(probe)};
      probe.remove();
      return backgroundColor === wanted.backgroundColor && color === wanted.color;
    })(document.querySelector("%s"))"""
    show(browser, "map")
    press(browser, "#set-pose")
    eventually(lambda: text(browser, "#confirm"), "the tool")
    assert script(browser, colours % "#confirm")
    show(browser, "go")
    press(browser, "#marks li:nth-child(2) button")
    eventually(lambda: is_enabled(browser, "#go"), "the way")
    assert not script(browser, colours % "#go")
    assert script(browser, "store.tool.value") == "go"


def test_keep_pose_shows_that_it_runs(robot: SimulatedPage, browser: Any) -> None:
    for fault in ("refuse", "lose_answer"):
        robot.call(lambda s, fault=fault: s.inject(fault, type=full_name(InitRobot)))
    robot.call(lambda simulator: simulator.inject("lost_localisation"))
    eventually(lambda: "Choose Set pose" in text(browser, "#notice"), "the banner")
    show(browser, "map")
    press(browser, "#keep-pose")
    eventually(lambda: "Keep pose: sent" in text(browser, "#answer"), "the sending")
    assert not is_enabled(browser, "#keep-pose")
    assert "Set pose" not in text(browser, "#notice")


def test_a_press_that_was_aimed_at_continue_starts_no_new_drive(
    robot: SimulatedPage, browser: Any
) -> None:
    start_task(browser, robot)
    eventually(lambda: script(browser, "connection.command('pause')")["ok"], "the pause")
    eventually(lambda: is_enabled(browser, ".doing #continue"), "the paused task")
    click_at(browser, 1.0, -6.0)
    eventually(lambda: "m" in text(browser, "#now p + p"), "the next place")
    script(
        browser,
        """new MutationObserver(() => {
          const go = document.querySelector("#go");
          if (go) globalThis.wasOff ??= [go, document.querySelector("#dismiss")]
            .every((each) => each.matches(":disabled"));
        }).observe(document.body, {childList: true, subtree: true})""",
    )
    eventually(lambda: script(browser, "connection.command('cancel')")["ok"], "the cancel")
    eventually(lambda: is_enabled(browser, "#go"), "Go, a moment later")
    assert script(browser, "globalThis.wasOff")


def test_a_way_is_planned_anew_once_the_robot_stands_elsewhere(
    robot: SimulatedPage, browser: Any
) -> None:
    click_at(browser, 1.0, -6.0)
    eventually(lambda: is_enabled(browser, "#go"), "the preview")
    eventually(lambda: script(browser, "store.target.value.plan?.length > 0"), "the way")
    script(browser, "globalThis.former = store.target.value.plan.path[0]")
    hold_stick(browser, robot)
    moved = "Math.hypot(store.pose.value.x - former[0], store.pose.value.y - former[1]) > 0.6"
    eventually(lambda: hold_stick(browser, robot) or script(browser, moved), "0.6 m")
    actions(browser).release().perform()
    near = """store.target.value.plan?.path?.length &&
      Math.hypot(store.pose.value.x - store.target.value.plan.path[0][0],
                 store.pose.value.y - store.target.value.plan.path[0][1]) < 0.3"""
    eventually(lambda: script(browser, near), "the way from where the robot stands")


def test_the_menu_of_layers_closes_when_the_focus_leaves_it(browser: Any) -> None:
    press(browser, "#layers")
    eventually(lambda: element(browser, ".menu").is_displayed(), "the menu")
    script(browser, "document.querySelector('.menu label:last-child').click()")
    assert element(browser, ".menu").is_displayed()
    script(browser, "document.querySelector('.menu input').focus()")
    script(browser, "document.querySelector('#map').focus()")
    eventually(lambda: script(browser, "!document.querySelector('.menu')"), "its end")

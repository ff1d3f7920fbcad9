"""The page in a browser when something goes wrong: drivers go away, links are lost or slow."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.quick_chassis import quick_config
from tests.tools.dashboard.browsers import (
    SharedBrowser,
    SimulatedPage,
    actions,
    check_console_and_requests,
    chromium,
    element,
    eventually,
    hold_stick,
    is_driving,
    is_enabled,
    is_stopped_by_zero,
    open_page,
    press,
    script,
    show,
    text,
    wait_for_map,
)
from tests.tools.dashboard.pages import TOO_SLOW, page, program
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, Twist
from woosh_robot_agent.simulator import SimulatorThread

pytestmark = pytest.mark.timeout(300)


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


def test_a_killed_browser_stops_the_robot(robot: SimulatedPage) -> None:
    with contextlib.suppress(Exception), chromium() as driver:  # its end fails after the kill
        open_page(driver, robot.url)
        hold_stick(driver, robot)
        os.kill(driver.capabilities["goog:processID"], signal.SIGKILL)
        eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    assert is_stopped_by_zero(robot)


def test_a_stop_of_another_operator_ends_the_press(robot: SimulatedPage, browser: Any) -> None:
    async def stop() -> tuple[bool, str]:
        async with page(robot.url) as other:
            return await other.command("stop")

    hold_stick(browser, robot)
    ok, reason = asyncio.run(stop())
    assert ok, reason
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    eventually(lambda: script(browser, "store.held.value === null"), "the page to let go")
    # the pointer is still down
    actions(browser).move_by_offset(10, 10).move_by_offset(-10, -10).perform()
    assert script(browser, "store.held.value === null")
    assert not script(browser, "document.querySelector('#stick').hasPointerCapture(1)")
    hold_stick(browser, robot)  # another press drives


def test_one_of_two_operators_drives_and_the_other_sees_it(
    robot: SimulatedPage, browser: Any
) -> None:
    async def drive_meanwhile() -> None:
        async with page(robot.url) as other:
            await other.command("pause")
            name = other.parts["hello"]["you"]
            await asyncio.to_thread(see, name)

    def see(name: str) -> None:
        eventually(lambda: text(browser, "#owner") == f"Viewer {name} has control", "the owner")
        stick = element(browser, "#stick")
        actions(browser).move_to_element(stick).click_and_hold().move_by_offset(0, -50).perform()
        eventually(lambda: "has control: wait" in text(browser, "#answer"), "the refusal")
        actions(browser).release().perform()
        assert robot.call(lambda simulator: simulator.counts[full_name(Twist)]) == 0
        press(browser, "#stop")  # everybody may
        eventually(lambda: "stopped" in text(browser, "#answer"), "the stop")

    asyncio.run(drive_meanwhile())
    eventually(lambda: "Nobody" in text(browser, "#owner"), "the end of the other's control")
    hold_stick(browser, robot)


def test_a_robot_that_freezes_is_noticed_while_it_drives(
    robot: SimulatedPage, browser: Any
) -> None:
    hold_stick(browser, robot)
    robot.call(lambda simulator: simulator.inject("freeze"))
    eventually(lambda: "No data for" in text(browser, "#link"), "the silence")
    assert "last known state" in text(browser, "#notice")
    assert "m/s" not in text(browser, "#now")
    assert script(browser, "store.held.value === null")
    robot.call(lambda simulator: simulator.clear_faults())
    eventually(lambda: script(browser, "!store.outdated.value"), "the robot")
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")


def test_a_silent_dashboard_is_noticed_and_a_stop_without_an_answer_raises_an_alarm(
    robot: SimulatedPage, browser: Any
) -> None:
    hold_stick(browser, robot)
    with robot.silent():
        eventually(lambda: "No answer from the dashboard" in text(browser, "#notice"), "warning")
        assert script(browser, "store.held.value === null")
        assert "m/s" not in text(browser, "#now")
        element(browser, "#stop").click()
        eventually(lambda: "emergency stop: STOP is not" in text(browser, "#alarm"), "the alarm")
        assert "no answer" not in text(browser, "#alarm")
        press(browser, "#alarm summary")
        assert "Reason: no answer" in text(browser, "#alarm")
    actions(browser).release().perform()
    eventually(lambda: script(browser, "!store.outdated.value"), "the dashboard")
    # the robot is seen to stand still
    eventually(lambda: text(browser, "#alarm") == "", "the end of the alarm")
    hold_stick(browser, robot)
    assert text(browser, "#answer") == ""


def test_the_page_comes_back_after_a_lost_link(robot: SimulatedPage, browser: Any) -> None:
    robot.call(lambda simulator: simulator.inject("off", for_=1))
    eventually(lambda: "lost" in text(browser, "#notice"), "the warning")
    assert "doctor --ip" in text(browser, "#notice")
    eventually(lambda: script(browser, "!store.outdated.value"), "the link")


class _SlowProxy:
    """Forwards a port to a page, in a thread; what is sent there and back takes `delay` seconds."""

    def __init__(self, url: str) -> None:
        self.delay = 0.0
        self._target = urlsplit(url).hostname, urlsplit(url).port
        self._loop = asyncio.new_event_loop()
        self._server = self._loop.run_until_complete(
            asyncio.start_server(self._forward, "127.0.0.1", 0)
        )
        self.url = f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}/"
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        other_reader, other_writer = await asyncio.open_connection(*self._target)
        ways = [
            asyncio.ensure_future(self._pass_on(reader, other_writer)),
            asyncio.ensure_future(self._pass_on(other_reader, writer)),
        ]
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way, end in zip(ways, (other_writer, writer), strict=True):
            way.cancel()
            end.transport.abort()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            self._loop.call_later(self.delay, writer.transport.write, data)

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()


def test_over_a_slow_connection_nothing_drives_but_stop_works(
    robot: SimulatedPage, shared_browser: SharedBrowser
) -> None:
    proxy = _SlowProxy(robot.url)
    try:
        with shared_browser.window() as driver:
            open_page(driver, proxy.url)
            proxy.delay = 0.4  # there and back again
            former = script(driver, "store.sample.value")
            eventually(lambda: script(driver, "store.sample.value") != former, "late parts")
            stick = element(driver, "#stick")
            actions(driver).move_to_element(stick).click_and_hold().move_by_offset(0, -50).perform()
            eventually(lambda: TOO_SLOW in text(driver, "#answer"), "the refusal")
            assert script(driver, "store.held.value === null")
            actions(driver).release().perform()
            assert not is_driving(robot)
            press(driver, "#stop")
            eventually(lambda: "stopped" in text(driver, "#answer"), "the stop")
            assert robot.call(lambda simulator: simulator.counts[full_name(Twist)]) == 1
    finally:
        proxy.close()


@contextmanager
def free_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    yield port


def test_a_restarted_dashboard_is_found_again(shared_browser: SharedBrowser) -> None:
    with (
        SimulatorThread(quick_config(port=0, tcp_port=0)) as robot,
        free_port() as port,
        shared_browser.window() as driver,
    ):
        options = ["--page-port", str(port)]
        with program(robot, options=options) as (process, url):
            open_page(driver, url)
            process.kill()
            process.wait()
        eventually(lambda: "No connection to the dashboard" in text(driver, "#notice"), "the loss")
        press(driver, "#stop")
        eventually(lambda: "not confirmed" in text(driver, "#alarm"), "the alarm")
        press(driver, "#marks li:nth-child(2) button")
        eventually(lambda: "no path" in text(driver, "#now"), "the preview without a way")
        assert not is_enabled(driver, "#go")
        with program(robot, options=options):
            eventually(lambda: script(driver, "!store.outdated.value"), "the new dashboard")
            wait_for_map(driver)
            eventually(lambda: text(driver, "#alarm") == "", "the end of the alarm")
            eventually(lambda: " m" in text(driver, "#now .way"), "the way, asked again")


def test_a_stop_is_for_the_robot_that_is_shown(shared_browser: SharedBrowser) -> None:
    with (
        SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=7)) as first,
        SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=8)) as second,
        program(first, second) as (_, url),
        shared_browser.window() as browser,
    ):
        open_page(browser, url)
        show(browser, "fleet")
        cards = "[...document.querySelectorAll('.card')].map((each) => each.innerText)"
        eventually(lambda: script(browser, f"{cards}[1]").startswith("8"), "the cards")
        assert all("Ready" in card and "93 %" in card for card in script(browser, cards))
        # the other robot is on the map
        eventually(lambda: script(browser, "mapCanvas.picture().others.length") == 1, "the other")
        for index, name in enumerate(("7 ", "8 ")):
            show(browser, "fleet")
            press(browser, f"#fleet li:nth-child({index + 1}) button")
            eventually(lambda name=name: script(browser, "document.title").startswith(name), name)
            wait_for_map(browser)

            def is_going() -> bool:
                # on a busy machine, the connection may be too slow for a moment
                if is_enabled(browser, "#go"):
                    script(browser, "document.querySelector('#go')?.click()")
                elif script(browser, "store.target.value === null"):
                    show(browser, "go")
                    press(browser, "#marks li:nth-child(2) button")
                return "To A2" in text(browser, "#now")

            eventually(is_going, "the task")
        show(browser, "fleet")
        eventually(lambda: script(browser, f"{cards}[0]").count("moves"), "which robots move")
        assert text(browser, "#robots option[value='0']").endswith("moves")
        assert text(browser, "#stop small") == "8"
        press(browser, "#stop")
        eventually(lambda: "task cancelled" in text(browser, "#answer"), "the answer")
        order = full_name(ActionOrder)
        assert (first.counts[order], second.counts[order] > 0) == (0, True)
        element(browser, "#robots option[value='0']").click()
        eventually(lambda: script(browser, "document.title").startswith("7 "), "the first robot")
        eventually(lambda: "To A2" in text(browser, "#now"), "its task, which goes on")


def test_robots_with_one_number_are_told_apart_and_cards_tell_what_hinders_them(
    shared_browser: SharedBrowser,
) -> None:
    config = {"port": 0, "tcp_port": 0, "robot_id": 7}
    with (
        SimulatorThread(quick_config(**config)) as first,
        SimulatorThread(quick_config(**config, initialised=False)) as second,
        program(first, second) as (_, url),
        shared_browser.window() as browser,
    ):
        open_page(browser, url)
        first.inject("key_switch")
        show(browser, "fleet")
        cards = "[...document.querySelectorAll('.card .state.warn')].map((each) => each.innerText)"
        hindered = ["The robot is in manual mode", "The robot is not initialised"]
        eventually(lambda: script(browser, cards) == hindered, "the cards")
        address = f"127.0.0.1:{first.port}"
        for selector in ("#fleet .card b", "#robots option", "#stop small"):
            assert text(browser, selector).startswith(address), selector
        first.inject("freeze")
        eventually(lambda: script(browser, "store.outdated.value"), "the silence")
        press(browser, "#stop")
        eventually(lambda: f"({address})" in text(browser, "#alarm"), "the alarm")


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
            eventually(lambda: evil in text(browser, "#marks"), "the mark")
            eventually(lambda: evil in text(browser, "h1"), "the name of the robot")
            robot.call(lambda simulator: simulator.push(StatusCode(code=1, msg=evil)))
            show(browser, "state")
            eventually(lambda: evil in text(browser, "#codes"), "the status code")
            assert f"{evil} · {evil}" in text(browser, "#facts")  # scene and map
            show(browser, "map")
            eventually(lambda: evil in text(browser, "#maps"), "the map in the list")
            show(browser, "go")
            press(browser, "#marks button")
            press(browser, "#go")
            eventually(lambda: evil in text(browser, "#now"), "the task")
            assert script(browser, "document.images.length") == 0
            assert script(browser, "globalThis.hacked === undefined")
            check_console_and_requests(browser, robot.url)
    finally:
        robot.close()

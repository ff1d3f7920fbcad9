"""The page in a browser when something goes wrong: drivers go away, links are lost or slow."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.asynchronous import TIMEOUT
from tests.quick_chassis import set_speed
from tests.tools.dashboard.browsers import (
    Browser,
    RobotThread,
    SimulatedPage,
    eventually,
    write_scene,
)
from tests.tools.dashboard.conftest import Serve
from tests.tools.dashboard.pages import (
    TOO_SLOW,
    Delay,
    delayed,
    is_driving,
    is_stopped_by_zero,
    page,
)
from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import LiftControl, StepControl, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import (
    CallAction,
    Feedback,
    Feedbacks,
    kRosExecuting,
    kRosSuccess,
)
from woosh_robot_agent.pb.util.task_pb2 import kActionWait
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard import server
from woosh_robot_agent.tools.dashboard.access import new_tokens
from woosh_robot_agent.tools.dashboard.beside_simulator import dashboard_beside

pytestmark = pytest.mark.timeout(300)


_DISCONNECT = "(connection.connect = () => connection.socket, connection.socket.close())"
"""Ends the connection of the page, which does not connect again."""


def own_port() -> int:
    """Return a free port, which a dashboard keeps when it is started again."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


@pytest.fixture
def plain_robot() -> Iterator[RobotThread]:
    """A simulated robot without a page."""
    with RobotThread() as running:
        yield running


def test_one_of_two_operators_drives_and_both_may_stop(
    robot: SimulatedPage, browser: Browser
) -> None:
    other = robot.enter(page(robot.url))
    set_speed(robot, 0.05)
    robot.run(other.give("goMark", mark="A2"))
    name = other.parts["hello"]["you"]
    eventually(lambda: browser.text("#owner") == f"Viewer {name} has control", "the owner")
    eventually(lambda: browser.elements(".doing #pause"), "the task")
    assert not browser.is_enabled(".doing #pause")
    assert "off" in browser.element("#stick").get_attribute("class").split()
    browser.push_stick()
    eventually(lambda: "has control: wait" in browser.text("#answer"), "the refusal")
    browser.release()
    assert robot.counts[full_name(Twist)] == 0
    browser.press("#stop")  # everybody may
    eventually(lambda: "stopped" in browser.text("#answer"), "the stop")
    set_speed(robot, 1.0)
    robot.run(other.send(do="release"))
    eventually(lambda: "Nobody" in browser.text("#owner"), "the end of the other's control")
    browser.drive(robot)
    ok, reason = robot.run(other.command("stop"))
    assert ok, reason
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")
    eventually(lambda: browser.script("store.held.value === null"), "the page to let go")
    # the pointer is still down
    browser.actions().move_by_offset(10, 10).move_by_offset(-10, -10).perform()
    assert browser.script("store.held.value === null")
    assert not browser.script("document.querySelector('#stick').hasPointerCapture(1)")
    browser.drive(robot)  # another press drives


def test_a_robot_that_freezes_is_noticed_while_it_drives(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.show("setup")
    eventually(lambda: browser.is_enabled("#mute"), "the setting")
    browser.drive(robot)
    robot.inject("freeze")
    eventually(lambda: "No data for" in browser.text("#link"), "the silence")
    assert not browser.is_enabled("#mute")
    assert "last known state" in browser.text("#notice")
    assert "m/s" not in browser.text("#now")
    assert browser.script("store.held.value === null")
    assert "off" in browser.element("#stick").get_attribute("class").split()
    # a banner stays as it was folded while its seconds count
    browser.release()
    browser.set_screen(390, 844)
    browser.press("#notice summary")
    title = browser.text("#notice b")
    eventually(lambda: browser.text("#notice b") != title, "another second")
    assert "last known state" in browser.text("#notice")
    robot.clear_faults()
    eventually(lambda: browser.script("!store.outdated.value"), "the robot")
    eventually(lambda: is_stopped_by_zero(robot), "the robot to stop")


def test_a_silent_dashboard_is_noticed_and_a_stop_without_an_answer_raises_an_alarm(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.drive(robot)
    with robot.silent():
        eventually(lambda: "No answer from the dashboard" in browser.text("#notice"), "warning")
        assert browser.script("store.held.value === null")
        assert "m/s" not in browser.text("#now")
        browser.element("#stop").click()
        eventually(
            lambda: "emergency stop: it may still move" in browser.text("#alarm"), "the alarm"
        )
        assert "Reason" not in browser.text("#alarm")
        browser.press("#alarm summary")
        # a page that waited longer than the stop's timeout has already given up the connection
        reason = browser.text("#alarm").partition("Reason: ")[2].splitlines()[0]
        assert reason in ("no answer", "the connection to the dashboard was lost")
    browser.release()
    eventually(lambda: browser.script("!store.outdated.value"), "the dashboard")
    # the robot is seen to stand still
    eventually(lambda: browser.text("#alarm") == "", "the end of the alarm")
    browser.drive(robot)
    assert browser.text("#answer") == ""


def test_over_a_slow_connection_nothing_drives_but_stop_works(
    robot: SimulatedPage, window: Browser
) -> None:
    delay = Delay()
    url = robot.enter(dashboard_beside(robot.call(lambda simulator: simulator), 0))
    port = robot.enter(delayed(url, delay))
    window.open(f"http://127.0.0.1:{port}/")
    delay.there = delay.back = 0.4
    former = window.script("store.sample.value")
    eventually(lambda: window.script("store.sample.value") != former, "late parts")
    window.push_stick()
    eventually(lambda: TOO_SLOW in window.text("#answer"), "the refusal")
    assert window.script("store.held.value === null")
    window.release()
    assert not is_driving(robot)
    window.press("#stop")
    eventually(lambda: "stopped" in window.text("#answer"), "the stop")
    assert robot.counts[full_name(Twist)] == 1


def test_a_large_map_comes_over_a_slow_connection(window: Browser, tmp_path: Path) -> None:
    mark = {"pose": [2, 2, 0], "description": "x" * 70}
    write_scene(tmp_path, [{"number": f"M{number}", **mark} for number in range(600)])
    delay = Delay()
    with SimulatedPage(scenes=(tmp_path,)) as robot:
        port = robot.enter(delayed(robot.url, delay))
        window.open(f"http://127.0.0.1:{port}/")
        delay.rate = 40e3
        former = window.script("store.you.value")
        window.script("(store.map.value = null, connection.socket.close())")
        eventually(lambda: window.script("store.you.value") != former, "the new connection")
        eventually(lambda: window.script("store.map.value?.marks?.length === 600"), "the map")
        assert window.script("!store.outdated.value")
        window.driver.get("about:blank")


def test_a_map_that_grows_faster_than_its_pictures_come_is_shown(
    robot: SimulatedPage, window: Browser
) -> None:
    pytest.importorskip("scipy", reason="the simulated chassis makes maps with it")
    delay = Delay()
    window.open(f"http://127.0.0.1:{robot.enter(delayed(robot.url, delay))}/")
    delay.back = 2.0  # the map grows each second
    other = robot.enter(page(robot.url))
    robot.run(other.give("workMode", mode="deploy"))
    robot.run(other.give("buildMap", type="add", scene="hall", map="ground"))
    grows = "mapCanvas.area !== null && !mapCanvas.area.map.name"
    eventually(lambda: window.script(grows), "a picture of the growing map")
    former = window.script("mapCanvas.area.map.number")
    eventually(lambda: window.script("mapCanvas.area.map.number") > former, "a later one")


def test_an_alarm_is_not_ended_by_what_was_seen_before_the_loss(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.script(_DISCONNECT)
    eventually(lambda: browser.script("store.problem.value"), "the loss")
    browser.press("#stop")
    eventually(lambda: browser.text("#alarm"), "the alarm")
    robot.run(robot.enter(page(robot.url)).give("goMark", mark="A2"))
    eventually(lambda: is_driving(robot), "a task of somebody else")
    browser.script("delete connection.connect && void connection.connect()")
    eventually(lambda: browser.script("store.pose.value.linear > 0.1"), "the drive in the page")
    assert browser.text("#alarm")


def test_an_alarm_is_not_ended_while_the_robot_moves_sideways_or_may_drive_on(
    robot: SimulatedPage, browser: Browser
) -> None:
    set_speed(robot, 1.0)

    async def step() -> None:
        async with ChassisClient(config=LinkConfig("127.0.0.1", robot.port)) as other:
            sideways = StepControl.Step(mode=StepControl.Step.kLateral, value=4.0, speed=0.3)
            request = StepControl(action=kExecute, steps=[sideways])
            assert (await other.request(CallAction(step_control=request))).ok

    asyncio.run(step())
    eventually(lambda: robot.state.velocity.left > 0.1, "the step")
    for refused in (CallAction, Twist, Feedbacks):
        robot.refuse(full_name(refused), "the program of the robot hangs")
    browser.script("""(connection.stop = () => Promise.resolve(
      {ok: false, text: {key: "reason.noAnswer", values: {}}}))""")
    stop = robot.begin(robot.enter(page(robot.url)).command("stop"))
    assert not stop.result(TIMEOUT)[0]
    browser.press("#stop")
    both = "[store.unanswered.value.size, store.fleet.value[0].alarm !== '']"
    eventually(lambda: browser.script(both) == [1, True], "both alarms")
    time.sleep(2.0)  # longer than a robot has to stand still
    assert robot.state.velocity.left > 0.1
    assert browser.script(both) == [1, True]
    set_speed(robot, 20.0)
    robot.push(TaskProc(robot_task_id=7, state=kActionWait))
    eventually(lambda: robot.state.velocity.left == 0.0, "the end of the step")
    time.sleep(2.0)
    assert browser.script(both) == [1, True], "a task waits, and will drive on"
    lift = Feedback(action=full_name(LiftControl), state=kRosExecuting)
    robot.push(Feedbacks(fbs=[lift]))
    action = "store.robot.value.actions.find(({name}) => name === 'LiftControl')?.state"
    eventually(lambda: browser.script(action) == "executing", "the action")
    robot.drop()
    eventually(lambda: browser.script(action) == "unknown", "the new link, without the task")
    time.sleep(2.0)
    assert browser.script(both) == [1, True], "the lift may still move"
    lift.state = kRosSuccess
    robot.push(Feedbacks(fbs=[lift]))
    eventually(lambda: not browser.text("#alarm"), "the end of the action")


def test_a_page_whose_address_is_no_longer_valid_or_may_no_longer_stop_says_so(
    plain_robot: RobotThread, window: Browser
) -> None:
    from selenium.webdriver.common.keys import Keys

    tokens = new_tokens()
    options = {"host": "0.0.0.0", "port": own_port()}
    with plain_robot.serving(**options) as url:
        window.open(url)
    eventually(lambda: "No connection to the dashboard" in window.text("#notice"), "the loss")
    with plain_robot.serving(**options, tokens=tokens) as url:
        eventually(lambda: "open the new address" in window.text("#notice"), "the refusal")
        window.press("#stop")
        eventually(lambda: "may still move" in window.text("#alarm"), "the alarm")
        window.open(url)
    with plain_robot.serving(**options, tokens=tokens, control=False):
        eventually(lambda: "no longer stop" in window.text("#notice"), "the loss of control")
        assert "--control" in window.text("#notice")
        assert not window.elements("#stop, #stick")
        window.actions().send_keys(Keys.ESCAPE).perform()
        eventually(lambda: "may still move" in window.text("#alarm"), "the alarm")
    with plain_robot.serving(**options, tokens=tokens):
        eventually(lambda: window.elements("#stop"), "the control")
        assert "no longer stop" not in window.text("#notice")


def test_a_restarted_dashboard_is_found_again_and_what_ended_with_the_former_is_told(
    plain_robot: RobotThread, window: Browser
) -> None:
    port = own_port()
    with plain_robot.serving(port=port) as url:
        window.open(url)
        window.show("setup")
        window.element("#speed-limit option[value='0.1']").click()
        limit = "store.fleet.value[0].speedLimit"
        eventually(lambda: window.script(limit) == 0.1, "the limit")
    eventually(lambda: "No connection to the dashboard" in window.text("#notice"), "the loss")
    window.press("#stop")
    eventually(lambda: "may still move" in window.text("#alarm"), "the alarm")
    window.show("go")
    window.press("#marks li:nth-child(2) button")
    eventually(lambda: "no path" in window.text("#now"), "the preview without a way")
    assert not window.is_enabled("#go")
    window.show("state")
    plain_robot.inject("refuse")
    with plain_robot.serving(port=port):
        eventually(lambda: window.script("store.problem.value === ''"), "the new dashboard")
        eventually(lambda: window.script("store.link.value.state !== 'connected'"), "its link")
        plain_robot.clear_faults()
        eventually(lambda: window.script("!store.outdated.value"), "the robot")
        window.wait_for_map()
        eventually(lambda: window.text("#alarm") == "", "the end of the alarm")
        eventually(lambda: " m" in window.text("#now .way"), "the way, asked again")
        eventually(lambda: "93 %" in window.text("#plots"), "the history")
        # the limit has ended with the dashboard
        eventually(lambda: "0.1 m/s has ended" in window.text("#notice"), "the notice")
        window.press("#notice .actions button")
        eventually(lambda: "has ended" not in window.text("#notice"), "the end of the notice")


def test_what_could_not_be_loaded_is_loaded_later(robot: SimulatedPage, window: Browser) -> None:
    storage = "Object.defineProperty(window, 'localStorage', {get() { throw new Error('off'); }})"
    window.send("Page.addScriptToEvaluateOnNewDocument", source=storage)
    window.send("Network.enable")
    window.send("Network.setBlockedURLs", urls=["*/texts/*", "*/map/0/*"])
    window.driver.get(robot.url)
    tried = "performance.getEntriesByType('resource').some(({name}) => name.endsWith('en.json'))"
    eventually(lambda: window.script(tried), "the attempt")
    assert not window.script("document.querySelector('#stop')")
    assert "Loading" in window.text("body")
    # the texts
    window.send("Network.setBlockedURLs", urls=["*/texts/*zh*", "*/map/0/*"])
    eventually(lambda: window.script("globalThis.mapCanvas?.shown === ''"), "the picture's failure")
    assert window.script("mapCanvas.area === null")
    assert "Loading" not in window.text("body")
    window.press("#stop")
    eventually(lambda: "stopped" in window.text("#answer"), "the stop")
    # another language
    window.press("#language")
    eventually(lambda: "no connection" in window.text("#answer"), "the reason")
    assert window.text("#tab-go") == "Go"
    # the picture of the map, with the next connection
    window.send("Network.setBlockedURLs", urls=[])
    window.script("connection.socket.close()")
    window.wait_for_map()


def test_names_are_shown_as_text(window: Browser, tmp_path: Path) -> None:
    evil = "<img src=x onerror=hacked=1>"
    write_scene(tmp_path, [{"number": evil, "pose": [2, 2, 0], "description": evil}], evil)
    with SimulatedPage(scenes=(tmp_path,)) as robot:
        robot.rename(evil)
        window.driver.get(robot.url)
        eventually(lambda: evil in window.text("#marks"), "the mark")
        eventually(lambda: evil in window.text("h1"), "the name of the robot")
        robot.push(StatusCode(code=1, msg=evil))
        window.show("state")
        eventually(lambda: evil in window.text("#codes"), "the status code")
        assert f"{evil} · {evil}" in window.text("#facts")  # scene and map
        window.show("map")
        eventually(lambda: evil in window.text("#maps"), "the map in the list")
        window.show("go")
        window.press("#marks button")
        window.press("#go")
        eventually(lambda: evil in window.text("#now"), "the task")
        assert window.script("document.images.length") == 0
        assert window.script("globalThis.hacked === undefined")
        window.check_console_and_requests(robot.url)


def test_a_new_connection_leaves_the_view_and_tells_that_an_answer_was_lost(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.press("#zoom-in")
    browser.press("#follow")
    view = "[mapCanvas.view.scale, store.follow.value, mapCanvas.area !== null]"
    before = browser.script(view)
    former = browser.script("store.you.value")
    with robot.silent():
        browser.script("void connection.command('history').then(({ok}) => (window.ok = ok))")
        events = ["pagehide", "pageshow"]  # as the browser does when one goes to a page and back
        for name in events:
            browser.script(f"dispatchEvent(new PageTransitionEvent('{name}', {{persisted: true}}))")
    eventually(lambda: browser.script("!store.outdated.value"), "the new connection")
    assert browser.script("window.ok") is False
    eventually(lambda: browser.script("store.you.value") != former, "the new connection")
    map_again = "store.link.value?.good && store.map.value?.resolution && mapCanvas.area !== null"
    eventually(lambda: browser.script(map_again), "the map")
    assert browser.script(view) == before


def test_a_dashboard_that_is_restarted_with_other_robots_shows_and_stops_the_same_one(
    plain_robot: RobotThread, other: SimulatorThread, window: Browser
) -> None:
    # the page connects again only when STOP is pressed, after its own attempt has done nothing
    hold = "connection.connect = () => ((connection.held = true), connection.socket)"

    def press_stop() -> None:
        eventually(lambda: window.script("connection.held"), "the attempt of the page")
        window.script("delete connection.connect && delete connection.held")
        window.press("#stop")

    port = own_port()
    with plain_robot.serving(plain_robot, other, port=port) as url:
        window.open(url)
        window.script("document.querySelector('#robots').selectedIndex = 1")
        window.script("document.querySelector('#robots').dispatchEvent(new Event('change'))")
        shown = "!store.outdated.value && store.robot.value?.id"
        eventually(lambda: window.script(shown) == 8, "the other robot")
        window.driver.refresh()
        window.wait_for_map()
        eventually(lambda: window.script(shown) == 8, "the same robot after a reload")
        window.script(hold)
    with plain_robot.serving(other, plain_robot, port=port):
        press_stop()
        eventually(lambda: "stopped" in window.text("#answer"), "the stop")
        eventually(lambda: window.script(shown) == 8, "the other robot")
        assert window.script("[store.chosen.value, store.alarms.value.size]") == [0, 0]
        window.script(hold)
    with plain_robot.serving(port=port):
        press_stop()
        # the robot of the stop is named, because the page shows another one then
        gone = f"it may still move (127.0.0.1:{other.port})"
        eventually(lambda: gone in window.text("#alarm"), "the alarm")
        eventually(lambda: window.script(shown) == 30001, "the robot that is left")
    assert (plain_robot.counts[full_name(Twist)], other.counts[full_name(Twist)]) == (0, 1)


@pytest.mark.parametrize("stops", [[1, 0], [1, 1]])
def test_a_stop_without_a_connection_is_for_the_robot_that_was_shown(
    serve: Serve, window: Browser, stops: list[int]
) -> None:
    served = serve({"robot_id": 7}, {"robot_id": 8})
    window.open(served.url)
    window.script(_DISCONNECT)
    eventually(lambda: window.script("store.problem.value"), "the loss")
    window.driver.execute_script(
        """
          connection.stopTimeout = 60_000; // on a busy machine, connecting may take long
          const [stop, list] = ["#stop", "#robots"].map((id) => document.querySelector(id));
          stop.click();
          list.selectedIndex = 1;
          list.dispatchEvent(new Event("change"));
          if (arguments[0]) stop.click(); // for the other robot, too
          delete connection.connect;
          connection.connect();
        """,
        stops[1],
    )
    eventually(lambda: window.script("connection.replies.size === 0"), "the answers")
    assert "stopped" in window.text("#answer")
    assert [each.counts[full_name(Twist)] for each in served.robots] == stops
    eventually(lambda: window.script("store.robot.value?.id") == 8, "the other robot")
    assert window.script("store.alarms.value.size") == 0


def test_a_stop_just_after_the_loss_of_the_connection_opens_only_one(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.driver.execute_script("""
      globalThis.attempts = 0;
      const connect = connection.connect;
      connection.connect = () => (attempts++, connect.call(connection));
      connection.socket.addEventListener("close", () => {
        document.querySelector("#stop").click();
        setTimeout(() => (globalThis.isOver = true), 1000); // the page's own next attempt is due
      });
      connection.socket.close();
    """)
    eventually(lambda: "stopped" in browser.text("#answer"), "the stop")
    eventually(lambda: browser.script("globalThis.isOver"), "the time of another attempt")
    assert browser.script("attempts") == 1


def test_two_presses_of_stop_without_a_connection_raise_no_alarm_once_it_is_confirmed(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.script(_DISCONNECT)
    eventually(lambda: browser.script("store.problem.value"), "the loss")
    browser.driver.execute_script("""
      globalThis.most = 0;
      store.alarms.subscribe(({size}) => (most = Math.max(most, size)));
      delete connection.connect;
      globalThis.timeouts = [];
      const setLater = setTimeout;
      globalThis.setTimeout = (end, delay) =>
        delay === connection.stopTimeout ? timeouts.push(end) : setLater(end, delay);
      for (let each = 0; each < 2; each++) document.querySelector("#stop").click();
    """)
    eventually(lambda: "stopped" in browser.text("#answer"), "the stop")
    assert browser.script("timeouts.map((end) => end()).length") == 2
    assert browser.script("most") == 0
    assert "stopped" in browser.text("#answer")
    # just after a sleep of the device, in which one of its clocks may stand still; a message may
    # have waited since then
    old = '{"part": "clock", "data": 0}'
    for clock, waits in (("performance", "false"), ("Date", "false"), ("Date", "true")):
        browser.driver.execute_script(f"""
          store.answer.value = null;
          const now = {clock}.now;
          {clock}.now = () => now.call({clock}) + 60000;
          connection.socket.send = () => {{}}; // the old connection gets nothing
          if ({waits}) connection.socket.onmessage({{ data: {old!r} }});
          document.querySelector("#stop").click();
        """)
        eventually(lambda: "stopped" in browser.text("#answer"), f"the stop by {clock}")


def test_a_page_of_an_older_dashboard_asks_to_be_reloaded(
    robot: SimulatedPage, browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = server._page_files()
    robot.restart_page()
    eventually(lambda: browser.script("store.you.value && !store.outdated.value"), "the page")
    assert browser.text("#notice") == ""
    changed = {**files, "/main.js": (files["/main.js"][0] + b"// changed", "text/javascript")}
    monkeypatch.setattr(server, "_page_files", lambda: changed)
    robot.restart_page()
    eventually(lambda: "was updated" in browser.text("#notice"), "the notice")
    browser.press("#notice button")
    eventually(lambda: browser.script("globalThis.store?.updated.value === false"), "the new page")
    browser.wait_for_map()
    assert browser.text("#notice") == ""


def test_a_robot_that_has_never_answered_is_unknown(
    plain_robot: RobotThread, window: Browser
) -> None:
    plain_robot.inject("refuse")
    with plain_robot.serving() as url:
        window.driver.get(url)
        for tab, known in (("go", "There is no map"), ("tasks", "The robot has no task")):
            window.show(tab)
            eventually(lambda: "not reported its state" in window.text(".stale"), "the notice")
            assert "not known yet" in window.text("#panel").lower()
            assert known not in window.text("#panel")


def test_times_are_of_the_dashboard_and_a_lost_plot_is_told(
    robot: SimulatedPage, window: Browser
) -> None:
    late = """
      Date = class extends Date {
        constructor(...given) { super(...(given.length ? given : [Date.now()])); }
        static now() { return super.now() - 30 * 3600 * 1000; }
      }
    """
    window.send("Page.addScriptToEvaluateOnNewDocument", source=late)
    window.send("Network.enable")
    window.send("Network.setBlockedURLs", urls=["*/uplot.js"])
    window.open(robot.url)
    window.choose_mark()
    window.press("#go")
    eventually(lambda: window.script("store.tasks.value.length"), "the task")
    assert window.script("Math.abs(store.answer.value.time - store.tasks.value[0].begun)") < 60_000
    window.show("tasks")
    assert "/" not in window.text("#running small")  # no date, which is today
    window.show("state")
    eventually(lambda: "could not be loaded" in window.text("#plots"), "the lost plots")

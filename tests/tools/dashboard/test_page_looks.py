"""How the page looks: accessibility, colours, languages, and pictures of its main states.

With WOOSH_SCREENSHOTS=new, the pictures that these tests compare with are made anew.
"""

from __future__ import annotations

import copy
import importlib
import io
import json
import math
import os
import pickle
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image, ImageChops, ImageStat

from tests.quick_chassis import set_speed
from tests.tools.dashboard.browsers import Browser, SimulatedPage, eventually
from tests.tools.dashboard.conftest import Serve
from woosh_robot_agent.link.connection import NAMED_NOT_SENT
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.sentences import AND, SENTENCES, Said
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.tools.dashboard.texts import PAGE, page_text, value_data

pytestmark = pytest.mark.timeout(300)
_ARE_NEW = bool(os.environ.get("WOOSH_SCREENSHOTS"))
_PICTURES = Path(__file__).with_name("pictures")
_ROOT = Path(__file__).parents[3]
_AXE = _ROOT / "scripts/page/node_modules/axe-core/axe.min.js"
_SHRINK = 4
"""Factor by which the pictures to compare with are smaller than the screen."""
_TILE = 15
"""Size of the tiles of which the mean colours are compared, in pixels of these pictures."""
_GO = """connection.command("goMark", {mark: "A2", ...store.shownMap.value}).then(({ok, text}) =>
  (store.answer.value = {ok, text, time: 0, robot: store.address.value}))"""
"""Gives a task, whatever the page thinks of it, and shows the answer."""
_TOLERANCE = 20.0
"""Greatest difference of a mean colour, of 255: fonts may differ, but nothing may be missing."""


Opened = Callable[..., Any]


@pytest.fixture
def opened(window: Browser) -> Iterator[Opened]:
    """Function that opens an address on a screen; its console is checked after the test."""
    urls: set[str] = set()

    def open_on(url: str, width: int, height: int) -> Any:
        urls.add(url)
        window.set_screen(width, height)
        window.set_media(**{"prefers-color-scheme": "light"})
        window.open(url)
        return window

    yield open_on
    for url in urls:
        window.check_console_and_requests(url)


_AXE_SCREENS = (1440, 900, "light"), (390, 844, "dark")


def check_accessibility(browser: Browser, state: str, number: int) -> None:
    """Check that axe finds no violation on the screen with this number of `_AXE_SCREENS`."""
    width, height, scheme = _AXE_SCREENS[number]
    browser.set_media(**{"prefers-color-scheme": scheme})
    browser.resize(width, height)
    # after the sheet has appeared
    browser.script("document.getAnimations().forEach((each) => each.finish())")
    found = browser.driver.execute_async_script(
        "const done = arguments[0];"
        "axe.run(document, {resultTypes: ['violations']}).then(({violations}) => done("
        "  violations.map(({id, nodes}) => `${id}: ${nodes.map(({html, failureSummary}) =>"
        "    html + ' ' + failureSummary)}`)), (error) => done([String(error)]));"
    )
    assert found == [], (state, scheme)


@pytest.mark.skipif(not _AXE.exists(), reason="no axe-core: run npm ci in scripts/page")
def test_axe_finds_no_violation(robot: SimulatedPage, opened: Opened) -> None:
    browser = opened(robot.url, 1440, 900)
    browser.driver.execute_script(_AXE.read_text("utf-8"))
    browser.press("#layers")
    check_accessibility(browser, "layers", 0)
    browser.press("#layers")
    for count, tab in enumerate(("go", "tasks", "state", "map", "setup", "simulator")):
        browser.show(tab)
        check_accessibility(browser, tab, count % 2)
    robot.inject("emergency_stop")
    eventually(lambda: browser.text("#notice"), "the banner")
    browser.show("state")
    eventually(lambda: browser.text("#problems"), "the fault")
    check_accessibility(browser, "emergency stop", 1)
    robot.inject("off")
    eventually(lambda: browser.script("store.outdated.value"), "the loss of the link")
    browser.press("#stop")
    eventually(lambda: browser.text("#alarm"), "the alarm")
    for number in range(len(_AXE_SCREENS)):
        check_accessibility(browser, "alarm", number)


def test_colours_have_enough_contrast_and_give_way_to_those_of_the_system(
    robot: SimulatedPage, opened: Opened
) -> None:
    tints = ["ok ok-tint", "warning warning-tint", "fault fault-tint", "accent tint"]
    pairs = {
        4.5: ["ink paper", "faint paper", "faint raised", "accent paper", "on-accent accent"]
        + ["ink map-unknown", *tints],
        3.0: ["edge paper", "edge raised", "laser map-floor", "map-wall map-floor", "edge ground"],
    }
    contrast = """
      const context = new OffscreenCanvas(1, 1).getContext("2d", {willReadFrequently: true});
      const light = (name) => {
        const probe = document.body.appendChild(document.createElement("i"));
        probe.style.color = `var(--${name})`;
        context.fillStyle = getComputedStyle(probe).color;
        probe.remove();
        context.fillRect(0, 0, 1, 1);
        const [r, g, b] = [...context.getImageData(0, 0, 1, 1).data].map((each) => each / 255)
          .map((each) => each <= 0.04045 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4);
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
      };
      const [one, other] = arguments[0].split(" ").map(light);
      return (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05);
    """
    browser = opened(robot.url, 1440, 900)
    for scheme in ("light", "dark"):
        browser.set_media(**{"prefers-color-scheme": scheme})
        browser.wait_for_frame()
        for least, names in pairs.items():
            for each in names:
                assert browser.driver.execute_script(contrast, each) >= least, (scheme, each)
    knob = "getComputedStyle(document.querySelector('.knob')).backgroundColor"
    browser.set_media(**{"forced-colors": "active", "prefers-reduced-motion": "reduce"})
    active = "matchMedia('(forced-colors: active)').matches"
    eventually(lambda: browser.script(active), "the colours")
    is_drawn = "mapCanvas.colours['map-floor'] === getComputedStyle(document.body).backgroundColor"
    eventually(lambda: browser.script(is_drawn), "the map in the colours of the system")
    browser.show("state")
    moving = "document.getAnimations().filter((each) => each.playState === 'running').length"
    assert browser.script(moving) == 0
    on = browser.script(knob)
    robot.inject("emergency_stop")
    eventually(lambda: browser.script(knob) != on, "the stick that is off")


def test_the_state_is_the_largest_text_and_its_edge_tells_what_is_wrong(
    robot: SimulatedPage, opened: Opened
) -> None:
    """From 2 m, the state is read and the colour is seen."""
    sizes = """[...document.querySelectorAll("body *:not(#stop)")]
      .filter((each) => each.checkVisibility() && each.textContent.trim())
      .map((each) => [parseFloat(getComputedStyle(each).fontSize), each.closest("#now") !== null])
    """
    edge = "getComputedStyle(document.querySelector('.dock')).getPropertyValue('--tone')"
    browser = opened(robot.url, 1440, 900)
    screens = ((768, 1024), (390, 844), (1440, 900))
    for width, height in screens:
        browser.resize(width, height)
        largest, is_state = max(browser.script(sizes))
        assert largest >= (20 if width < 1000 else 28)
        assert is_state
        assert browser.script(edge) == ""
    robot.inject("emergency_stop")
    eventually(lambda: "emergency stop" in browser.text("#now b"), "the state")
    for width, height in screens:
        browser.resize(width, height)
        assert browser.script(edge) != ""
        assert browser.script("now.scrollHeight <= now.clientHeight")


def test_both_languages_have_the_same_texts() -> None:
    texts = {
        name: json.loads((PAGE / f"texts/{name}.json").read_text("utf-8")) for name in ("en", "zh")
    }
    assert list(texts["en"]) == list(texts["zh"])
    for key, english in texts["en"].items():
        assert _braces(english) == _braces(texts["zh"][key]), key


def test_each_sentence_of_the_program_is_in_chinese() -> None:
    for file in (_ROOT / "woosh_robot_agent").rglob("*.py"):
        if "Sentence(" in file.read_text("utf-8"):
            importlib.import_module(".".join(file.relative_to(_ROOT).with_suffix("").parts))
    chinese = json.loads((PAGE / "texts/said.zh.json").read_text("utf-8"))
    assert set(chinese) == SENTENCES
    for pattern, text in chinese.items():
        assert _braces(pattern) == _braces(text)


def test_a_sentence_remains_a_str_with_its_key_in_copies() -> None:
    said = AND(one=Said("nobody", "browser.nobody"), other="unknown")
    for each in (copy.deepcopy(said), pickle.loads(pickle.dumps(said))):
        assert (each, each.key, each.values) == ("nobody, unknown", "{one}, {other}", said.values)
        assert value_data(each) == value_data(said)
    assert json.dumps([said]) == '["nobody, unknown"]'


def test_no_text_of_the_page_has_the_name_of_a_type() -> None:
    said = NAMED_NOT_SENT(name=full_name(SceneData), reason="too late")
    data = value_data(page_text("reply.refused", command=page_text("command.go"), text=said))
    assert data["english"] == "Go: the request was not sent: too late"
    assert data["values"]["text"]["english"] == "the request was not sent: too late"


def _braces(pattern: str) -> set[str]:
    return {part.split("}")[0] for part in pattern.split("{")[1:]}


def test_the_page_in_chinese_and_what_the_program_explains_have_no_other_words(
    robot: SimulatedPage, opened: Opened
) -> None:
    browser = opened(robot.url, 1440, 900)
    browser.press("#language")
    eventually(lambda: browser.text("#tab-go") == "前往", "Chinese")
    assert browser.script("document.documentElement.lang") == "zh"
    browser.driver.refresh()
    browser.wait_for_map()
    assert browser.text("#tab-go") == "前往", "Chinese, which is remembered"
    browser.press("#layers")
    check_chinese(browser, "layers")
    browser.press("#layers")
    for tab in ("go", "map", "setup", "simulator"):
        browser.show(tab)
        check_chinese(browser, tab)
    browser.show("go")
    pose = robot.state.pose
    ahead = {"x": pose.x + 0.7 * math.cos(pose.theta), "y": pose.y + 0.7 * math.sin(pose.theta)}
    robot.inject("obstacle", radius=0.3, **ahead)
    browser.hold_stick(lambda: "没有移动" in browser.text("#notice"), "the standstill")
    check_chinese(browser, "standstill")
    browser.release()
    robot.clear_faults()
    set_speed(robot, 0.05)
    browser.press("#marks li:nth-child(2) button")
    browser.press("#go")
    eventually(lambda: browser.script("store.robot.value.task?.running"), "a task")
    eventually(lambda: browser.script("store.path.value.length > 1"), "its path")
    browser.hold_stick(lambda: "正在执行" in browser.text("#answer"), "the refusal")
    check_chinese(browser, "stick refused")
    browser.release()
    for tab in ("tasks", "state"):
        browser.show(tab)
        check_chinese(browser, f"task in {tab}")
    browser.press(".doing #cancel")
    robot.inject("emergency_stop")
    eventually(lambda: browser.script("store.robot.value.objections.length"), "the stop button")
    browser.script(_GO)
    eventually(lambda: "急停按钮已按下" in browser.text("#answer"), "why it is refused")
    check_chinese(browser, "refused", "emergency stop is pressed: release it first")  # of the robot
    code = StatusCode(code=110301000013, level=StatusCode.kFault, msg="电机相线")
    robot.push(AbnormalCodes(scs=[code]))
    eventually(lambda: "左电机" in browser.text("#problems"), "the fault")
    check_chinese(browser, "fault", "emergency stop is pressed: release it first")
    robot.inject("off")
    eventually(lambda: "无法连接" in browser.text("#notice"), "why there is no link")
    browser.press("#stop")
    eventually(lambda: browser.text("#alarm"), "the alarm")
    browser.press("#alarm summary")
    assert "未停止" in browser.text("#alarm")
    assert "未连接" in browser.text("#alarm")
    assert browser.text("#alarm").count("未发送") <= 1, "one reason"
    check_chinese(browser, "link lost", "Connection refused")  # of the operating system


_LATIN = re.compile(r"(?<![A-Za-z0-9])-{0,2}[A-Za-z][\w./=-]*")
"""Words in Latin letters, without units that follow a number at once."""
_NAMES = re.compile(
    # keys, units, protocols and programs
    r"Esc|English|m|s|m/s|km|ms|rad/s|ws|tcp|order|Wi-Fi|WebSocket|UTF-8|JSON|protobuf|ping|IP|ip|port|doctor|"
    r"maps|--ip|--port|at|"
    # words of VDA 5050 and of the code: types, fields, options, faults and their arguments
    r"[a-z]+([A-Z][a-z]+)+|[A-Z][a-z]+([A-Z][a-z]+)+|woosh[\w.-]*|[a-z]+_[a-z_]+|[a-z]+=\S*|key|"
    # numbers of marks
    r"[A-Z]\d+"
)
_READ = """
  const read = [document.body.innerText];
  for (const each of document.querySelectorAll("[title], [aria-label], [placeholder]"))
    read.push(each.title, each.ariaLabel ?? "", each.placeholder ?? "");
  const {robot, map, scenes, details, simulator, tasks, codes} = globalThis.store;
  const {name, model, scene, map: used} = robot.value;
  const known = [name, model, scene, used, details.value?.software, details.value?.system];
  for (const {number, text} of map.value?.marks ?? []) known.push(number, text);
  for (const {name} of map.value?.taskTypes ?? []) known.push(name);
  for (const {text} of [...tasks.value, ...codes.value]) known.push(text);
  for (const {name, maps} of scenes.value) known.push(name, ...maps);
  for (const each of simulator.value.known) known.push(each.name, ...each.arguments.split(", "));
  return [read.join("\\n"), known.filter(Boolean)];
"""


def check_chinese(browser: Browser, state: str, *robot_texts: str) -> None:
    """Check that what can be read has no Latin words but names and the robot's own texts."""
    read, known = browser.driver.execute_script(_READ)
    read = re.sub("`[a-z]+`", "", read)  # names of fields
    for each in sorted({*known, *robot_texts}, key=len, reverse=True):
        read = re.sub(rf"(?<![A-Za-z]){re.escape(each)}(?![A-Za-z])", "", read)
    words = {word for word in _LATIN.findall(read) if not _NAMES.fullmatch(word)}
    lines = [line for line in read.splitlines() if any(word in line for word in words)]
    assert words == set(), (state, lines)


def test_who_may_only_look_sees_no_commands(serve: Serve, opened: Opened, tmp_path: Path) -> None:
    browser = opened(serve_to_watch(serve), 1024, 768)
    check_picture(browser, "watching", tmp_path)
    assert "token" not in browser.driver.current_url
    eventually(lambda: "only shows" in browser.text("#now"), "the hint")
    assert browser.text("#tab-go") == "Marks"
    for selector in ("#stop", "#stick", "#owner", "[data-tool=go]"):
        assert browser.elements(selector) == [], selector
    for tab in ("tasks", "state", "map", "setup", "go"):
        browser.show(tab)
        for selector in ("#go", "#charge", "#pause", "#set-pose", "#controlMode"):
            assert browser.elements(selector) == [], (tab, selector)
    browser.press("#marks button")
    eventually(lambda: "Rack" in browser.text("#now"), "what is known of the mark")


def test_main_states_look_as_stored(robot: SimulatedPage, opened: Opened, tmp_path: Path) -> None:
    browser = opened(robot.url, 1440, 900)
    for name, width, height in (
        ("standing", 1440, 900),
        ("low", 844, 390),
        ("emergency", 768, 1024),
        ("fault", 390, 844),
        ("lost", 1024, 768),
        ("task", 1440, 900),
    ):
        browser.resize(width, height)
        bring_about(name, robot, browser)
        check_picture(browser, name, tmp_path)
        robot.clear_faults()
        robot.push(AbnormalCodes())
        eventually(lambda: not browser.text(".notices"), "the former state")
        browser.script("store.answer.value = null")


def bring_about(state: str, robot: SimulatedPage, browser: Browser) -> None:
    """Bring a robot and its page into one of the main states."""
    if state == "emergency":
        robot.inject("emergency_stop")
        eventually(lambda: browser.text("#notice"), "the banner")
    elif state == "task":
        set_speed(robot, 0.05)  # it stays there
        is_wide = browser.script("innerWidth >= 1000")  # no sheet lies over the map
        if not is_wide:
            browser.show("go")
        browser.choose_mark()
        if not is_wide:
            browser.show("go")  # closes the sheet
        browser.press("#go")
        eventually(lambda: browser.script("store.path.value.length > 1"), "the path")
        assert browser.script("mapCanvas.picture().chosenMark") == "A2"
        if is_wide:
            browser.show("tasks")
    elif state == "fault":
        assert "Ready" in browser.text("#now")
        code = StatusCode(code=11020100001, level=StatusCode.kFault, msg="the brake is stuck")
        robot.push(AbnormalCodes(scs=[code]))
        eventually(lambda: browser.text("#notice"), "the banner")
        assert "Fault" in browser.text("#now")
        assert "Remove the cause" in browser.text("#now")
        assert "Hold the stick" not in browser.text("#now")
        assert "Press a place" not in browser.text("#now")
    elif state == "lost":
        robot.inject("off")
        text = "document.querySelector('#notice')?.textContent ?? ''"  # it may be folded
        eventually(lambda: "doctor" in browser.script(text), "the banner")
        browser.press("#stop")
        eventually(lambda: browser.text("#alarm"), "the alarm of the stop")
    elif state == "driving":
        browser.hold_stick(lambda: re.search("0[.][1-9]", browser.text("#now .speed")), "the speed")
    elif state == "position":
        robot.inject("lost_localisation")
        eventually(lambda: browser.text("#notice"), "the banner")
        assert browser.script("mapCanvas.picture().lost")


def serve_to_watch(serve: Serve) -> str:
    """Return the address for a viewer who may only look."""
    return serve({}, host="0.0.0.0", watch=True).url


def test_two_robots_look_as_stored(serve: Serve, opened: Opened, tmp_path: Path) -> None:
    browser = opened(serve_two_robots(serve), 1440, 900)
    show_two_robots(browser)
    check_picture(browser, "two", tmp_path)
    browser.script(_GO)
    eventually(lambda: "moves" in browser.text("#fleet .card"), "which robot moves")
    browser.press("#fleet li:nth-child(2) button")
    eventually(lambda: browser.script("document.title").startswith("30002 "), "the other robot")
    assert browser.text("#robots option[value='0']").endswith("moves")


def serve_two_robots(serve: Serve) -> str:
    """Serve a page for two robots at different places; return its address."""
    served = serve({}, {"robot_id": 30002})
    set_speed(served.robots[0], 0.2)  # on a busy machine, a task would end too early
    place = Pose(-6.0, 2.0, 0.0)
    served.robots[1].call(lambda simulator: simulator.chassis.base.place(place))
    return served.url


def show_two_robots(browser: Browser) -> None:
    """Show the cards of two robots, and both on the map."""
    browser.show("fleet")
    eventually(lambda: browser.text("#fleet").count("Ready") == 2, "the cards")
    eventually(lambda: browser.script("mapCanvas.picture().others.length") == 1, "both")
    eventually(lambda: browser.script("mapCanvas.picture().others[0].x < -5"), "its place")
    assert browser.script("mapCanvas.picture().name") == "30001"


def test_a_robot_without_a_map_looks_as_stored(
    serve: Serve, window: Browser, tmp_path: Path
) -> None:
    window.set_screen(390, 844)
    window.set_media(**{"prefers-color-scheme": "light"})
    url = open_without_map(serve, window)
    assert "There is no map" in window.script("document.querySelector('#panel').innerText")
    assert "choose another map." in window.script("document.querySelector('#notice').textContent")
    check_picture(window, "nomap", tmp_path)
    window.press("#notice .actions button")
    assert "Maps on the robot" in window.text("#panel")
    window.check_console_and_requests(url)


def open_without_map(serve: Serve, browser: Browser) -> str:
    """Open the page of a robot that does not send its map; return the address."""
    served = serve({})
    served.robots[0].refuse(full_name(SceneData), "the scene is damaged")
    browser.driver.get(served.url)
    eventually(lambda: browser.script("globalThis.store?.scan.value != null"), "the laser")
    eventually(lambda: "No map" in browser.text("#notice"), "the banner")
    return served.url


def check_picture(browser: Browser, name: str, tmp_path: Path) -> None:
    """Compare the screen with a stored picture."""
    # without the laser, which varies, the battery of a simulated robot that has waited
    browser.script("document.getAnimations().forEach((each) => each.finish())")
    with Image.open(io.BytesIO(browser.driver.get_screenshot_as_png())) as screen:
        size = screen.width // _SHRINK, screen.height // _SHRINK
        seen = screen.convert("RGB").resize(size)
    path = _PICTURES / f"{name}.png"
    if _ARE_NEW:
        seen.save(path, optimize=True)
    with Image.open(path) as stored:
        difference = ImageChops.difference(seen, stored.convert("RGB"))
    for x in range(0, seen.width, _TILE):
        for y in range(0, seen.height, _TILE):
            tile = difference.crop((x, y, min(x + _TILE, seen.width), min(y + _TILE, seen.height)))
            worst = max(ImageStat.Stat(tile).mean)
            if worst > _TOLERANCE:
                seen.save(tmp_path / f"{name}.png")
            assert worst <= _TOLERANCE, (x * _SHRINK, y * _SHRINK, tmp_path)

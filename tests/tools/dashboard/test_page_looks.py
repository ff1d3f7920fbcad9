"""How the page looks: accessibility, colours, languages, and pictures of its main states.

With WOOSH_SCREENSHOTS=docs, the pictures of the documentation, and those that these tests compare
with, are made anew.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import io
import json
import math
import os
import pickle
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from PIL import Image, ImageChops, ImageStat

from tests.quick_chassis import quick_config
from tests.tools.dashboard.browsers import (
    SharedBrowser,
    SimulatedPage,
    actions,
    check_console_and_requests,
    click_at,
    element,
    eventually,
    is_enabled,
    open_page,
    press,
    script,
    set_screen,
    show,
    text,
    wait_for_map,
)
from tests.tools.dashboard.pages import program
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.sentences import AND, SENTENCES, Said
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.dashboard.texts import PAGE, value_data
from woosh_robot_agent.vda5050.intake import OrderCheck
from woosh_robot_agent.vda5050.messages.order import Order
from woosh_robot_agent.vda5050.messages.reading import read_order
from woosh_robot_agent.vda5050.messages.state import RejectedError, VehicleError
from woosh_robot_agent.vda5050.messages.versions import VERSIONS, Identity
from woosh_robot_agent.vda5050.orders.structure import check_structure

pytestmark = pytest.mark.timeout(300)
_DOCS = os.environ.get("WOOSH_SCREENSHOTS")
_PICTURES = Path(__file__).with_name("pictures")
_ROOT = Path(__file__).parents[3]
_AXE = _ROOT / "scripts/page/node_modules/axe-core/axe.min.js"
_SHRINK = 4
"""Factor by which the pictures to compare with are smaller than the screen."""
_TILE = 15
"""Size of the tiles of which the mean colours are compared, in pixels of these pictures."""
_GO = """connection.command("goMark", {mark: "A2", ...store.shownMap.value}).then(({ok, text}) =>
  (store.answer.value = {ok, text, time: 0, robot: 0}))"""
"""Gives a task, whatever the page thinks of it, and shows the answer."""
_TOLERANCE = 20.0
"""Greatest difference of a mean colour, of 255: fonts may differ, but nothing may be missing."""


@pytest.fixture
def robot() -> Iterator[SimulatedPage]:
    """A simulated robot with its page."""
    running = SimulatedPage()
    yield running
    running.close()


@contextmanager
def opened(
    shared_browser: SharedBrowser, url: str, width: int, height: int, *, scheme: str = "light"
) -> Iterator[Any]:
    """Open the page on a screen of this size, and check its console at the end."""
    with shared_browser.window() as driver:
        set_screen(driver, width, height, mobile=width < 1000)
        set_media(driver, **{"prefers-color-scheme": scheme})
        open_page(driver, url)
        yield driver
        check_console_and_requests(driver, url)


def set_media(driver: Any, **features: str) -> None:
    found = [{"name": name, "value": value} for name, value in features.items()]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": found})


def check_accessibility(driver: Any, state: str) -> None:
    """Check that axe finds no violation, after the sheet has appeared."""
    script(driver, "document.getAnimations().forEach((each) => each.finish())")
    driver.execute_script(_AXE.read_text("utf-8"))
    found = driver.execute_async_script(
        "const done = arguments[0];"
        "axe.run(document, {resultTypes: ['violations']}).then(({violations}) => done("
        "  violations.map(({id, nodes}) => `${id}: ${nodes.map(({html, failureSummary}) =>"
        "    html + ' ' + failureSummary)}`)), (error) => done([String(error)]));"
    )
    assert found == [], state


@pytest.mark.skipif(not _AXE.exists(), reason="no axe-core: run npm ci in scripts/page")
@pytest.mark.parametrize(
    ("width", "height", "scheme"), [(1440, 900, "light"), (390, 844, "light"), (1024, 768, "dark")]
)
def test_axe_finds_no_violation(
    robot: SimulatedPage, shared_browser: SharedBrowser, width: int, height: int, scheme: str
) -> None:
    with opened(shared_browser, robot.url, width, height, scheme=scheme) as driver:
        check_accessibility(driver, "standing")
        press(driver, "#layers")
        check_accessibility(driver, "layers")
        press(driver, "#layers")
        for tab in ("go", "tasks", "state", "map", "setup", "simulator"):
            show(driver, tab)
            check_accessibility(driver, tab)
        robot.call(lambda simulator: simulator.inject("emergency_stop"))
        eventually(lambda: text(driver, "#notice"), "the banner")
        show(driver, "state")
        eventually(lambda: text(driver, "#problems"), "the fault")
        check_accessibility(driver, "emergency stop")
        robot.call(lambda simulator: simulator.inject("off"))
        eventually(lambda: script(driver, "store.outdated.value"), "the loss of the link")
        press(driver, "#stop")
        eventually(lambda: text(driver, "#alarm"), "the alarm")
        check_accessibility(driver, "alarm")


def test_colours_have_enough_contrast(robot: SimulatedPage, shared_browser: SharedBrowser) -> None:
    pairs = {
        4.5: [
            "ink paper",
            "faint paper",
            "faint raised",
            "ok ok-tint",
            "warning warning-tint",
            "fault fault-tint",
        ]
        + ["accent paper", "accent tint", "on-accent accent", "ink map-unknown"],
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
    for scheme in ("light", "dark"):
        with opened(shared_browser, robot.url, 1440, 900, scheme=scheme) as driver:
            for least, names in pairs.items():
                for each in names:
                    assert driver.execute_script(contrast, each) >= least, (scheme, each)


def test_forced_colours_and_less_motion_are_respected(
    robot: SimulatedPage, shared_browser: SharedBrowser
) -> None:
    with opened(shared_browser, robot.url, 1440, 900) as driver:
        set_media(driver, **{"forced-colors": "active", "prefers-reduced-motion": "reduce"})
        eventually(
            lambda: script(driver, "matchMedia('(forced-colors: active)').matches"), "the colours"
        )
        canvas = "getComputedStyle(document.body).backgroundColor"
        eventually(
            lambda: script(driver, "mapCanvas.colours['map-floor']") == script(driver, canvas),
            "the map in the colours of the system",
        )
        show(driver, "state")
        moving = "document.getAnimations().filter((each) => each.playState === 'running').length"
        assert script(driver, moving) == 0


def test_both_languages_have_the_same_texts() -> None:
    texts = {
        name: json.loads((PAGE / f"texts/{name}.json").read_text("utf-8")) for name in ("en", "zh")
    }
    assert list(texts["en"]) == list(texts["zh"])
    for key, text_ in texts["en"].items():
        values = {part.split("}")[0] for part in text_.split("{")[1:]}
        others = {part.split("}")[0] for part in texts["zh"][key].split("{")[1:]}
        assert values == others, key


def test_each_sentence_of_the_program_is_in_chinese() -> None:
    for file in (_ROOT / "woosh_robot_agent").rglob("*.py"):
        if "Sentence(" in file.read_text("utf-8"):
            importlib.import_module(".".join(file.relative_to(_ROOT).with_suffix("").parts))
    chinese = json.loads((PAGE / "texts/said.zh.json").read_text("utf-8"))
    assert set(chinese) == set(SENTENCES)
    for key, pattern in SENTENCES.items():
        assert _braces(pattern) == _braces(chinese[key]), key


def test_a_sentence_remains_a_str_with_its_key_in_copies() -> None:
    said = AND(one=Said("nobody", "driver.nobody"), other="unknown")
    for each in (copy.deepcopy(said), pickle.loads(pickle.dumps(said))):
        assert (each, each.key, each.values) == ("nobody, unknown", "said.and", said.values)
        assert value_data(each) == value_data(said)
    assert json.dumps([said]) == '["nobody, unknown"]'


def _braces(pattern: str) -> set[str]:
    return {part.split("}")[0] for part in pattern.split("{")[1:]}


def test_what_the_program_explains_is_in_the_language_of_the_page(
    robot: SimulatedPage, shared_browser: SharedBrowser
) -> None:
    with opened(shared_browser, robot.url, 1440, 900) as driver:
        press(driver, "#language")
        press(driver, "#stop")
        eventually(lambda: text(driver, "#answer").endswith("已停止"), "the stop")
        robot.call(lambda simulator: simulator.inject("emergency_stop"))
        eventually(lambda: script(driver, "store.robot.value.emergencyStop"), "the stop button")
        press(driver, "#marks li:nth-child(2) button")

        def is_refused() -> bool:
            script(driver, _GO)  # shortly after the stop, nothing is sent
            return "急停按钮已按下" in text(driver, "#answer")

        eventually(is_refused, "why it is refused")
        assert "急停按钮已按下" in text(driver, "#now"), "why Go is off"
        refusal = "emergency stop is pressed: release it first"  # of the robot
        check_chinese(driver, "refused", refusal)
        show(driver, "state")
        check_chinese(driver, "emergency stop", refusal)
        show(driver, "go")
        press(driver, "#dismiss")
        robot.call(lambda simulator: simulator.clear_faults())
        eventually(lambda: not script(driver, "store.robot.value.emergencyStop"), "its release")
        pose = robot.call(lambda simulator: simulator.state.pose)
        ahead = {"x": pose.x + 0.7 * math.cos(pose.theta), "y": pose.y + 0.7 * math.sin(pose.theta)}
        robot.call(lambda simulator: simulator.inject("obstacle", radius=0.3, **ahead))

        def is_held_and(seen: bool) -> bool:
            if not script(driver, "store.held.value !== null"):
                stick = element(driver, "#stick")
                actions(driver).release().perform()
                actions(driver).move_to_element(stick).click_and_hold().move_by_offset(
                    0, -50
                ).perform()
            return seen

        eventually(lambda: is_held_and("没有移动" in text(driver, "#notice")), "the standstill")
        check_chinese(driver, "standstill")
        actions(driver).release().perform()
        robot.call(lambda simulator: simulator.clear_faults())
        robot.call(lambda simulator: setattr(simulator, "speed", 0.05))

        press(driver, "#marks li:nth-child(2) button")
        press(driver, "#go")
        eventually(lambda: script(driver, "store.robot.value.task?.running"), "a task")
        eventually(lambda: script(driver, "store.path.value.length > 1"), "its path")
        eventually(lambda: is_held_and("正在执行" in text(driver, "#answer")), "the refusal")
        check_chinese(driver, "stick refused")
        actions(driver).release().perform()
        for tab in ("tasks", "state"):
            show(driver, tab)
            check_chinese(driver, f"task in {tab}")
        code = StatusCode(code=110301000013, level=StatusCode.kFault, msg="电机相线")
        robot.call(lambda simulator: simulator.push(AbnormalCodes(scs=[code])))
        eventually(lambda: "左电机" in text(driver, "#problems"), "the fault")
        check_chinese(driver, "fault")
        robot.call(lambda simulator: simulator.inject("off"))
        eventually(lambda: "无法连接" in text(driver, "#notice"), "why there is no link")
        press(driver, "#stop")
        eventually(lambda: text(driver, "#alarm"), "the alarm")
        press(driver, "#alarm summary")
        assert "未停止" in text(driver, "#alarm")
        assert "未连接" in text(driver, "#alarm")
        assert text(driver, "#alarm").count("未发送") <= 1, "one reason"
        check_chinese(driver, "link lost", "Connect call failed")  # of the operating system


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


def check_chinese(driver: Any, state: str, *robot_texts: str) -> None:
    """Check that what can be read has no Latin words but names and the robot's own texts."""
    read, known = driver.execute_script(_READ)
    read = re.sub("`[a-z]+`", "", read)  # names of fields
    for each in sorted({*known, *robot_texts}, key=len, reverse=True):
        read = re.sub(rf"(?<![A-Za-z]){re.escape(each)}(?![A-Za-z])", "", read)
    words = {word for word in _LATIN.findall(read) if not _NAMES.fullmatch(word)}
    lines = [line for line in read.splitlines() if any(word in line for word in words)]
    assert words == set(), (state, lines)


def vda_errors() -> list[VehicleError]:
    """Return the errors of messages and orders that a vehicle rejects."""
    version, identity = VERSIONS["2.1"], Identity("woosh", "1")
    order = Order("o", 0, (), ())
    rejections: list[Callable[[], object]] = [
        lambda: read_order(b"{", version, identity),
        lambda: read_order(b'{"version": "\xff"}', version, identity),
        lambda: check_structure(order),
        lambda: OrderCheck(order, {}).check(None),
    ]
    errors = []
    for reject in rejections:
        with pytest.raises(RejectedError) as rejected:
            reject()
        errors.append(rejected.value.error)
    return errors


def test_the_page_in_chinese_has_no_other_words(
    shared_browser: SharedBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors = [
        {"type": str(number), "level": each.level.name, "text": value_data(each.description)}
        for number, each in enumerate(vda_errors())
    ]
    order = {"id": "", "node": "", "nodesLeft": 2, "paused": True, "errors": errors}
    connect = Robot.__init__

    def connect_with_order(self: Robot, *args: Any, **options: Any) -> None:
        connect(self, *args, **options)
        self.order = lambda: order

    monkeypatch.setattr(Robot, "__init__", connect_with_order)
    robot = SimulatedPage()
    try:
        with opened(shared_browser, robot.url, 1440, 900) as driver:
            press(driver, "#language")
            eventually(lambda: text(driver, "#tab-go") == "前往", "Chinese")
            press(driver, "#layers")
            check_chinese(driver, "layers")
            press(driver, "#layers")
            for tab in ("fleet", "go", "tasks", "state", "map", "setup", "simulator"):
                show(driver, tab)
                check_chinese(driver, tab, *_LIBRARY_TEXTS)
            show(driver, "simulator")
            for name in script(driver, "store.simulator.value.known.map(({name}) => name)"):
                driver.execute_script(_CHOOSE, element(driver, "#fault-name"), name)
                check_chinese(driver, f"fault {name}")
            for wrong, reason in (("window=1", "至"), ("window", "key=value"), ("by=1", "参数")):
                driver.execute_script(_CHOOSE, element(driver, "#fault-name"), "reorder")
                element(driver, "#fault-arguments").clear()
                element(driver, "#fault-arguments").send_keys(wrong)
                press(driver, "#begin-fault")
                eventually(lambda reason=reason: reason in text(driver, "#answer"), wrong)
                check_chinese(driver, wrong)
            press(driver, "#language")
            eventually(lambda: text(driver, "#tab-go") == "Go", "English")
    finally:
        robot.close()


_CHOOSE = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('change'))"
_LIBRARY_TEXTS = (
    "Expecting property name enclosed in double quotes: line 1 column 2 (char 1)",
    "'utf-8' codec can't decode byte 0xff in position 13: invalid start byte",
)


def test_who_may_only_look_sees_no_commands(shared_browser: SharedBrowser) -> None:
    options = ["--host", "0.0.0.0"]
    with (
        SimulatorThread() as chassis,
        program(chassis, options=options, watch=True) as (_, url),
        opened(shared_browser, url, 390, 844) as driver,
    ):
        assert "token" not in driver.current_url
        eventually(lambda: "only shows" in text(driver, "#now"), "the hint")
        for selector in ("#stop", "#stick", "#owner", "[data-tool=go]"):
            assert driver.find_elements("css selector", selector) == [], selector
        for tab in ("go", "tasks", "state", "map", "setup"):
            show(driver, tab)
            for selector in ("#go", "#charge", "#pause", "#set-pose", "#controlMode"):
                assert driver.find_elements("css selector", selector) == [], (tab, selector)
        show(driver, "go")
        press(driver, "#marks button")
        eventually(lambda: "Rack" in text(driver, "#now"), "what is known of the mark")


def test_the_first_load_is_small(robot: SimulatedPage, shared_browser: SharedBrowser) -> None:
    with opened(shared_browser, robot.url, 1440, 900) as driver:
        size = script(
            driver,
            "performance.getEntriesByType('resource')"
            ".concat(performance.getEntriesByType('navigation'))"
            ".reduce((sum, each) => sum + each.transferSize, 0)",
        )
        assert 50_000 < size <= 300_000


@pytest.mark.parametrize(
    ("name", "width", "height", "scheme"),
    [
        ("standing", 1440, 900, "light"),
        ("preview", 1024, 768, "dark"),
        ("emergency", 768, 1024, "light"),
        ("sheet", 390, 844, "dark"),
        ("low", 844, 390, "light"),
        ("task", 1440, 900, "light"),
        ("fault", 390, 844, "light"),
        ("lost", 1024, 768, "light"),
    ],
)
def test_main_states_look_as_stored(
    robot: SimulatedPage,
    shared_browser: SharedBrowser,
    tmp_path: Path,
    name: str,
    width: int,
    height: int,
    scheme: str,
) -> None:
    with opened(shared_browser, robot.url, width, height, scheme=scheme) as driver:
        if name == "preview":
            press(driver, "#marks li:nth-child(2) button")
            eventually(lambda: " m" in text(driver, "#now .way"), "the way")
        elif name == "emergency":
            robot.call(lambda simulator: simulator.inject("emergency_stop"))
            eventually(lambda: text(driver, "#notice"), "the banner")
        elif name == "sheet":
            show(driver, "go")
            press(driver, "#fit")
        elif name == "task":
            robot.call(
                lambda simulator: setattr(simulator, "speed", 0.05)
            )  # so that it stays there
            press(driver, "#marks li:nth-child(2) button")
            eventually(lambda: is_enabled(driver, "#go"), "the preview")
            press(driver, "#go")
            eventually(lambda: script(driver, "store.path.value.length > 1"), "the path")
            show(driver, "tasks")
        elif name == "fault":
            code = StatusCode(code=11020100001, level=StatusCode.kFault, msg="the brake is stuck")
            robot.call(lambda simulator: simulator.push(AbnormalCodes(scs=[code])))
            eventually(lambda: text(driver, "#notice"), "the banner")
        elif name == "lost":
            robot.call(lambda simulator: simulator.inject("off"))
            eventually(lambda: "doctor" in text(driver, "#notice"), "the banner")
            press(driver, "#stop")
            eventually(lambda: text(driver, "#alarm"), "the alarm of the stop")
        check_picture(driver, name, tmp_path)


@pytest.mark.parametrize(
    ("name", "width", "height"), [("watching", 1024, 768), ("two", 1440, 900), ("nomap", 390, 844)]
)
def test_other_states_look_as_stored(
    shared_browser: SharedBrowser, tmp_path: Path, name: str, width: int, height: int
) -> None:
    options = ["--host", "0.0.0.0"] if name == "watching" else []
    robots = [
        SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=number))
        for number in ((30001, 30002) if name == "two" else (30001,))
    ]
    with contextlib.ExitStack() as running:
        for each in robots:
            running.enter_context(each)
        if name == "nomap":
            robots[0].refuse(full_name(SceneData), "the scene is damaged")
        watch = name == "watching"
        _, url = running.enter_context(program(*robots, options=options, watch=watch))
        driver = running.enter_context(shared_browser.window())
        set_screen(driver, width, height, mobile=width < 1000)
        set_media(driver, **{"prefers-color-scheme": "light"})
        driver.get(url)
        eventually(lambda: script(driver, "globalThis.store?.scan.value != null"), "the laser")
        if name == "nomap":
            eventually(lambda: "No map" in text(driver, "#notice"), "the banner")
            assert "There is no map" in script(driver, "document.querySelector('#panel').innerText")
        else:
            wait_for_map(driver)
        if name == "two":
            show(driver, "fleet")
            eventually(lambda: text(driver, "#fleet").count("Ready") == 2, "the cards")
            eventually(lambda: script(driver, "mapCanvas.picture().others.length") == 1, "both")
        check_picture(driver, name, tmp_path)
        check_console_and_requests(driver, url)


def check_picture(driver: Any, name: str, tmp_path: Path) -> None:
    """Compare the screen with a stored picture."""
    # without the laser, which varies, the battery of a simulated robot that has waited
    script(driver, "document.getAnimations().forEach((each) => each.finish())")
    with Image.open(io.BytesIO(driver.get_screenshot_as_png())) as screen:
        size = screen.width // _SHRINK, screen.height // _SHRINK
        seen = screen.convert("RGB").resize(size)
    path = _PICTURES / f"{name}.png"
    if _DOCS:
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


@pytest.mark.skipif(not _DOCS, reason="makes the pictures of the documentation")
def test_pictures_of_the_documentation(robot: SimulatedPage, shared_browser: SharedBrowser) -> None:
    docs = Path(_DOCS or "")
    with opened(shared_browser, robot.url, 1280, 800) as driver:
        frames = [_frame(driver)]
        goal = script(driver, "store.map.value.marks.find(({number}) => number === 'A2')")
        click_at(driver, goal["x"], goal["y"])
        eventually(lambda: " m" in text(driver, "#now .way"), "the way")
        frames += [_frame(driver)] * 8
        press(driver, "#go")
        show(driver, "tasks")
        at = "[store.pose.value.x, store.pose.value.y]"
        while math.dist((goal["x"], goal["y"]), script(driver, at)) > 0.2:
            frames.append(_frame(driver))
            if len(frames) == 40:
                driver.save_screenshot(str(docs / "dashboard.png"))
        eventually(lambda: "Completed" in text(driver, "#ended"), "the end")
        frames += [_frame(driver)] * 10
        frames[0].save(
            docs / "dashboard.webp",
            save_all=True,
            append_images=frames[1:],
            duration=130,
            loop=0,
            quality=60,
            method=6,
        )
    with opened(shared_browser, robot.url, 390, 844, scheme="dark") as driver:
        press(driver, "#tab-go")
        press(driver, "#marks li:nth-child(3) button")
        press(driver, "#tab-go")
        press(driver, "#fit")
        eventually(lambda: is_enabled(driver, "#go"), "the way")
        driver.save_screenshot(str(docs / "dashboard_phone.png"))


def _frame(driver: Any) -> Image.Image:
    with Image.open(io.BytesIO(driver.get_screenshot_as_png())) as screen:
        return screen.convert("RGB").resize((960, 600))

"""Browsers from the distribution, without a window, and a simulated robot with a page for them."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager, AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar
from unittest import mock
from urllib.parse import urlsplit

import pytest

from tests.asynchronous import TIMEOUT
from tests.quick_chassis import quick_config
from tests.tools.dashboard.pages import SCAN_RATE, is_driving
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard import server
from woosh_robot_agent.tools.dashboard.access import Role
from woosh_robot_agent.tools.dashboard.beside_simulator import dashboard_beside
from woosh_robot_agent.tools.dashboard.control import ControlConfig
from woosh_robot_agent.tools.dashboard.server import Dashboard, DashboardConfig

T = TypeVar("T")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
HEADLESS_SHELL = shutil.which("chromium-headless-shell") or CHROMIUM
"""Chromium without tabs and windows, which needs a third of the processor time."""
FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
FIREFOX_DRIVER = shutil.which("geckodriver")
WEBKIT = next(Path("/usr/lib").glob("*/webkit2gtk-4.*/MiniBrowser"), None)
"""The browser of WebKitGTK, which has the engine of Safari on iPads."""
WEBKIT_DRIVER, X_SERVER = shutil.which("WebKitWebDriver"), shutil.which("Xvfb")
_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    "--force-device-scale-factor=1",
    "--window-size=1280,800",
    "--renderer-process-limit=1",  # of all windows one after the other, as each start costs time
)


class RobotThread(SimulatorThread):
    """A simulated robot in a thread, in which dashboards can run, too.

    Args:
        options: options of the robot.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(quick_config(port=0, tcp_port=0, **options))
        self._contexts = AsyncExitStack()

    def __exit__(self, *error: object) -> None:
        self.end(self._contexts.aclose())
        super().__exit__(*error)

    def begin(self, work: Coroutine[Any, Any, T]) -> Future[T]:
        """Start a coroutine in the thread."""
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine in the thread; return the result."""
        return self.begin(work).result(TIMEOUT)

    def end(self, work: Coroutine[Any, Any, Any]) -> None:
        """Run a coroutine that ends dashboards.

        It does not wait for the idle connections that browsers keep open.
        """
        with mock.patch.object(server, "_CLOSE_TIMEOUT", 0.1):
            self.run(work)

    def enter(self, context: AbstractAsyncContextManager[T]) -> T:
        """Enter a context in the thread, until the end of the simulator."""
        return self.run(self._contexts.enter_async_context(context))

    @contextmanager
    def serving(
        self, *robots: SimulatorThread, watch: bool = False, **options: Any
    ) -> Iterator[str]:
        """Run a dashboard with control of some robots in the thread; yield its address.

        Args:
            robots: the robots, by default this one.
            watch: yield the address at which one can only look.
            options: further options of the dashboard.
        """
        links = [LinkConfig("127.0.0.1", each.port) for each in robots or (self,)]
        # on a busy machine, the page may be told the time late
        patient = ControlConfig(max_age=TIMEOUT)
        usual = {"port": 0, "control": True, "scan_rate": SCAN_RATE, "control_config": patient}
        config = DashboardConfig(**{**usual, **options})
        dashboard = Dashboard(links, config)
        self.run(dashboard.__aenter__())
        url = urlsplit(dashboard.urls[Role.LOOK] if watch else dashboard.url)
        try:
            yield url._replace(netloc=f"127.0.0.1:{url.port}").geturl()
        finally:
            self.end(dashboard.__aexit__(None, None, None))

    def rename(self, name: str) -> None:
        """Give the robot another name, and drop the links, because it is requested after that."""

        def change(simulator: Any) -> None:
            simulator.chassis.setting.identity.name = name
            simulator.drop()

        self.call(change)

    @contextmanager
    def silent(self) -> Iterator[None]:
        """Keep the thread from doing anything; the connections stay open."""
        go_on = threading.Event()
        self._loop.call_soon_threadsafe(go_on.wait, TIMEOUT)
        try:
            yield
        finally:
            go_on.set()


class SimulatedPage(RobotThread):
    """A simulated robot and the page beside it, in a thread; options as for `RobotThread`."""

    def __enter__(self) -> SimulatedPage:
        super().__enter__()
        self._open_page(0)
        return self

    def _open_page(self, port: int) -> None:
        simulator = self.call(lambda simulator: simulator)
        # on a busy machine, the page may be told the time late
        self.url = self.enter(dashboard_beside(simulator, port, SCAN_RATE, max_age=TIMEOUT))

    def close_page(self) -> None:
        """End the dashboard."""
        self.end(self._contexts.aclose())

    def restart_page(self) -> None:
        """End the dashboard, and start another one at the same port."""
        self.close_page()
        self._open_page(urlsplit(self.url).port or 0)


class Browser:
    """A window of a browser that shows the page; `driver` is the one of Selenium."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        driver.set_page_load_timeout(TIMEOUT)
        driver.set_script_timeout(TIMEOUT)

    @contextmanager
    def new_window(self) -> Iterator[None]:
        """Open a window; close all windows that were opened meanwhile at the end."""
        from selenium.webdriver.common.actions.action_builder import ActionBuilder

        driver = self.driver
        first = driver.current_window_handle
        driver.switch_to.new_window("window")
        driver.set_window_size(1280, 800)
        driver.get_log("browser")
        try:
            yield
        finally:
            ActionBuilder(driver).clear_actions()  # releases keys and pointers
            for handle in driver.window_handles:
                if handle != first:
                    driver.switch_to.window(handle)
                    driver.close()
            driver.switch_to.window(first)

    def open(self, url: str) -> None:
        """Open the page, and wait until it shows the map and the laser."""
        self.driver.get(url)
        self.wait_for_map()

    def wait_for_map(self) -> None:
        known = "globalThis.mapCanvas?.area != null && store.scan.value !== null"
        eventually(lambda: self.script(known), "the map and the laser")

    def script(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        return self.driver.execute_script(f"return {expression}")

    def element(self, selector: str) -> Any:
        return self.driver.find_element("css selector", selector)

    def elements(self, selector: str) -> list[Any]:
        return list(self.driver.find_elements("css selector", selector))

    def text(self, selector: str) -> str:
        """Return what can be read of the first element; empty if there is none."""
        found = f"document.querySelector({json.dumps(selector)})"
        return str(self.script(f"{found}?.innerText.trim() ?? ''"))

    def is_enabled(self, selector: str) -> bool:
        """Return True if there is a control that can be pressed."""
        found = f"document.querySelector({json.dumps(selector)})"
        return bool(self.script(f"{found}?.matches(':enabled:not([aria-disabled=true])')"))

    def press(self, selector: str) -> None:
        """Press a control as soon as it can be pressed."""
        from selenium.common.exceptions import WebDriverException

        def is_pressed() -> bool:
            try:
                control = self.element(selector)
                if not control.is_enabled():  # new buttons are disabled for a moment
                    return False
                control.click()
            except WebDriverException:  # not there yet, or something moves over it
                return False
            return True

        eventually(is_pressed, f"{selector} to be pressed")

    def show(self, tab: str) -> None:
        """Show a tab of the panel."""
        self.press(f"#tab-{tab}")

    def choose_mark(self, row: int = 2) -> None:
        """Choose the mark in a row of the list, and wait until the robot can be sent there."""
        self.press(f"#marks li:nth-child({row}) button")
        eventually(lambda: " m" in self.text("#now .way"), "the length of the way")
        eventually(lambda: self.is_enabled("#go"), "Go")

    def middle(self, selector: str) -> tuple[float, float]:
        """Return the middle of an element, in pixels."""
        box = self.element(selector).rect
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def map_corners(self) -> list[list[float]]:
        """Return the corners of the map's picture on the canvas, in pixels."""
        pixels = "mapCanvas.corners(mapCanvas.area).map(({x, y}) => mapCanvas.view.toScreen(x, y))"
        return list(self.script(f"{pixels}.map(({{x, y}}) => [x, y])"))

    def click_at(self, x: float, y: float, drag: tuple[int, int] | None = None) -> None:
        """Press a place of the map, in metres, and release it there or after a drag in pixels."""
        at = self.script(f"mapCanvas.view.toScreen({x}, {y})")
        size = self.script("[mapCanvas.view.width, mapCanvas.view.height]")
        offset = round(at["x"] - size[0] / 2), round(at["y"] - size[1] / 2)
        chain = self.actions().move_to_element_with_offset(self.element("#map"), *offset)
        if drag is None:
            chain.click().perform()
        else:
            chain.click_and_hold().move_by_offset(*drag).release().perform()

    def actions(self) -> Any:
        """Return an empty chain of actions of the mouse and the keyboard."""
        from selenium.webdriver import ActionChains

        return ActionChains(self.driver, duration=50)

    def release(self) -> None:
        """Release the mouse."""
        self.actions().release().perform()

    def push_stick(self) -> None:
        """Press the stick and push it ahead."""
        stick = self.element("#stick")
        self.actions().move_to_element(stick).click_and_hold().move_by_offset(0, -50).perform()

    def hold_stick(self, until: Callable[[], Any], what: str = "the robot to drive") -> None:
        """Push the stick ahead and keep it there until a condition is true.

        On a busy machine, the connection to the dashboard may be too slow for a moment.
        """

        def is_done() -> Any:
            if not self.script("store.held.value !== null"):
                self.release()
                self.push_stick()
            return until()

        eventually(is_done, what)

    def drive(self, robot: SimulatorThread) -> None:
        """Push the stick ahead and keep it there until the robot drives."""
        self.hold_stick(lambda: is_driving(robot))

    def touch(self, kind: str, *places: tuple[float, float]) -> None:
        """Touch the screen: `touchStart`, `touchMove` or `touchEnd`.

        Args:
            kind: what happens.
            places: where each finger is then, in pixels; the order of the fingers stays.
        """
        points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(places)]
        self.send("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    def send(self, command: str, **parameters: Any) -> None:
        """Send a command of the DevTools protocol of Chromium."""
        self.driver.execute_cdp_cmd(command, parameters)

    def set_screen(self, width: int, height: int, ratio: float = 1) -> None:
        """Give the window the size of a device, in pixels; the page gets it soon afterwards."""
        size = {"width": width, "height": height, "mobile": width < 1000}
        self.send("Emulation.setDeviceMetricsOverride", **size, deviceScaleFactor=ratio)

    def resize(self, width: int, height: int, ratio: float = 1) -> None:
        """Give the window another size, and wait until the page is drawn at that size."""
        self.set_screen(width, height, ratio)
        size = [width, height]
        eventually(lambda: self.script("[innerWidth, innerHeight]") == size, f"the size {size}")
        self.wait_for_frame()

    def wait_for_frame(self) -> None:
        """Wait until the page is drawn with everything that has changed."""
        drawn = "setTimeout(() => requestAnimationFrame(() => setTimeout(done)))"
        self.script(f"new Promise((done) => {drawn})")

    def set_media(self, **features: str) -> None:
        found = [{"name": name, "value": value} for name, value in features.items()]
        self.send("Emulation.setEmulatedMedia", features=found)

    def check_console_and_requests(self, url: str) -> None:
        """Check that the page reported no error, and asked nobody but the dashboard.

        Its Content-Security-Policy keeps requests to others from being sent, and Chromium reports
        each of them.
        """
        host = urlsplit(url).netloc
        # on a busy machine, the page may give up a connection and look for the dashboard, which
        # Chromium reports by itself
        given_up = f"WebSocket connection to 'ws://{host}/live' failed"
        gone = f"http://{host}/ - Failed to load resource: net::"
        messages = [entry["message"] for entry in self.driver.get_log("browser")]
        assert [each for each in messages if given_up not in each and gone not in each] == []


@contextmanager
def chromium(*, with_tabs: bool = False) -> Iterator[Browser]:
    """Start Chromium, or skip the test if there is none; only `with_tabs` can pages be hidden."""
    if not (CHROMIUM and DRIVER):
        pytest.skip("no Chromium: run scripts/setup --browser (Debian)")
    webdriver = pytest.importorskip("selenium.webdriver", reason="pip install selenium")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM if with_tabs else HEADLESS_SHELL
    for option in _OPTIONS:
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(executable_path=DRIVER)
    driver = webdriver.Chrome(options=options, service=service)
    try:
        yield Browser(driver)
    finally:
        driver.quit()
        service.stop()


@contextmanager
def firefox() -> Iterator[Browser]:
    """Start Firefox, or skip the test if there is none."""
    if not (FIREFOX and FIREFOX_DRIVER):
        pytest.skip("no Firefox: install firefox-esr and geckodriver")
    webdriver = pytest.importorskip("selenium.webdriver", reason="pip install selenium")
    options = webdriver.FirefoxOptions()
    options.binary_location = FIREFOX
    options.add_argument("-headless")
    with _window(webdriver.Firefox(options, webdriver.FirefoxService(FIREFOX_DRIVER))) as browser:
        yield browser


@contextmanager
def webkit() -> Iterator[Browser]:
    """Start WebKit on a display of its own, or skip the test if there is none."""
    if not (WEBKIT and WEBKIT_DRIVER and X_SERVER):
        pytest.skip("no WebKit: run scripts/setup --browser (Debian)")
    webdriver = pytest.importorskip("selenium.webdriver", reason="pip install selenium")
    options = webdriver.WebKitGTKOptions()
    options.binary_location = str(WEBKIT)
    options.add_argument("--automation")
    with subprocess.Popen(
        [X_SERVER, "-displayfd", "1", "-screen", "0", "1400x1000x24"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as display:
        try:
            assert display.stdout is not None
            environment = os.environ | {"DISPLAY": f":{display.stdout.readline().strip()}"}
            environment["LANG"] = "en_US.UTF-8"  # uPlot fails with the language of the locale C
            service = webdriver.WebKitGTKService(WEBKIT_DRIVER, env=environment)
            with _window(webdriver.WebKitGTK(options, service=service)) as browser:
                yield browser
        finally:
            display.terminate()


@contextmanager
def _window(driver: Any) -> Iterator[Browser]:
    try:
        driver.set_window_size(1280, 900)
        yield Browser(driver)
    finally:
        driver.quit()


def write_scene(folder: Path, marks: list[dict[str, Any]], name: str = "hall") -> None:
    """Write a scene with a square map of the same name and these marks."""
    walls = [[-9, -9, 9, -9, 9, 9, -9, 9, -9, -9]]
    maps = [{"name": name, "walls": walls, "marks": marks}]
    (folder / "scene.yaml").write_text(json.dumps({"name": name, "maps": maps}))


def are_apart(one: dict[str, float], other: dict[str, float]) -> bool:
    """Return True if two boxes do not overlap."""
    return any(
        first[start] + first[size] <= second[start]
        for first, second in ((one, other), (other, one))
        for start, size in (("x", "width"), ("y", "height"))
    )


def eventually(condition: Callable[[], Any], what: str) -> Any:
    """Poll a condition until it is true; return its value.

    Each question to the browser costs milliseconds of processor time, so the pauses grow.
    """
    deadline = time.monotonic() + TIMEOUT
    pause = 0.02
    while not (value := condition()):
        assert time.monotonic() < deadline, f"timed out waiting for {what}"
        time.sleep(pause)
        pause = min(1.3 * pause, 0.1)
    return value

"""Chromium from the distribution, headless, and a simulated robot with a page for it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, TypeVar
from urllib.parse import urlsplit

import pytest

from tests.quick_chassis import quick_config
from tests.tools.waiting import TIMEOUT
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator.server import SimulatedChassis
from woosh_robot_agent.tools.dashboard.beside_simulator import dashboard_beside

T = TypeVar("T")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
FIREFOX_DRIVER = shutil.which("geckodriver")
_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    "--force-device-scale-factor=1",
)


def skip_without_browser() -> Any:
    """Import selenium; skip the test if there is no browser."""
    if not (CHROMIUM and DRIVER):
        pytest.skip("no Chromium: run apt-get install chromium chromium-driver (Debian)")
    return pytest.importorskip("selenium.webdriver", reason="pip install selenium")


class SimulatedPage:
    """A simulated robot and its page, in a thread.

    Args:
        options: options of the robot.
    """

    def __init__(self, **options: Any) -> None:
        self._options = {"port": 0, "tcp_port": 0, **options}
        self._ready: Future[str] = Future()
        self._loop: asyncio.AbstractEventLoop
        self._simulator: SimulatedChassis
        self._stopping = asyncio.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()
        self.url = self._ready.result(TIMEOUT)

    async def _run(self) -> None:
        try:
            self._loop = asyncio.get_running_loop()
            async with (
                SimulatedChassis(quick_config(**self._options)) as self._simulator,
                dashboard_beside(self._simulator, 0) as url,
            ):
                self._ready.set_result(url)
                await self._stopping.wait()
        except BaseException as error:
            if self._ready.done():
                raise
            self._ready.set_exception(error)

    def call(self, do: Callable[[SimulatedChassis], T]) -> T:
        """Call `do` in the thread of the simulator; return the result."""

        async def run() -> T:
            return do(self._simulator)

        return asyncio.run_coroutine_threadsafe(run(), self._loop).result(TIMEOUT)

    @contextmanager
    def silent(self) -> Iterator[None]:
        """Keep the thread from doing anything; the connections stay open."""
        go_on = threading.Event()
        self._loop.call_soon_threadsafe(go_on.wait, TIMEOUT)
        try:
            yield
        finally:
            go_on.set()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join(TIMEOUT)


@contextmanager
def chromium(width: int = 1280, height: int = 800) -> Iterator[Any]:
    """Start a browser of its own; yield its driver."""
    webdriver = skip_without_browser()
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for option in (*_OPTIONS, f"--window-size={width},{height}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(executable_path=DRIVER)
    driver = webdriver.Chrome(options=options, service=service)
    try:
        driver.set_page_load_timeout(TIMEOUT)
        driver.set_script_timeout(TIMEOUT)
        yield driver
    finally:
        driver.quit()
        service.stop()


@contextmanager
def firefox(width: int = 1280, height: int = 900) -> Iterator[Any]:
    """Start Firefox, or skip the test if there is none; yield its driver."""
    if not (FIREFOX and FIREFOX_DRIVER):
        pytest.skip("no Firefox: install firefox-esr and geckodriver")
    webdriver = pytest.importorskip("selenium.webdriver", reason="pip install selenium")
    options = webdriver.FirefoxOptions()
    options.binary_location = FIREFOX
    options.add_argument("-headless")
    driver = webdriver.Firefox(options, webdriver.FirefoxService(FIREFOX_DRIVER))
    try:
        driver.set_window_size(width, height)
        driver.set_page_load_timeout(TIMEOUT)
        driver.set_script_timeout(TIMEOUT)
        yield driver
    finally:
        driver.quit()


class SharedBrowser:
    """A browser that is started once, for many tests; each gets a window of its own."""

    def __init__(self) -> None:
        self._running = contextlib.ExitStack()
        self._driver: Any = None

    @contextmanager
    def window(self, width: int = 1280, height: int = 800) -> Iterator[Any]:
        """Open a window; yield the driver.

        Its size is in pixels. All windows that the caller opens are closed at the end.
        """
        if self._driver is None:
            self._driver = self._running.enter_context(chromium())
        driver = self._driver
        first = driver.current_window_handle
        driver.switch_to.new_window("window")
        driver.set_window_size(width, height)
        for log in ("browser", "performance"):
            driver.get_log(log)
        try:
            yield driver
        finally:
            _release_keys_and_pointers(driver)
            for handle in driver.window_handles:
                if handle != first:
                    driver.switch_to.window(handle)
                    driver.close()
            driver.switch_to.window(first)

    def close(self) -> None:
        """End the browser, if it runs."""
        self._driver = None
        self._running.close()


def _release_keys_and_pointers(driver: Any) -> None:
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    ActionBuilder(driver).clear_actions()


def script(driver: Any, expression: str) -> Any:
    """Return the value of a JavaScript expression."""
    return driver.execute_script(f"return {expression}")


def element(driver: Any, selector: str) -> Any:
    return driver.find_element("css selector", selector)


def text(driver: Any, selector: str) -> str:
    """Return what can be read of the first element; empty if there is none."""
    found = f"document.querySelector({json.dumps(selector)})"
    return str(script(driver, f"{found}?.innerText ?? ''"))


def is_enabled(driver: Any, selector: str) -> bool:
    """Return True if there is a control that can be pressed."""
    found = f"document.querySelector({json.dumps(selector)})"
    return bool(script(driver, f"{found}?.matches(':enabled:not([aria-disabled=true])')"))


def press(driver: Any, selector: str) -> None:
    """Press a control as soon as it can be pressed."""
    from selenium.common.exceptions import WebDriverException

    def is_pressed() -> bool:
        try:
            element(driver, selector).click()
        except WebDriverException:  # not there yet, or something moves over it
            return False
        return True

    eventually(is_pressed, f"{selector} to be pressed")


def show(driver: Any, tab: str) -> None:
    """Show a tab of the panel."""
    press(driver, f"#tab-{tab}")


def open_page(driver: Any, url: str) -> None:
    """Open the page, and wait until it shows the map and the laser."""
    driver.get(url)
    wait_for_map(driver)


def wait_for_map(driver: Any) -> None:
    known = "globalThis.mapCanvas?.area != null && store.scan.value !== null"
    eventually(lambda: script(driver, known), "the map and the laser")


def click_at(driver: Any, x: float, y: float, drag: tuple[int, int] | None = None) -> None:
    """Press a place of the map, in metres, and release there or elsewhere, in pixels from it."""
    at = script(driver, f"mapCanvas.view.toScreen({x}, {y})")
    size = script(driver, "[mapCanvas.view.width, mapCanvas.view.height]")
    offset = round(at["x"] - size[0] / 2), round(at["y"] - size[1] / 2)
    chain = actions(driver).move_to_element_with_offset(element(driver, "#map"), *offset)
    if drag is None:
        chain.click().perform()
    else:
        chain.click_and_hold().move_by_offset(*drag).release().perform()


def hold_stick(driver: Any, robot: SimulatedPage) -> None:
    """Push the stick ahead and keep it there until the robot drives.

    On a busy machine, the connection to the dashboard may be too slow for a moment.
    """
    stick = element(driver, "#stick")

    def is_pressed() -> bool:
        if not script(driver, "store.held.value !== null"):
            actions(driver).release().perform()
            actions(driver).move_to_element(stick).click_and_hold().move_by_offset(0, -50).perform()
        return is_driving(robot)

    eventually(is_pressed, "the robot to drive")


def is_driving(robot: SimulatedPage) -> bool:
    return robot.call(lambda simulator: simulator.state.velocity.forward) > 0.05


def is_stopped_by_zero(robot: SimulatedPage) -> bool:
    def stopped(simulator: SimulatedChassis) -> bool:
        zero = simulator.last(full_name(Twist)) == Twist()
        return zero and simulator.state.velocity.forward == 0.0

    return robot.call(stopped)


def check_console_and_requests(driver: Any, url: str) -> None:
    """Check that the page reported no error, and asked nobody but the dashboard."""
    host = urlsplit(url).netloc
    # on a busy machine, the page may give up a connection, which Chromium reports by itself
    given_up = f"WebSocket connection to 'ws://{host}/live' failed"
    messages = [entry["message"] for entry in driver.get_log("browser")]
    assert [each for each in messages if given_up not in each] == []
    urls = requested_urls(driver)
    assert f"ws://{host}/live" in urls
    others = {each for each in urls if urlsplit(each).netloc != host}
    assert {each for each in others if not each.startswith(("data:", "chrome:"))} == set()


def actions(driver: Any) -> Any:
    """Return an empty chain of actions of the mouse and the keyboard."""
    from selenium.webdriver import ActionChains

    return ActionChains(driver, duration=50)


def touch(driver: Any, kind: str, *places: tuple[float, float]) -> None:
    """Touch the screen: `touchStart`, `touchMove` or `touchEnd`.

    Args:
        driver: the browser.
        kind: what happens.
        places: where each finger is then, in pixels; the order of the fingers stays.
    """
    points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(places)]
    driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def set_screen(driver: Any, width: int, height: int, *, mobile: bool = False) -> None:
    """Give the window the size of a device, in pixels; the page gets it soon afterwards."""
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def eventually(condition: Callable[[], Any], what: str) -> Any:
    """Poll a condition until it is true; return its value."""
    deadline = time.monotonic() + TIMEOUT
    while not (value := condition()):
        assert time.monotonic() < deadline, f"timed out waiting for {what}"
        time.sleep(0.02)
    return value


def requested_urls(driver: Any) -> set[str]:
    """Return the addresses of everything that the page has requested since the last call."""
    urls = set()
    for entry in driver.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            urls.add(message["params"]["request"]["url"])
        elif message["method"] == "Network.webSocketCreated":
            urls.add(message["params"]["url"])
    return urls

"""The page in headless Chromium: first load, frames while driving, an hour of messages."""

from __future__ import annotations

import shutil
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from benchmarks.processes import running

_THROTTLING = 4
"""Factor by which the processor of the browser is slowed down while frames are counted."""
_LOADS = 5
"""Number of first loads, of which the median counts."""
_MESSAGES = 40
"""Number of messages of the dashboard that are recorded, and then received again and again."""
_HOUR = 3600.0
_RATE = 32.0
"""Number of messages that a page gets in a second while the robot drives."""
DURATION = 20.0
"""Duration of a full measurement, in seconds. In a shorter one, the page gets fewer messages."""
_TIMEOUT = 60.0
_READY = "globalThis.mapCanvas?.area != null && store.scan.value !== null"


def is_available() -> bool:
    """Return True if there is a browser that can be measured."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return False
    return bool(shutil.which("chromium") and shutil.which("chromedriver"))


def measure(seconds: float, domain: int) -> dict[str, dict[str, float]]:
    """Return the figures of the page beside a simulated robot.

    Args:
        seconds: time for which frames are counted.
        domain: ROS domain of the robot's process.
    """
    command = ("woosh_robot_agent.simulator", "--port", "0", "--tcp-port", "0", "--dashboard", "0")
    with running(*command, domain=domain) as robot, _browser() as driver:
        assert robot.process.stdout is not None
        url = robot.process.stdout.readline().removeprefix("dashboard ready at ").strip()
        return {
            "load": _first_load(driver, url),
            "frames": _frames(driver, seconds),
            "hour": _hour(driver, seconds),
        }


@contextmanager
def _browser() -> Iterator[Any]:
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for option in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"):
        options.add_argument(option)
    options.add_argument("--js-flags=--expose-gc")
    options.add_argument("--enable-precise-memory-info")
    service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
    driver = webdriver.Chrome(options=options, service=service)
    try:
        driver.set_window_size(1440, 900)
        driver.set_script_timeout(10 * _TIMEOUT)
        yield driver
    finally:
        driver.quit()


def _first_load(driver: Any, url: str) -> dict[str, float]:
    """Return the transferred bytes, and the time until the map is drawn, in seconds."""
    times = []
    for _ in range(_LOADS):
        driver.get("about:blank")
        driver.get(url)
        times.append(
            driver.execute_async_script(
                "const done = arguments[0];"
                "(function look() {"
                f"  if ({_READY}) done(performance.now() / 1000);"
                "  else setTimeout(look, 5);"
                "})();"
            )
        )
    size = driver.execute_script(
        "return performance.getEntriesByType('resource')"
        ".concat(performance.getEntriesByType('navigation'))"
        ".reduce((sum, each) => sum + each.transferSize, 0)"
    )
    return {"bytes": float(size), "seconds": statistics.median(times)}


def _frames(driver: Any, seconds: float) -> dict[str, float]:
    """Return frames per second while the stick drives, and the CPU time of the page, in percent."""
    from selenium.webdriver import ActionChains

    driver.execute_cdp_cmd("Performance.enable", {})
    driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": _THROTTLING})
    stick = driver.find_element("css selector", "#stick")
    ActionChains(driver).move_to_element(stick).click_and_hold().move_by_offset(40, -30).perform()
    busy = _busy(driver)
    begin = time.monotonic()
    frames = driver.execute_async_script(
        "const [seconds, done] = arguments; let count = 0, first = 0;"
        "requestAnimationFrame(function next(now) {"
        "  first ||= now; count++;"
        "  if (now - first < 1000 * seconds) requestAnimationFrame(next);"
        "  else done((count - 1) / (now - first) * 1000);"
        "});",
        seconds,
    )
    share = (_busy(driver) - busy) / (time.monotonic() - begin)
    ActionChains(driver).release().perform()
    driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 1})
    return {"rate": float(frames), "busy": 100.0 * share}


def _busy(driver: Any) -> float:
    """Return the time that the page has spent on computing so far, in seconds."""
    metrics = driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "TaskDuration"))


def _hour(driver: Any, seconds: float) -> dict[str, float]:
    """Return the memory of the page, in kB, after a tenth of an hour's messages and after all.

    The page receives messages that it has got before, as fast as it can draw them.
    """
    messages = round(_HOUR * _RATE * seconds / DURATION)
    driver.execute_async_script(
        "const [count, done] = arguments; globalThis.recorded = [];"
        "const receive = connection.received.bind(connection);"
        "connection.received = (data) => {"
        "  recorded.push(data); receive(data);"
        "  if (recorded.length === count) { delete connection.received; done(); }"
        "};",
        _MESSAGES,
    )
    found = {}
    for name, share in (("begin", 0.1), ("end", 0.9)):
        driver.execute_async_script(
            "const [count, done] = arguments; let sent = 0;"
            "requestAnimationFrame(function next() {"
            "  for (let each = 0; each < 40; each++)"
            "    connection.received(recorded[sent++ % recorded.length]);"
            "  if (sent < count) requestAnimationFrame(next); else { gc(); done(); }"
            "});",
            round(messages * share),
        )
        found[name] = driver.execute_script("return performance.memory.usedJSHeapSize") / 1000.0
        found[f"{name}_nodes"] = float(driver.execute_script("return document.all.length"))
    return found

"""Make the pictures of the page for `docs/`: `python3 -m scripts.page_pictures`."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from tests.tools.dashboard.browsers import Browser, SimulatedPage, chromium, eventually
from tests.tools.dashboard.conftest import serving_robots
from tests.tools.dashboard.test_page_looks import (
    bring_about,
    open_without_map,
    serve_to_watch,
    serve_two_robots,
    show_two_robots,
)

_DOCS = Path(__file__).parents[1] / "docs"
_MAIN_STATES = {
    "standing": "Standing",
    "driving": "Driving by hand",
    "task": "Task running",
    "fault": "Fault",
    "emergency": "Emergency stop",
    "position": "Lost position",
    "lost": "Link lost, STOP pressed",
    "watching": "Only looking",
    "two": "Two robots",
    "nomap": "No map",
}
"""Titles of the main states on the sheets."""


def make_film(browser: Browser) -> None:
    """Make the film of a task, and pictures of the page on a computer and on a phone."""
    with SimulatedPage() as robot:
        open_on(browser, robot.url, 1280, 800)
        frames = [_frame(browser)]
        goal = browser.script("store.map.value.marks.find(({number}) => number === 'A2')")
        browser.click_at(goal["x"], goal["y"])
        eventually(lambda: " m" in browser.text("#now .way"), "the way")
        frames += [_frame(browser)] * 8
        browser.press("#go")
        browser.show("tasks")
        shown, left = (math.inf, math.inf), math.inf
        while left > 0.2:
            here = browser.script("[store.pose.value.x, store.pose.value.y]")
            left = math.dist((goal["x"], goal["y"]), here)
            if math.dist(shown, here) < 0.25:
                continue
            shown = here
            frames.append(_frame(browser))
            if len(frames) == 15:
                browser.driver.save_screenshot(str(_DOCS / "dashboard.png"))
        eventually(lambda: "Completed" in browser.text("#ended"), "the end")
        frames += [_frame(browser)] * 10
        compression = {"save_all": True, "loop": 0, "quality": 60, "method": 6}
        first, *others = frames
        first.save(_DOCS / "dashboard.webp", append_images=others, duration=130, **compression)
        open_on(browser, robot.url, 390, 844, "dark")
        browser.press("#tab-go")
        browser.press("#marks li:nth-child(3) button")
        browser.press("#tab-go")
        browser.press("#fit")
        eventually(lambda: browser.is_enabled("#go"), "the way")
        browser.driver.save_screenshot(str(_DOCS / "dashboard_phone.png"))


def _frame(browser: Browser) -> Image.Image:
    with Image.open(io.BytesIO(browser.driver.get_screenshot_as_png())) as screen:
        return screen.convert("RGB").resize((960, 600))


def make_sheet(browser: Browser, width: int, height: int, scale: float, columns: int) -> None:
    """Put the plan of each main state, and the page beside it, on a sheet."""
    cell = round(width * scale), round(height * scale)
    margin, line = 16, 32
    step = 2 * (cell[0] + margin), cell[1] + line
    with Image.open(_DOCS / f"dashboard_plan_{width}.webp") as stored:
        plan = stored.convert("RGB")  # the states below one another
    rows = math.ceil(len(_MAIN_STATES) / columns)
    sheet = Image.new("RGB", (columns * step[0] + margin, rows * step[1] + margin), "#8a93a0")
    for index, (state, title) in enumerate(_MAIN_STATES.items()):
        x, y = margin + index % columns * step[0], line + index // columns * step[1]
        font = ImageFont.load_default(18)
        ImageDraw.Draw(sheet).text((x, y - 26), f"{title}: plan", "#000000", font)
        ImageDraw.Draw(sheet).text((x + step[0] // 2, y - 26), "page", "#000000", font)
        sheet.paste(plan.crop((0, index * cell[1], cell[0], (index + 1) * cell[1])), (x, y))
        with tempfile.NamedTemporaryFile(suffix=".png") as file:
            with _in_state(state, browser, width, height):
                browser.script("document.getAnimations().forEach((each) => each.finish())")
                browser.driver.save_screenshot(file.name)
            with Image.open(file.name) as screen:
                page = screen.convert("RGB").resize(cell, Image.Resampling.LANCZOS)
        sheet.paste(page, (x + step[0] // 2, y))
    sheet.save(_DOCS / f"dashboard_screens_{width}.webp", quality=55, method=6)


@contextmanager
def _in_state(state: str, browser: Browser, width: int, height: int) -> Iterator[None]:
    """Show a page in one of the main states."""
    with ExitStack() as running:
        serve = running.enter_context(serving_robots())
        if state == "nomap":
            browser.set_screen(width, height)
            open_without_map(serve, browser)
        elif state in ("watching", "two"):
            url = (serve_to_watch if state == "watching" else serve_two_robots)(serve)
            open_on(browser, url, width, height)
            if state == "two":
                show_two_robots(browser)
        else:
            robot = running.enter_context(SimulatedPage())
            open_on(browser, robot.url, width, height)
            bring_about(state, robot, browser)
        yield
        browser.release()
        browser.driver.get("about:blank")


def open_on(browser: Browser, url: str, width: int, height: int, scheme: str = "light") -> None:
    browser.set_screen(width, height)
    browser.set_media(**{"prefers-color-scheme": scheme})
    browser.open(url)


def main() -> None:
    with chromium() as browser:
        make_film(browser)
        for width, height, scale, columns in (
            (1440, 900, 0.5, 1),
            (1024, 768, 0.6, 1),
            (768, 1024, 0.5, 2),
            (390, 844, 0.7, 2),
        ):
            make_sheet(browser, width, height, scale, columns)


if __name__ == "__main__":
    main()

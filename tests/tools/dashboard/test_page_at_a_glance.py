"""What the page tells without being asked: calm, the legend, values of the plots, map, speed."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

import pytest

from tests.quick_chassis import set_speed
from tests.tools.dashboard.browsers import Browser, SimulatedPage, eventually

pytestmark = pytest.mark.timeout(300)


def test_what_is_ordinary_looks_like_no_warning(robot: SimulatedPage, browser: Browser) -> None:
    def tone() -> str:
        return str(browser.element("#new-task").get_attribute("class"))

    assert browser.element("button.chip").accessible_name == "No alarms"
    assert browser.text(".mode").split("\n") == ["Automatic", "Task mode"]
    full, charge = (
        browser.script(f"document.querySelector('.battery {each}').getBBox().width")
        for each in ("path", "rect")
    )
    assert 0.5 < charge / full < 0.93, "the charge of 93 % inside the case and beside its contact"
    browser.show("state")
    set_speed(robot, 0.05)
    go = "connection.command('goMark', {mark: 'A2', ...store.shownMap.value})"
    assert browser.script(go)["ok"]
    eventually(lambda: "would be rejected" in browser.text("#new-task"), "the running task")
    assert "warn" not in tone()
    robot.inject("lost_localisation")
    eventually(lambda: "warn" in tone(), "what is not ordinary")
    robot.clear_faults()
    eventually(lambda: browser.text("button.chip") == "No alarms", "the end of the fault")
    # nothing is known to be well before the robot has reported its state
    unknown = "store.robot.value = {...store.robot.value, known: false}"
    later = "new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)))"
    shown = "document.querySelector('button.chip').innerText"
    assert browser.script(f"({unknown}, {later}.then(() => {shown}))") == "0 alarms"


_MARK_PICTURES = """Promise.all([import("/map/draw.js"), import("/map/view.js")])
  .then(([{draw}, {View}]) => ["rack", "charger", "parkspot"].map((type) => {
    const view = Object.assign(new View(), {width: 60, height: 60});
    const canvas = new OffscreenCanvas(60, 60);
    const context = canvas.getContext("2d");
    const picture = {...mapCanvas.picture(), area: undefined, keepout: undefined, scan: undefined,
      pose: undefined, obstacles: [], others: [], zones: [], lanes: [], trail: [], path: [],
      planned: [], marks: [{number: "", type, x: 0, y: 0, theta: 0}]};
    draw({context, view, colours: mapCanvas.colours}, picture);
    return context.getImageData(0, 0, 60, 60).data.join();
  }))"""
"""Pictures of three types of marks at the same place."""


def test_the_map_and_its_lists_say_what_is_what(browser: Browser) -> None:
    browser.press("#layers")
    colour = """(name) => [...document.querySelectorAll(`.menu [name=${name}] ~ svg *`)]
      .flatMap((each) => [getComputedStyle(each).fill, getComputedStyle(each).stroke])"""
    drawn = browser.script("mapCanvas.colours")
    for layer, name in {
        "laser": "laser",
        "path": "accent",
        "footprint": "accent",
        "trail": "faint",
        "marks": "accent",
        "keepout": "fault",
        "zones": "warning",
        "others": "edge",
    }.items():
        assert drawn[name] in browser.script(f"({colour})('{layer}')"), layer
    browser.press("#layers")
    browser.show("go")
    icons = dict(
        browser.script(
            "[...document.querySelectorAll('#marks li')].map((row) => ["
            "row.innerText.split('\\n')[1].split(' · ')[0],"
            "row.querySelector('path').getAttribute('d')])"
        )
    )
    assert {"Rack", "Charger", "Parking place"} <= set(icons)
    assert len({icons[each] for each in ("Rack", "Charger", "Parking place")}) == 3
    assert len(set(browser.script(_MARK_PICTURES))) == 3
    name = "wooshmap · wooshmap"
    assert browser.text("#pointed") == name
    browser.actions().move_to_element(browser.element("#map")).perform()
    eventually(lambda: browser.text("#pointed").endswith(" m"), "the place under the pointer")
    browser.actions().move_to_element(browser.element("#stick")).perform()
    eventually(lambda: browser.text("#pointed") == name, "the map again")


def test_plots_tell_time_and_values_at_the_pointer(browser: Browser) -> None:
    def values() -> list[str]:
        return [each.text for each in browser.elements(".plot figcaption span")]

    browser.script("""connection.command = async () => ({ok: true, data: {samples:
      [[1700, 0.25, 80, 5], [900, 0.5, 75, 6], [0, 0, 70, 7]].map(([age, ...values]) =>
        [Math.floor(Date.now() / 1000) - age, ...values, false])}})""")
    browser.set_screen(1024, 768)
    browser.show("state")
    eventually(lambda: len(browser.elements("#plots .u-over")) == 3, "the plots")
    browser.script("document.querySelector('#plots').scrollIntoView()")
    eventually(lambda: values()[0].endswith(" m/s"), "the last values")
    assert not any(re.match(r"\d\d:\d\d:\d\d", each) for each in values())
    plot = browser.element("#plots .plot:nth-of-type(2) .u-over")
    browser.actions().move_to_element(plot).perform()
    eventually(lambda: ":" in values()[0], "the values at the pointer")
    times, shown = zip(*(each.split(" · ") for each in values()), strict=True)
    assert len(set(times)) == 1
    assert shown == ("0.5 m/s", "75 %", "6 ms")
    browser.actions().move_to_element(browser.element("#stick")).perform()
    eventually(lambda: not any(":" in each for each in values()), "the last values again")
    x, y = browser.middle("#plots .plot:nth-of-type(2) .u-over")
    browser.touch("touchStart", (x, y))
    eventually(lambda: "75 %" in values()[1], "the values at the finger")
    left = plot.rect["x"] + 4
    browser.touch("touchMove", (left + 40, y))
    browser.touch("touchMove", (left, y))
    eventually(lambda: "80 %" in values()[1], "the values where it moves")
    assert "0.25 m/s" in values()[0]
    browser.touch("touchEnd")
    eventually(lambda: not any(":" in each for each in values()), "the last values at the end")


def test_the_trend_and_the_time_left_of_the_battery_are_told_if_it_falls_steadily(
    browser: Browser,
) -> None:
    def facts(*samples: tuple[int, int | None], charged: Sequence[bool] = ()) -> str:
        """Return the facts after these samples: their age in seconds, and the charge in percent."""
        listed = [
            [age, power, index < len(charged) and charged[index]]
            for index, (age, power) in enumerate(samples)
        ]
        return str(
            browser.script(f"""(
          connection.command = async () => ({{ok: true, data: {{samples: {json.dumps(listed)}.map(
            ([age, power, charging]) => [Date.now() / 1000 - age, 0, power, 5, charging])}}}}),
          store.sample.value = [Math.random(), 0, 93, 5, false],  // the clock was set back
          new Promise((resolve) => setTimeout(() => requestAnimationFrame(() => setTimeout(
            () => resolve(document.querySelector("#facts").innerText))))))""")
        )

    browser.show("state")
    eventually(lambda: "93 %" in browser.text("#plots"), "the history")
    # no further samples come from the dashboard
    browser.script("""void (connection.onPart = ((former) => (name, data) =>
      name === "sample" || former(name, data))(connection.onPart))""")
    used = [(1700, 20), (400, 99), (0, 93)]
    assert "-54 % per hour" in facts(*used, charged=(True, False, False))
    assert "per hour" not in facts(*used, charged=(True, True, True))
    steady = [(1700, 76), (1500, 75), (1000, 74), (500, 73), (0, 73)]  # 500 s for each percent
    assert "about 10 h left" in facts(*steady)
    assert "about 40 min left" in facts(*[(age, power - 68) for age, power in steady])
    assert "left" not in facts(*steady, charged=[True] * 5)
    for unsteady in (
        [(1700, 75), (1000, 74), (500, 73), (0, 73)],  # one percent, from begin to end
        [(1700, 76), (1650, 75), (1600, 74), (1550, 73), (0, 73)],  # nothing since
        [(1700, 76), (1500, 75), (1000, 76), (500, 73), (0, 73)],  # up in between
        [(1700, 76), (1500, 75), (1000, 74), (700, None), (500, 73), (0, 73)],  # not seen
        [(40, 76), (30, 75), (20, 74), (10, 73), (0, 73)],  # too short
    ):
        assert "left" not in facts(*unsteady), unsteady


_TELL = """
globalThis.told = [];
new MutationObserver((records) => {
  for (const {target, oldValue} of records) {
    const live = (target.closest ? target : target.parentElement)
      ?.closest("[aria-live], [role=status], [role=alert]");
    const changed = target.closest || target.data !== oldValue;
    if (live && live.ariaLive !== "off" && changed) told.push(live.innerText);
  }
}).observe(document.body, {subtree: true, childList: true, characterDataOldValue: true});
"""
"""Collects what a screen reader tells."""


def test_a_screen_reader_is_not_told_each_metre_of_a_drive_nor_each_second_of_silence(
    robot: SimulatedPage, browser: Browser
) -> None:
    browser.driver.execute_script(_TELL)
    browser.choose_mark()
    browser.press("#go")
    eventually(lambda: browser.script("store.wayLeft.value"), "the way left")
    eventually(lambda: browser.script("store.pose.value.linear > 0.2"), "the drive")
    assert browser.text("#now p").endswith(" m to go · Pause keeps the task; STOP ends it")
    begin = float(browser.script("store.wayLeft.value"))
    browser.script("(told = [])")
    eventually(lambda: float(browser.script("store.wayLeft.value || 0")) < begin - 1.5, "the way")
    assert len(browser.script("told")) < 5, browser.script("told")
    robot.inject("freeze")
    eventually(lambda: "No data for 2 s" in browser.text("#notice"), "the silence")
    assert "No data for 2 s" in browser.text("#link")
    assert any("No data for" in each for each in browser.script("told"))
    browser.script("(told = [])")
    eventually(lambda: "No data for 5 s" in browser.text("#notice"), "more silence")
    assert browser.script("told") == []

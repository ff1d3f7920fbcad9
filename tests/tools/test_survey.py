"""The survey of a robot, and the profile that the simulator learns from it."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Awaitable, Callable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.asynchronous import eventually
from tests.fact_files import FOLDER
from tests.quick_chassis import quick_config
from tests.tools.connections import connected, link
from tests.tools.programs import address
from tests.tools.recordings import recording
from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import CountData, Twist
from woosh_robot_agent.simulator import SimulatedChassis, SimulatorConfig
from woosh_robot_agent.simulator.__main__ import main as simulator_main
from woosh_robot_agent.simulator.profile import SHIPPED_FOLDER, Profile, load_profile
from woosh_robot_agent.simulator.protocol.handlers import QUERIES
from woosh_robot_agent.simulator.protocol.reports import TOPICS
from woosh_robot_agent.simulator.serving.exchange import Received
from woosh_robot_agent.tools.doctor.checks import HttpAnswer
from woosh_robot_agent.tools.doctor.learn import learn, learn_profile, profile_text
from woosh_robot_agent.tools.doctor.observations import Observations, Redactor, SeenFrame
from woosh_robot_agent.tools.doctor.program import main as doctor_main
from woosh_robot_agent.tools.doctor.survey import survey
from woosh_robot_agent.tools.doctor.survey_report import markdown, results

Json = dict[str, Any]

MODE = "woosh.robot.Mode"
BATTERY = "woosh.robot.Battery"
SETTING = "woosh.robot.Setting"
CALL_TASKS = "woosh.task.CallTasks"
UNKNOWN_CODE = 999_999_999_999

CHANGES: Json = {
    "model": {
        "display_model": "Odd 7",
        "length": 900,
        "weight": 77,
        "outline": [[0.45, 0.3], [0.45, -0.3], [-0.45, -0.3], [-0.45, 0.3]],
    },
    "answers": {
        "default": [0.1, 0.11, 0.12],
        "requests": {MODE: [0.9, 0.91, 0.92], BATTERY: [1.4, 1.41, 1.42]},
    },
    "rates": {"pose_speed": 0.6, "scan": 0.5, "scan_push": 1.0},
    "laser": {"angle_min": -1.5, "angle_max": 1.6, "increment": 0.01, "range_max": 12.0},
    "driving": {"max_speed": 0.35, "max_turn_rate": 0.7},
    "battery": {"health": 91, "temp_max": 44},
    "refusals": {
        "always": {SETTING: "not on this model", CALL_TASKS: f"unknown message type {CALL_TASKS}"},
    },
    "status_codes": {"language": "en"},
}
"""What is odd about the surveyed robot."""


def odd_profile(path: Path) -> Path:
    data: Json = yaml.safe_load((SHIPPED_FOLDER / "tr200.yaml").read_text("utf-8"))
    for section, fields in CHANGES.items():
        data[section].update(fields)
    path.write_text(yaml.safe_dump(data))
    return path


def make_odd(simulator: SimulatedChassis) -> None:
    """Add a field that the schema lacks to each answer to Battery."""

    def with_field(codec: object, data: str | bytes) -> str:
        frame = json.loads(data)
        frame["body"]["cellTemps"] = [21, 22]
        return json.dumps(frame)

    simulator.intercept(
        lambda out: [replace(out, damage=with_field) if out.request == BATTERY else out]
    )


@dataclass
class Surveyed:
    """A surveyed robot.

    Attributes:
        results: the content of `survey.json`.
        report: the content of `survey.md`.
        folder: the folder with both.
        recording: a recording of everything that passed.
        odd: the profile of the robot.
        requests: what the robot has received.
    """

    results: Json
    report: str
    folder: Path
    recording: Path
    odd: Profile
    requests: list[Received]


async def drive(port: int) -> None:
    """Drive in a circle, faster than the robot can."""
    async with connected(port) as (client, _):
        while True:
            await client.request(Twist(linear=2.0, angular=2.0))
            await asyncio.sleep(0.1)


async def push_unknown(simulator: SimulatedChassis) -> None:
    while True:
        body = {"joints": [0.5, 1.5], "name": "left arm", "mounted": True}
        simulator.send_raw(json.dumps({"type": "woosh.robot.ArmState", "body": body}))
        code = {"code": str(UNKNOWN_CODE), "msg": "gripper is warm"}
        simulator.send_raw(json.dumps({"type": "woosh.robot.count.StatusCode", "body": code}))
        await asyncio.sleep(0.5)


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> Surveyed:
    """The odd robot, surveyed through a recording proxy while somebody drives it."""
    folder = tmp_path_factory.mktemp("survey")
    odd, made, path = odd_profile(folder / "odd.yaml"), folder / "made", folder / "all.mcap"

    async def make() -> list[Received]:
        config = SimulatorConfig(port=0, tcp_port=0, profile=odd, clock_offset=18000.0)
        async with (
            SimulatedChassis(config) as simulator,
            recording(path, simulator.port, read_period=0.0) as port,
        ):
            make_odd(simulator)
            beside = [
                asyncio.ensure_future(each) for each in (drive(port), push_unknown(simulator))
            ]
            await survey(link(port), made, minutes=0.9, with_names=False)
            for each in beside:
                each.cancel()
                with suppress(asyncio.CancelledError):
                    await each
            return list(simulator.received)

    requests = asyncio.run(make())
    return Surveyed(
        json.loads((made / "survey.json").read_text()),
        (made / "survey.md").read_text(),
        made,
        path,
        load_profile(odd),
        requests,
    )


def near(value: Any) -> Any:
    """Return something that equals a value whose numbers differ by at most 10 %."""
    if isinstance(value, list | tuple):
        return [near(each) for each in value]
    return pytest.approx(value, rel=0.1) if isinstance(value, int | float) else value


@pytest.mark.parametrize("source", ["survey", "recording"])
def test_learned_profile_is_that_of_the_robot(surveyed, tmp_path, source, capsys):
    learned = tmp_path / "my_robot.yaml"
    origin = surveyed.folder if source == "survey" else surveyed.recording
    assert simulator_main(["--learn", str(origin), "--profile", str(learned)]) == 0
    text = learned.read_text()
    data = yaml.safe_load(text)
    for section, fields in CHANGES.items():
        for name, value in fields.items():
            found = data[section][name]
            if name == "default":  # a busy machine adds to it, but not the slow answers to others
                slow = fields["requests"][MODE][0]
                assert 0.9 * value[0] <= found[0] <= found[1] < slow  # found[2]: the longest
            elif isinstance(value, dict):
                for key, each in value.items():
                    one, two = (
                        (found[key], each) if isinstance(each, str) else (found[key][0], each[0])
                    )
                    assert one == near(two), f"{section}.{name}.{key}"
            else:
                assert found == near(value), f"{section}.{name}"
    assert data["tasks"] == yaml.safe_load((SHIPPED_FOLDER / "tr200.yaml").read_text())["tasks"]
    measured = [line for line in text.splitlines() if " samples" in line and ":" in line]
    assert any(line.startswith("  scan_push: ") for line in measured)
    assert not any(line.startswith("  between_jobs: ") for line in measured)
    never = " ".join(line for line in text.splitlines() if line.startswith("#"))
    assert "laser: noise" in never
    assert "rolls_for" in never
    output = capsys.readouterr().out
    assert f": {len(measured)} values of the robot" in output
    assert load_profile(learned).laser.range_max == pytest.approx(surveyed.odd.laser.range_max)


def test_report_names_each_difference(surveyed: Surveyed) -> None:
    differing = {tuple(each["field"]) for each in surveyed.results["profile"] if each["differs"]}
    for section, fields in CHANGES.items():
        for name, value in fields.items():
            keys = [(key,) for key in value] if isinstance(value, dict) else [()]
            for key in keys:
                assert (section, name, *key) in differing
                assert f"- `{'.'.join((section, name, *key))}`: " in surveyed.report
    asked = by_type(surveyed.results["requests"])
    verdicts = [asked[name]["verdict"] for name in (SETTING, CALL_TASKS, MODE)]
    assert verdicts == ["refused", "unknown", "answered"]
    assert f"- Query {SETTING}: refused: 'not on this model'" in surveyed.report
    (field,) = surveyed.results["unknown_fields"]
    assert (field["type"], field["field"], field["values"]) == (BATTERY, "cellTemps", [[21, 22]])
    assert f"- Unknown field `cellTemps` of {BATTERY}: " in surveyed.report
    (unknown,) = surveyed.results["unknown_types"]
    assert unknown["type"] == "woosh.robot.ArmState"
    assert unknown["values"] == [
        {"joints": [0.5, 1.5], "name": "<text of 8 characters>", "mounted": True}
    ]
    (code,) = surveyed.results["status_codes"]
    assert (code["code"], code["text"]) == (UNKNOWN_CODE, "gripper is warm")
    assert "5.0 hours ahead of this computer's" in surveyed.report


def test_report_has_rates_delays_and_sizes(surveyed):
    pushes = by_type(surveyed.results["pushes"])
    scans = pushes["woosh.robot.ScannerData"]
    assert scans["period"]["median"] == pytest.approx(1.0, rel=0.1)
    assert scans["period"]["p99"] >= scans["period"]["median"]
    assert scans["bytes"]["most"] > 1000
    assert pushes["woosh.robot.PoseSpeed"]["count"] > 10
    battery, setting = (by_type(surveyed.results["requests"])[each] for each in (BATTERY, SETTING))
    assert battery["delay"]["median"] == pytest.approx(1.4, rel=0.1)
    assert battery["delay"]["samples"] == battery["accepted"] >= 3
    assert battery["http"]["status"] == 200
    assert battery["http"]["delay"] > 0.0
    assert setting["http"]["ok"] is False


def test_survey_reads_everything_and_changes_nothing(surveyed: Surveyed) -> None:
    sent = {each.type for each in surveyed.requests} - {"woosh.robot.Twist", "woosh.Subscription"}
    assert sent == set(QUERIES)
    kinds = {each.message.req_type for each in surveyed.requests if "CountData" in each.type}
    assert kinds == {CountData.kGet}
    subscribed = {each["type"] for each in surveyed.results["pushes"] if each["subscribed"]}
    assert subscribed >= TOPICS
    # every query is also asked over HTTP
    asked = {each["type"]: each["http"] for each in surveyed.results["requests"]}
    asked.pop("woosh.robot.Twist", None)
    assert {name: http for name, http in asked.items() if not http} == {}
    for name in ("map.SceneMd5", "map.SceneDataEasy", "map.mark.storage.Find", "robot.PlanNavPath"):
        assert asked[f"woosh.{name}"]["ok"] is True


SECRETS = ("wooshmap", "K10", "30001", "172.20.254.63", "RB2000030100000000Z", "left arm")
"""Some of the names, addresses and numbers of the simulated robot."""


def test_names_are_left_out(surveyed: Surveyed) -> None:
    for text in (surveyed.report, (surveyed.folder / "survey.json").read_text()):
        assert [secret for secret in (*SECRETS, "127.0.0.1") if secret in text] == []


def test_names_are_kept_on_request_and_a_refused_robot_info_is_reported(chassis, tmp_path):
    folder = tmp_path / "survey"
    chassis.refuse("woosh.robot.RobotInfo", "not now")
    doctor_main([*address(chassis), "--survey", str(folder), "--minutes", "0.1", "--with-names"])
    found = json.loads((folder / "survey.json").read_text())
    assert found["address"] == f"ws://127.0.0.1:{chassis.port}"
    assert {"wooshmap", "30001"} <= set(found["names"])
    assert by_type(found["requests"])["woosh.robot.RobotInfo"]["refused"] == {"not now": 1}


@pytest.mark.parametrize(
    ("text", "hidden"),
    [
        ("mark K10 of wooshmap is unknown", "mark <name> of <name> is unknown"),
        ("robot 30001 at 172.20.254.63", "robot <name> at <address>"),
        ("no route to 00:1a:2B:3c:4d:5e", "no route to <address>"),
        ("fe80::21a:2bff:fe3c:4d5e%eth0, 2001:db8:0:0:0:0:0:1", "<address>, <address>"),
        ("server fleet.corp.example:80, me@corp.example", "server <address>:80, <address>"),
        ("地址10.1.2.3错误,标记K10", "地址<address>错误,标记<name>"),
        ("woosh.fleet-1.corp.example", "<address>"),
        (
            "unknown woosh.robot.Mode. At 12:30:45 in 1.2.3",
            "unknown woosh.robot.Mode. At 12:30:45 in 1.2.3",
        ),
    ],
)
def test_names_in_the_texts_of_refusals_are_hidden(text: str, hidden: str) -> None:
    found = observed(
        request("woosh.robot.Scene", 1),
        answer("woosh.robot.Scene", 1, {"sceneName": "wooshmap", "robotId": 30001}),
        request("woosh.robot.TaskProc", 2),
        answer("woosh.robot.TaskProc", 2, {"dest": "K10"}),
        request("woosh.robot.Mode", 3),
        answer("error", 3, {}, ok=False, msg=text),
    )
    assert report(found)["requests"][0]["refused"] == {hidden: 1}
    assert report(found, with_names=True)["requests"][0]["refused"] == {text: 1}


def test_a_long_word_is_searched_for_addresses_once() -> None:
    # a search from each of its characters would take hours
    for text in ("x" * 400_000, "a-" * 200_000, "a." * 200_000):
        assert Redactor([]).text(text) == text


def test_values_that_do_not_fit_are_named_without_the_value() -> None:
    body = {"power": "secret"}
    found = observed(request(BATTERY, 1), answer(BATTERY, 1, body), push(BATTERY, [1]))
    assert report(found)["unreadable"] == {
        f"{BATTERY}: power": 1,
        f"{BATTERY}: expected an object": 1,
    }
    assert any("secret" in reason for reason in report(found, with_names=True)["unreadable"])


def test_robot_that_answers_nothing_over_http_is_surveyed() -> None:
    found = observed(request(BATTERY, 1), answer(BATTERY, 1, {"power": 50}), request(MODE, 2))
    made = report(found, http={BATTERY: None}, complete=False, lost=2)
    battery, mode = made["requests"]
    assert (battery["verdict"], battery["http"]) == ("answered", {"status": 0})
    assert (mode["verdict"], mode["http"]) == ("no answer", None)
    text = markdown(made)
    assert "stopped early" in text
    assert "lost connections: 2" in text


def test_a_query_that_was_answered_is_known_although_http_lacks_it() -> None:
    refused = {**answer(MODE, 2, {})[2], "ok": False, "msg": "failed"}
    found = observed(
        *(request(BATTERY, 1), answer(BATTERY, 1, {"power": 50})),
        *(request(MODE, 2), (0.1, True, refused)),
    )
    missing = HttpAnswer(404, "", None, 0.1)
    made = report(found, http={BATTERY: missing, MODE: missing})
    assert [each["verdict"] for each in made["requests"]] == ["answered", "unknown"]


def request(name: str, sn: int, body: Json | None = None) -> tuple[float, bool, Json]:
    return 0.0, False, {"type": name, "sn": sn, "body": body or {}}


def answer(name: str, sn: int, body: Json, **more: Any) -> tuple[float, bool, Json]:
    return 0.1, True, {"type": name, "sn": sn, "body": body, "ok": True, **more}


def push(name: str, body: Any) -> tuple[float, bool, Json]:
    return 0.2, True, {"type": name, "body": body}


def at(t: float, frame: tuple[float, bool, Json]) -> tuple[float, bool, Json]:
    return t, *frame[1:]


def observed(*frames: tuple[float, bool, Json]) -> Observations:
    return Observations(
        SeenFrame(t, 1, by_robot, json.dumps(frame)) for t, by_robot, frame in frames
    )


def report(found: Observations, *, http: Json | None = None, **options: Any) -> Json:
    usual = {"seconds": 1.0, "complete": True, "lost": 0, "address": "", "with_names": False}
    return results(found, http=http or {}, **{**usual, **options})


def by_type(entries: list[Json]) -> dict[str, Json]:
    return {each["type"]: each for each in entries}


def real_logs() -> Iterator[SeenFrame]:
    """Yield the frames of tasks of a real robot, with as many days between two tasks."""
    for number, task in enumerate(json.loads((FOLDER / "real_tasks.json").read_text())):
        began = number * 86400.0
        sn = number + 1
        sent: Json = {"type": task["request"], "sn": sn, "body": {}}
        if task["request"].endswith("ExecTask") and task["task_id"] != "None":
            sent["body"] = {"taskId": task["task_id"]}
        yield SeenFrame(began, 1, False, json.dumps(sent))
        for t, kind, name, body in task["frames"]:
            frame: Json = {"type": name, "body": body}
            if kind == "answer":
                text = task["refused"] or ""
                frame = {"type": "", "body": {}, "sn": sn, "ok": not text, "msg": text}
            elif kind != "push":
                frame["sn"] = 1000 + sn
            yield SeenFrame(began + t, 1, kind in ("answer", "push"), json.dumps(frame))


def test_real_logs_show_what_they_contain_and_teach_what_the_profile_says() -> None:
    found = report(Observations(real_logs()))
    asked = by_type(found["requests"])
    assert set(asked["woosh.robot.ExecTask"]["refused"]) == {
        "Request failed",
        "Task is excuting,request failed",
        "It is not auto mode,request failed",
    }
    assert sum(each["accepted"] for each in asked.values()) == 38  # 78 answers, 40 refusals
    assert asked["woosh.robot.ActionOrder"]["asked"] == 40
    counts = {each["type"]: each["count"] for each in found["pushes"]}
    assert (counts["woosh.robot.TaskProc"], counts[MODE], counts[BATTERY]) == (338, 26, 15)
    assert found["unknown_fields"] == found["unknown_types"] == []
    assert (found["unreadable"], found["clock"]) == ({}, None)
    values = learn(Observations(real_logs()))
    firsts, samples = values[("tasks", "first_report")]
    assert (firsts[3], samples) == (pytest.approx(1.0, abs=0.02), 34)
    least, most = values[("tasks", "empty_report")].value
    assert 0.0 <= least <= most <= 0.5
    assert values[("battery", "temp_max")] == (28, 15)
    assert values[("answers", "requests", "woosh.robot.ExecTask")].value[0] <= 0.016
    assert not any(path[0] == "refusals" for path in values)  # the words are known
    profile_text(values, "real logs")


def test_answers_without_most_of_their_fields_teach_what_they_have() -> None:
    found = observed(
        request("woosh.robot.ScannerData", 1),
        answer("woosh.robot.ScannerData", 1, {"rangeMin": 0.1, "rangeMax": 30}),
        request("woosh.robot.General", 2),
        answer("woosh.robot.General", 2, {"modelData": {"length": 4_000_000_000, "width": 800}}),
        request("woosh.robot.Mode", 3),
        answer("error", 3, {}, ok=False),
    )
    values = learn(found)
    assert {path: value for path, (value, _) in values.items()} == {
        ("laser", "range_min"): 0.1,
        ("laser", "range_max"): 30.0,
        ("model", "width"): 800,
        ("refusals", "always", "woosh.robot.Mode"): "Request failed",
    }
    assert "range_max: 30.0  # 1 sample" in profile_text(values, "a robot")


def test_start_delay_is_learned_from_velocities() -> None:
    frames: list[Any] = []
    for number in range(50):
        drive, turn = divmod(number, 10)
        t = drive * 20.0 + turn * 0.1
        sn = number + 1
        if turn == 0:  # a stop of a robot that stands, as from a joystick
            frames.append(at(t - 2.0, request("woosh.robot.Twist", 100 + sn)))
            frames.append(at(t - 1.9, answer("woosh.robot.Twist", 100 + sn, {})))
        frames.append(at(t, request("woosh.robot.Twist", sn, {"linear": 0.3})))
        frames.append(at(t + 0.01, answer("woosh.robot.Twist", sn, {})))
        if turn >= 4:
            moving = push("woosh.robot.PoseSpeed", {"twist": {"linear": 0.3}})
            frames.append(at(t + 0.05, moving))
    values = learn(observed(*frames))
    assert values[("driving", "start_delay")] == (pytest.approx(0.45), 5)
    assert values[("driving", "max_speed")] == (0.3, 30)
    assert values[("rates", "pose_speed")] == (pytest.approx(0.1), 25)


def test_slow_request_changes_the_default_little() -> None:
    frames = []
    for number, delay in enumerate([0.01] * 3 + [0.02] * 3 + [2.0] * 30):
        name = MODE if number < 3 else BATTERY if number < 6 else SETTING
        t, sn = number * 3.0, number + 1
        frames += [at(t, request(name, sn)), at(t + delay, answer(name, sn, {}))]
    values = learn(observed(*frames))
    assert values[("answers", "default")] == ([0.02, 0.02, 0.02], 36)


def test_rate_of_scans_is_not_learned_from_pushes() -> None:
    def pushed(period: float) -> Observations:
        scans = [push("woosh.robot.ScannerData", {"ranges": [number]}) for number in range(5)]
        return observed(*(at(number * period, scan) for number, scan in enumerate(scans)))

    values = learn(pushed(1.0))
    assert values[("rates", "scan_push")].value == 1.0
    assert ("rates", "scan") not in values
    # there are as many scans as pushes
    assert learn(pushed(0.1))[("rates", "scan")].value == 0.1


def test_pushes_to_several_clients_count_once() -> None:
    frames = [
        SeenFrame(t * 0.5, connection, True, json.dumps(push(BATTERY, {"power": t})[2]))
        for t in range(5)
        for connection in (1, 2)
    ]
    (battery,) = report(Observations(frames))["pushes"]
    assert (battery["count"], battery["period"]["median"]) == (5, 0.5)


def survey_while(
    meddle: Callable[[SimulatedChassis], Awaitable[None]],
    is_enough: Callable[[SimulatedChassis], bool],
    folder: Path,
    **timeouts: float,
) -> Json:
    """Survey a simulated robot while a function meddles with it; return the results."""

    async def make() -> None:
        async with SimulatedChassis(quick_config(port=0, tcp_port=0)) as simulator:
            config = link(simulator.port, **timeouts)
            making = asyncio.ensure_future(survey(config, folder, minutes=5.0, with_names=False))
            await meddle(simulator)
            await eventually(lambda: is_enough(simulator))
            signal.raise_signal(signal.SIGINT)  # Ctrl-C ends a survey early
            await making

    asyncio.run(make())
    found: Json = json.loads((folder / "survey.json").read_text())
    assert found["complete"] is False
    return found


def is_past(simulator: SimulatedChassis, name: str, times: int = 1) -> bool:
    """Return True if a query was sent so many times, also over HTTP, and then another one."""
    return simulator.counts[name] >= times and simulator.received[-1].type != name


NETWORK = "woosh.robot.Network"
"""A query that comes after Mode."""


def test_lost_connection_is_opened_again_and_the_query_that_ends_it_is_asked_twice(tmp_path):
    async def cut(simulator: SimulatedChassis) -> None:
        simulator.inject("truncated", type=MODE, where="wire")

    found = survey_while(cut, lambda simulator: is_past(simulator, NETWORK), tmp_path / "survey")
    asked = by_type(found["requests"])
    assert (asked[MODE]["verdict"], asked[MODE]["asked"]) == ("no answer", 2)
    assert asked[NETWORK]["accepted"] >= 1
    assert found["lost_connections"] == 2


def test_query_without_an_answer_is_asked_twice_and_a_name_that_is_no_utf_8_is_reported(tmp_path):
    def with_field(codec: object, data: str | bytes) -> str:
        frame = json.loads(data)
        frame["body"]["\ud800"] = 1
        return json.dumps(frame)

    async def meddle(simulator: SimulatedChassis) -> None:
        simulator.mute(MODE)
        simulator.intercept(
            lambda out: [replace(out, damage=with_field) if out.request == BATTERY else out]
        )

    # in two rounds, and over HTTP between them
    found = survey_while(
        meddle,
        lambda simulator: is_past(simulator, MODE, 3) and is_past(simulator, BATTERY, 3),
        tmp_path / "survey",
        request_timeout=0.5,
        connect_timeout=0.5,
    )
    asked = by_type(found["requests"])
    assert (asked[MODE]["verdict"], asked[MODE]["asked"]) == ("no answer", 2)
    assert asked[BATTERY]["accepted"] >= 2
    assert found["lost_connections"] == 0
    assert [each["field"] for each in found["unknown_fields"]] == ["\ud800"]


def test_robot_that_ends_each_connection_is_not_flooded(tmp_path):
    async def refuse(simulator: SimulatedChassis) -> None:
        await simulator.wait_received(MODE)
        simulator.inject("accept_then_drop")
        simulator.inject("drop")
        await asyncio.sleep(3.0)

    found = survey_while(refuse, lambda _: True, tmp_path / "survey")
    assert 1 <= found["lost_connections"] <= found["seconds"] + 1  # one per second


def test_a_survey_that_cannot_be_made_or_written_is_told_before(chassis, tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    nowhere, new = tmp_path / "notes.txt" / "survey", tmp_path / "survey"
    for robot, folder, reason in (
        (address(chassis), nowhere, f"error: cannot write {nowhere}: Not a directory"),
        (address(chassis), tmp_path, "is not empty: give --survey a new folder"),
        (["--ip", "127.0.0.1:1"], new, "no survey, because the link to the robot does not open"),
    ):
        assert doctor_main([*robot, "--survey", str(folder), "--minutes", "0.05"]) == 1
        assert reason in capsys.readouterr().err
    assert chassis.counts[MODE] == 0
    assert not new.exists()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("{}", "profile is missing"),
        ("not", "not readable as JSON"),
        ('{"profile": []}', "shows nothing"),
        ('{"profile": [{"field": ["rates", "scan"], "value": -1, "samples": 5}]}', "rates.scan"),
        ('{"profile": [{"field": ["rates", "scan"], "value": 1, "samples": 0}]}', "samples"),
    ],
)
def test_survey_that_cannot_be_used_is_told(tmp_path: Path, content: str, reason: str) -> None:
    (tmp_path / "survey.json").write_text(content)
    with pytest.raises(DataFileError, match=reason):
        learn_profile(tmp_path, tmp_path / "new.yaml")
    assert not (tmp_path / "new.yaml").exists()


def test_a_profile_has_its_values_without_names_and_replaces_no_file(tmp_path: Path) -> None:
    entries = [
        {"field": ["rates", "scan"], "value": 0.3, "samples": 5},
        {"field": ["model", "wheels"], "value": 4, "samples": 1},  # no field of a profile
    ]
    (tmp_path / "survey.json").write_text(json.dumps({"profile": entries}))
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(DataFileError, match=r"notes\.txt: File exists: give --profile a new file"):
        learn_profile(tmp_path, tmp_path / "notes.txt")
    assert "1 values of the robot" in learn_profile(tmp_path, tmp_path / "new.yaml")
    assert load_profile(tmp_path / "new.yaml").rates.scan == 0.3


@pytest.mark.parametrize(
    ("main", "arguments", "error"),
    [
        (doctor_main, ["--survey", "new", "--transport", "tcp"], "--survey needs --transport web"),
        (doctor_main, ["--survey", "new", "--encoding", "protobuf"], "--survey needs --transport"),
        (doctor_main, ["--minutes", "3"], "need --survey"),
        (doctor_main, ["--with-names"], "need --survey"),
        (simulator_main, ["--learn", "new"], "--learn needs --profile FILE"),
        (simulator_main, ["--learn", "none.mcap", "--profile", "new.yaml"], "none.mcap"),
        (simulator_main, ["--learn", ".", "--profile", "new.yaml"], "give the folder of a survey"),
    ],
)
def test_options_that_do_not_fit_are_refused(main, arguments, error, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot = ["--ip", "127.0.0.1"] if main is doctor_main else []
    with pytest.raises(SystemExit) if "needs" in error or "need " in error else nullcontext():
        assert main([*robot, *arguments]) == 1
    assert error in capsys.readouterr().err

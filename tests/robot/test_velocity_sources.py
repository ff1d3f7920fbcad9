"""Several sources that command velocities at the same time."""

from __future__ import annotations

import logging

import pytest

from tests.robot.rig import READY, Rig, StoppedClock
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.robot import who_drives
from woosh_robot_agent.robot.who_drives import WINDOW, Interleaving

FORWARD, ZERO = Twist(linear=0.2), Twist()
LONG = 3600.0
"""Let velocities count as simultaneous for the whole test, even on a slow machine."""


@pytest.mark.parametrize("second", [FORWARD, ZERO])
async def test_two_sources_are_named_and_logged_once(
    second: Twist, caplog: pytest.LogCaptureFixture
) -> None:
    async with Rig(READY, overlap=LONG).running() as rig:
        for _ in range(3):
            await rig.send(FORWARD, "robot/Twist")
            await rig.send(second, "cmd_vel")
            assert rig.watch.velocities.simultaneous == ("cmd_vel", "robot/Twist")
    texts = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert [text.partition(" command")[0] for text in texts] == ["cmd_vel and robot/Twist"]


@pytest.mark.parametrize(
    "sent",
    [
        [(FORWARD, "cmd_vel"), (FORWARD, "cmd_vel"), (ZERO, "cmd_vel"), (FORWARD, "cmd_vel")],
        [(FORWARD, "cmd_vel"), (ZERO, "cmd_vel"), (FORWARD, "robot/Twist")],
        [(FORWARD, "refused"), (FORWARD, "robot/Twist")],
    ],
    ids=["one source", "one after the other", "one is refused"],
)
async def test_one_source_at_a_time_is_fine(sent: list[tuple[Twist, str]]) -> None:
    async with Rig(READY, overlap=LONG).running() as rig:
        for message, source in sent:
            rig.refusal = "State not allow to twist" if source == "refused" else ""
            await rig.send(message, source)
            assert rig.watch.velocities.simultaneous == ()


async def test_a_source_that_falls_silent_may_be_followed_by_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = StoppedClock(monkeypatch, who_drives)
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        clock.now += who_drives.OVERLAP
        await rig.send(FORWARD, "robot/Twist")
        assert rig.watch.velocities.simultaneous == ()
        clock.now += who_drives.OVERLAP / 2
        await rig.send(FORWARD, "cmd_vel")
        assert rig.watch.velocities.simultaneous
        clock.now += who_drives.SHOWN
        assert rig.watch.velocities.simultaneous == ()


@pytest.mark.parametrize(
    ("numbers", "period", "noticed"),
    [
        ([100, 5, 101, 6, 102], 0.1, True),
        ([1, 1, 2, 2, 3, 3], 0.1, True),
        ([7, 100, 8, 101, 9, 10], 0.1, True),
        ([1, 2, 3, 7, 20], 0.1, False),  # one publisher
        ([100, 101, 1, 2, 3], 0.1, False),  # a restarted one
        ([100, 1, 2, 1, 2], WINDOW, False),  # one that is restarted twice
        ([1, 1, 1, 1, 2, 1], 0.1, False),  # many that end soon, e.g. `ros2 topic pub --once`
        ([0, 0, 0, None, None, 2**64 - 1, 2**64 - 1], 0.1, False),  # no numbers
    ],
)
def test_two_publishers_are_noticed(
    numbers: list[int | None], period: float, noticed: bool
) -> None:
    interleaving = Interleaving()
    found = [interleaving.observe(each, 9.0 + i * period) for i, each in enumerate(numbers)]
    assert any(found) is noticed

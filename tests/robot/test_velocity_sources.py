"""Several sources that command velocities at the same time."""

from __future__ import annotations

import logging
import time
from types import SimpleNamespace

import pytest

from tests.link.link_peer import aio
from tests.robot.rig import READY, Rig
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.robot import who_drives
from woosh_robot_agent.robot.who_drives import WINDOW, Interleaving

FORWARD, ZERO = Twist(linear=0.2), Twist()
LONG = 3600.0
"""Let velocities count as simultaneous for the whole test, even on a slow machine."""


@pytest.mark.parametrize("second", [FORWARD, ZERO])
@aio
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
@aio
async def test_one_source_at_a_time_is_fine(sent: list[tuple[Twist, str]]) -> None:
    async with Rig(READY, overlap=LONG).running() as rig:
        for message, source in sent:
            rig.refusal = "State not allow to twist" if source == "refused" else ""
            await rig.send(message, source)
            assert rig.watch.velocities.simultaneous == ()


def test_a_source_that_falls_silent_may_be_followed_by_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = time.monotonic()
    monkeypatch.setattr(who_drives, "time", SimpleNamespace(monotonic=lambda: now))

    @aio
    async def run() -> None:
        nonlocal now
        async with Rig(READY).running() as rig:
            await rig.send(FORWARD, "cmd_vel")
            now += who_drives.OVERLAP
            await rig.send(FORWARD, "robot/Twist")
            assert rig.watch.velocities.simultaneous == ()
            now += who_drives.OVERLAP / 2
            await rig.send(FORWARD, "cmd_vel")
            assert rig.watch.velocities.simultaneous
            now += who_drives.SHOWN
            assert rig.watch.velocities.simultaneous == ()

    run()


class TestInterleaving:
    def noticed(self, *numbers: int | None, step: float = 0.1) -> bool:
        interleaving = Interleaving()
        noticed = [interleaving.observe(n, 9.0 + i * step) for i, n in enumerate(numbers)]
        return any(noticed)

    def test_two_publishers_are_noticed(self):
        assert self.noticed(100, 5, 101, 6, 102)
        assert self.noticed(1, 1, 2, 2)
        assert self.noticed(7, 100, 8, 101, 9, 10)

    def test_one_publisher_is_not(self):
        assert not self.noticed(1, 2, 3, 7, 20)

    def test_a_restarted_publisher_is_not(self):
        assert not self.noticed(100, 101, 1, 2, 3)
        assert not self.noticed(100, 1, 2, 1, 2, step=WINDOW)

    def test_messages_without_a_number_say_nothing(self):
        assert not self.noticed(0, 0, 0, None, None, 2**64 - 1, 2**64 - 1)

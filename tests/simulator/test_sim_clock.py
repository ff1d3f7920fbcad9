"""The robot's clock, which may be wrong."""

from __future__ import annotations

import asyncio

import pytest

from tests.quick_chassis import quick_config
from tests.simulator.sim_wire import TIMEOUT, JsonClient, connected
from woosh_robot_agent.simulator import SimulatedChassis, SimulatorConfig
from woosh_robot_agent.simulator.chassis import TIME_STEP
from woosh_robot_agent.simulator.config import MAX_CLOCK_OFFSET, SEEDED_START

HOUR = 3600.0
CODE, PROC = "woosh.robot.count.StatusCode", "woosh.robot.TaskProc"


@pytest.mark.parametrize("offset", [-9 * HOUR, MAX_CLOCK_OFFSET])
def test_every_time_of_a_message_has_the_offset(offset: float) -> None:
    with connected(speed=20, clock_offset=offset, profile="tr200") as client:
        client.subscribe(CODE, PROC)
        client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
        proc = client.next_push(PROC, lambda body: body.get("state") == 3)
        client.simulator.inject("emergency_stop")
        code = client.next_push(CODE, lambda body: body["code"] == "110201000013")
        frame = client.request("woosh.robot.Mode")
        begin, end = (
            SEEDED_START + offset,
            SEEDED_START + offset + client.simulator.state.elapsed + 1,
        )
        times = [
            proc["time"],
            int(code["time"]) / 1000,
            frame["timestamp"] / 1000,
        ]
        assert all(begin <= each <= end for each in times), (begin, times, end)


def test_clock_of_a_running_robot_jumps(client: JsonClient) -> None:
    def clock() -> float:
        return float(client.request("woosh.robot.Mode")["timestamp"]) / 1000

    def expected() -> float:
        return SEEDED_START + client.simulator.state.elapsed

    elapsed = client.simulator.state.elapsed
    ahead = client.simulator.inject("clock_jump", by=41 * HOUR)
    back = client.simulator.inject("clock_jump", by=-50 * HOUR)
    assert clock() == pytest.approx(expected() - 9 * HOUR, abs=60)
    ahead.clear()
    assert clock() == pytest.approx(expected() - 50 * HOUR, abs=60)
    back.clear()
    assert clock() == pytest.approx(expected(), abs=60)
    assert client.simulator.state.elapsed - elapsed < 600  # the simulated time itself does not jump


def test_offset_is_limited() -> None:
    for offset in (1e10, -1e10, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="more than 10 years"):
            SimulatorConfig(clock_offset=offset)


def lag_after_stall(stall: float, at_most: float) -> float:
    """Let the event loop of a simulator stall, and wait until its lag is small enough.

    Returns:
        The lag, in seconds; a larger one if it stays above `at_most`.
    """

    async def run() -> float:
        loop = asyncio.get_running_loop()
        real, stalled = loop.time, 0.0
        loop.time = lambda: real() + stalled  # type: ignore[method-assign]
        async with SimulatedChassis(quick_config(port=0, tcp_port=0, seed=1)) as simulator:
            while simulator.state.elapsed == 0.0:
                await asyncio.sleep(0.01)
            begin = loop.time() - simulator.state.elapsed
            stalled = stall

            def lag() -> float:
                return loop.time() - begin - simulator.state.elapsed

            while lag() > at_most and loop.time() < begin + stall + TIMEOUT:
                await asyncio.sleep(0)
            return lag()

    return asyncio.run(run())


def test_simulated_time_catches_up_after_a_stall() -> None:
    assert lag_after_stall(8.0, at_most=0.5) <= 0.5


def test_a_long_stall_is_mostly_skipped() -> None:
    assert 3580.0 < lag_after_stall(3600.0, at_most=3591.0) <= 3591.0


def test_every_call_within_a_step_is_made_when_it_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    due = [0.2 * TIME_STEP, 0.6 * TIME_STEP]

    async def run() -> list[tuple[float, float]]:
        loop, made = asyncio.get_running_loop(), []
        async with SimulatedChassis(SimulatorConfig(port=0, tcp_port=0, seed=1)) as simulator:
            chassis, now = simulator.chassis, loop.time()
            for into_step in due:
                # In a later step: calls for the current step are scheduled when they are added.
                chassis.after(
                    chassis.stepped + 2 * TIME_STEP + into_step - chassis.elapsed,
                    lambda: made.append((loop.time(), chassis.elapsed)),
                )
            with monkeypatch.context() as patch:
                patch.setattr(loop, "time", lambda: now)
                while len(made) < len(due):
                    now += 0.001
                    await asyncio.sleep(0)
        return made

    (real, simulated), (later_real, later_simulated) = asyncio.run(run())
    assert later_simulated - simulated == pytest.approx(due[1] - due[0])
    assert later_real - real == pytest.approx(due[1] - due[0], abs=0.1 * TIME_STEP)


def test_the_clock_ends_with_the_seconds_of_a_record(client: JsonClient) -> None:
    """They have 32 bits, which are used up on 19 January 2038."""

    def clock() -> float:
        return float(client.request("woosh.robot.Mode")["timestamp"]) / 1000

    client.subscribe(PROC)
    client.simulator.call(lambda each: setattr(each.chassis, "clock_offset", 2**31 - SEEDED_START))
    assert clock() == 2**31 - 1
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
    client.next_push(PROC, lambda body: body.get("state") == 3)

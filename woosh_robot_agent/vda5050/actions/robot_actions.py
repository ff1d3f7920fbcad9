"""Actions that move the robot or its devices: charging, loads, lift, steps, turns; and speech."""

from __future__ import annotations

import math
from functools import partial

from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.map import storage_edit_pb2
from woosh_robot_agent.pb.map.mark_pb2 import Storages
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, SwitchFootPrint
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak as SpeakRequest
from woosh_robot_agent.pb.ros.action_pb2 import (
    ChargeControl,
    LiftControl,
    LiftControl3,
    StepControl,
)
from woosh_robot_agent.pb.util import action_pb2, robot_pb2
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.actions.performing import (
    ANYWHERE,
    NOT_ON_EDGES,
    ON_NODES,
    REACH,
    Run,
    vehicle_action,
)
from woosh_robot_agent.vda5050.messages.factsheet import (
    NOT_EMPTY,
    STANDSTILL,
    ParameterType,
    choice,
    number,
)
from woosh_robot_agent.vda5050.messages.state import NO_STATE, ActionFailedError

_NO_CHARGER = Sentence("there is no charger within {most} m: drive to one, or name one as {key}")
_NOT_ENDED = Sentence("the robot refused to end its task: {reason}")
_STILL_CHARGES = Sentence("the robot still charges after {seconds} s")
_STATION = "stationName"
_CANCEL_TIMEOUT = 5.0
"""Time to wait after the cancel of a charging task before the robot is backed out, in seconds."""
_CHARGE_TIMEOUT = 30.0
"""Maximum time until the robot reports that it does not charge any more, in seconds."""


@vehicle_action(
    "startCharging",
    NOT_ON_EDGES,
    "dock at a charger and charge; the action ends when the battery is being charged",
    ParameterType(
        _STATION,
        "STRING",
        f"number of the charger's mark, within {REACH:g} m; without it, the nearest one",
        optional=True,
        valid=bool,
        must_be=NOT_EMPTY,
    ),
    blocking=STANDSTILL,
    moves=True,
)
async def start_charging(run: Run) -> None:
    """Dock at a charger and charge, by a task of the robot that continues after this action.

    Do nothing if the robot charges already.
    """
    robot, mark = run.execution.robot, run.parameters.get(_STATION, "")
    await run.wait_for_tasks()
    if not (mark or robot.is_charging):
        mark = await _nearest_charger(run)
        await run.wait_for_tasks()  # a task or a startPause may have come before the answer
    if robot.is_charging:
        return
    run.require_near(mark)
    request = ExecTask(type=task.kCharge, mark_no=mark)
    await run.execution.tasks.perform(request, run.report, lambda: robot.is_charging)


async def _nearest_charger(run: Run) -> str:
    """Return the number of the nearest charger.

    Raises:
        ActionFailedError: there is no charger within reach, the robot does not know its position,
            or it refused to tell its marks.
        LinkError: the robot could not be reached.
    """
    answer = await run.request(storage_edit_pb2.Storages())
    here = run.require_position()
    distances: dict[str, float] = {}
    if isinstance(answer.body, Storages):
        for charger in answer.body.chargers:
            pose = charger.pose.dock if charger.pose.HasField("dock") else charger.pose.real
            distances[charger.identity.no] = math.dist((pose.x, pose.y), here.point)
    nearest = min(distances, key=distances.__getitem__, default=None)
    if nearest is None or distances[nearest] > REACH:
        raise ActionFailedError(_NO_CHARGER(most=f"{REACH:g}", key=_STATION))
    return nearest


@vehicle_action(
    "stopCharging",
    NOT_ON_EDGES,
    "end charging; the robot may back out of the charger",
    blocking=STANDSTILL,
    moves=True,
)
async def stop_charging(run: Run) -> None:
    """Cancel the charging task; if the robot goes on charging, let it back out of the charger."""
    robot = run.execution.robot
    info = robot.info
    if info is None:
        raise ActionFailedError(NO_STATE())
    if info.task_proc.type == task.kCharge and is_unfinished(info.task_proc):
        run.execution.tasks.ended_by_action = True
        answer = await run.link.command(ActionOrder(order=action_pb2.kCancel))
        if not answer.ok:
            run.execution.tasks.ended_by_action = False
            raise ActionFailedError(_NOT_ENDED(reason=answer.reason))
        # a robot that has just confirmed the charge goes on charging after its task
        await run.link.conditions.wait(lambda: not robot.is_charging, _CANCEL_TIMEOUT)
        await run.link.conditions.wait(lambda: run.link.ready, _CHARGE_TIMEOUT)
        await run.wait_until_permitted()
    if robot.is_charging:
        await run.call(ChargeControl(execute_mode=ChargeControl.kExit))
    await run.wait(
        lambda: not robot.is_charging,
        _CHARGE_TIMEOUT,
        _STILL_CHARGES(seconds=f"{_CHARGE_TIMEOUT:g}"),
    )


_LOAD_PARAMETERS = (
    ParameterType(
        _STATION,
        "STRING",
        f"number of the mark at which the robot docks, at most {REACH:g} m away; without it, the "
        "lift moves where the robot stands",
        optional=True,
        valid=bool,
        must_be=NOT_EMPTY,
    ),
    ParameterType("stationType", "STRING", "accepted, but not used", optional=True),
    ParameterType("loadType", "STRING", "accepted, but not used", optional=True),
    ParameterType("loadId", "STRING", "accepted, but not used", optional=True),
)


async def _carry(run: Run, mode: LiftControl.ExecuteMode, direction: task.Direction) -> str:
    """Move the lift where the robot stands, or by a carry task if the action names a mark.

    Args:
        mode: where the lift moves; kUp or kDown.
        direction: direction of the carry task at the mark; kFeeding: load, kCutting: unload.

    Returns:
        The robot's report on its lift; empty after a carry task.
    """
    mark = run.parameters.get(_STATION)
    if mark is None:
        return await run.call(LiftControl(execute_mode=mode))
    await run.wait_for_tasks()
    run.require_near(mark)
    request = ExecTask(type=task.kCarry, direction=direction, mark_no=mark)
    await run.execution.tasks.perform(request, run.report)
    return ""


pick, drop = (
    vehicle_action(name, ON_NODES, description, *_LOAD_PARAMETERS, blocking=STANDSTILL, moves=True)(
        partial(_carry, mode=mode, direction=direction)
    )
    for name, description, mode, direction in (
        ("pick", "take up a load by raising the lift", LiftControl.kUp, task.kFeeding),
        ("drop", "put down the load by lowering the lift", LiftControl.kDown, task.kCutting),
    )
)


_MIN_SPEED = 0.01
"""Lowest permitted speed of a step or turn, in m/s or rad/s."""
_MAX_HEIGHT = 2.0
"""Highest target of the lift, in metres. The robot does not report how high its lift goes."""
_MAX_STEP = 10.0
"""Longest permitted step, in metres."""
_MAX_TURN = 2 * math.pi
"""Widest permitted turn, in radians."""
_FOOTPRINTS = {
    "ORIGINAL": robot_pb2.kOriginal,
    "EXPAND": robot_pb2.kExpand,
    "SPARE": robot_pb2.kSpare,
    "DOCK": robot_pb2.kDock,
}


@vehicle_action(
    "liftTo",
    ANYWHERE,
    "move the lift to a height",
    number(
        "height",
        f"height above the lowest position, in m, at most {_MAX_HEIGHT:g}; the robot may permit "
        "less",
        0.0,
        _MAX_HEIGHT,
    ),
    number("speed", "speed, in m/s; the robot's own if missing", 0.001, optional=True),
    result="report of the robot",
    moves=True,
)
async def lift_to(run: Run) -> str:
    """Move the lift to a height."""
    return await run.call(
        LiftControl3(
            execute_mode=LiftControl3.kAbsolute,
            height=run.parameters["height"],
            speed=run.parameters.get("speed", 0.0),
        )
    )


@vehicle_action(
    "step",
    NOT_ON_EDGES,
    "move straight by a distance, measured by odometry",
    number(
        "distance",
        f"distance in m, at most {_MAX_STEP:g}; negative for backwards",
        -_MAX_STEP,
        _MAX_STEP,
    ),
    number("speed", "speed, in m/s; the robot's own if missing", _MIN_SPEED, optional=True),
    ParameterType("lateral", "BOOL", "true to move left; only on some robots", optional=True),
    result="report of the robot",
    blocking=STANDSTILL,
    moves=True,
)
async def step(run: Run) -> str:
    """Move the robot by a distance: straight, or sideways with `lateral`; then left is positive."""
    kind = StepControl.Step
    mode = kind.kLateral if run.parameters.get("lateral", False) else kind.kStraight
    return await _step(run, mode, run.parameters["distance"])


@vehicle_action(
    "rotate",
    NOT_ON_EDGES,
    "turn on the spot by an angle, measured by odometry",
    number(
        "angle",
        "angle in rad, counter-clockwise, at most one turn either way",
        -_MAX_TURN,
        _MAX_TURN,
    ),
    number("speed", "turn rate, in rad/s; the robot's own if missing", _MIN_SPEED, optional=True),
    result="report of the robot",
    blocking=STANDSTILL,
    moves=True,
)
async def rotate(run: Run) -> str:
    """Turn the robot on the spot by an angle."""
    return await _step(run, StepControl.Step.kRotate, run.parameters["angle"])


async def _step(run: Run, mode: StepControl.Step.Mode, value: float) -> str:
    step = StepControl.Step(mode=mode, value=value, speed=run.parameters.get("speed", 0.0))
    return await run.call(StepControl(steps=[step]))


@vehicle_action(
    "speak",
    ANYWHERE,
    "say a text; the action ends when the robot begins to speak",
    ParameterType("text", "STRING", "text to say", valid=bool, must_be=NOT_EMPTY),
)
async def speak(run: Run) -> None:
    """Say a text."""
    await run.request(SpeakRequest(text=run.parameters["text"]))


@vehicle_action(
    "switchFootprint",
    NOT_ON_EDGES,
    "change the outline with which the robot avoids obstacles, e.g. for a load",
    choice("footprint", _FOOTPRINTS),
)
async def switch_footprint(run: Run) -> None:
    """Change the outline with which the robot avoids obstacles."""
    await run.request(SwitchFootPrint(type=_FOOTPRINTS[run.parameters["footprint"]]))

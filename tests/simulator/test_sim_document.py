"""Every command in the interface document, in its order, waiting only for actions to end.

The bodies have all fields, as from a ROS client. Those that the document leaves out are empty.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.quick_chassis import quick_config
from tests.simulator.sim_wire import Json, JsonClient
from woosh_robot_agent.simulator import SimulatorThread

R = "woosh.robot."
TARGET = {"x": 1.23, "y": 2.34, "theta": 1.57}
NOWHERE = {"x": 0.0, "y": 0.0, "theta": 0.0}
PATH = {"poses": [NOWHERE, TARGET]}
PLAN = {"path": PATH, "mapId": 0, "target": TARGET, "optimal": 0}
NAV_MODE = {"type": 2, "mode": 1, "waitTimeout": 0, "maxSpeed": 0.0, "capacity": 0}
GOAL = {"x": 0.57, "y": 2.54, "theta": 1.57}


def exec_task(mark: str) -> Json:
    return {
        "taskId": "0",
        "type": 1,
        "direction": 0,
        "taskTypeNo": 0,
        "markNo": mark,
        "planPath": {"planPath": []},
        "pose": NOWHERE,
        "custom": "",
    }


COMMANDS: list[tuple[str, Json]] = [
    (R + "InitRobot", {"isRecord": True, "pose": NOWHERE}),
    (R + "InitRobot", {"isRecord": False, "pose": TARGET}),
    (R + "SetRobotPose", {"pose": TARGET}),
    (R + "SetOccupancy", {"occupy": True}),
    (R + "SetMuteCall", {"mute": True}),
    (R + "SetProgramMute", {"mute": True}),
    (R + "SwitchControlMode", {"mode": 1}),
    (R + "SwitchWorkMode", {"mode": 2}),
    (R + "SwitchFootPrint", {"type": 1}),
    (R + "SwitchMap", {"sceneName": "scenex", "mapName": "", "fileDatas": []}),
    (R + "ScannerData", {}),
    (R + "ExecPreTask", {"taskSetId": 666}),
    (R + "ExecTask", exec_task("A23")),
    (R + "ActionOrder", {"order": 2}),
    (R + "ChangeNavPath", {"paths": {"planPath": [PLAN]}}),
    (R + "ChangeNavMode", {"navMode": NAV_MODE, "inPoint": NOWHERE, "outPoint": NOWHERE}),
    (R + "Speak", {"text": "Hello world"}),
    (R + "Twist", {"linear": 0.2, "angular": 0.785, "linearY": 0.0}),
    (R + "Follow", {"type": True}),
    (R + "setting.Identity", {"name": "woow"}),
    (R + "setting.Server", {"ip": "", "port": 0}),
    (R + "setting.AutoCharge", {"allow": True}),
    (R + "setting.AutoPark", {"allow": True}),
    (R + "setting.GoodsCheck", {"allow": True}),
    (R + "setting.Power", {"alarm": 5, "low": 20, "idle": 80, "full": 100}),
    (R + "setting.Sound", {"mute": False, "volume": 50}),
    ("woosh.map.SceneDataEasy", {}),
    ("woosh.task.RepeatTasks", {}),
    ("woosh.task.CallTasks", {}),
]
ACTIONS: list[Json] = [
    {"stepControl": {"action": 1, "avoid": 0, "steps": [{"mode": 1, "speed": 0.5, "value": 2}]}},
    {
        "stepControl": {
            "action": 1,
            "avoid": 0,
            "steps": [{"mode": 2, "speed": 0.78, "value": 3.14}],
        }
    },
    {"liftControl": {"action": 1, "executeMode": 1}},
    {"liftControl": {"action": 1, "executeMode": 2}},
    {"liftControl3": {"action": 1, "executeMode": 1, "speed": 0.2, "height": 0.5}},
    {"liftControl3": {"action": 1, "executeMode": 2, "speed": 0.2, "height": 0.2}},
    {"moveBase": {"action": 1, "poses": [GOAL], "targetPose": GOAL, "executionMode": 0}},
]


@pytest.fixture(params=[1, 100])
def speed(request: Any) -> float:
    return float(request.param)


@pytest.fixture
def simulator(speed: float) -> Iterator[SimulatorThread]:
    """Simulator at each speed. At speed 1, the task is paused far from its end."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, speed=speed)) as simulator:
        yield simulator


def test_documented_commands_succeed_twice(
    simulator: SimulatorThread, client: JsonClient, endpoints: Any, speed: float
) -> None:
    for service in endpoints["info_services"].values():
        client.ask(service["request"])
    for name, body in COMMANDS:
        client.ask(name, body)
    _fast_forward(simulator)
    _run_actions(simulator, client)
    # Repeat from the state in which the first round left the robot.
    for name, body in COMMANDS:
        client.ask(name, body)
    _run_actions(simulator, client)


def test_all_services_twice_then_all_actions_succeed(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    for name, body in COMMANDS + COMMANDS:
        client.ask(name, body)
    client.subscribe("woosh.ros.Feedbacks")
    _fast_forward(simulator)
    for action in ACTIONS:
        _run_action(client, action)


def _fast_forward(simulator: SimulatorThread) -> None:
    """Speed up the simulation for the part of the test that only waits for motion."""

    def speed_up(simulated: Any) -> None:
        simulated.speed = 100.0

    simulator.call(speed_up)


def _run_actions(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe("woosh.robot.TaskProc", "woosh.ros.Feedbacks")
    client.ask(R + "ExecTask", exec_task("A2"))
    client.next_push(R + "TaskProc", lambda body: body["dest"] == "A2" and body["state"] == 7)
    assert simulator.state.following is False
    for action in ACTIONS:
        _run_action(client, action)
    pose = simulator.state.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((0.57, 2.54, 1.57), abs=0.005)
    assert simulator.state.column == pytest.approx(0.7, abs=1e-6)
    assert simulator.state.spoken[-1] == "Hello world"


def _run_action(client: JsonClient, action: Json) -> None:
    client.ask("woosh.ros.CallAction", action)
    end = client.next_push(
        "woosh.ros.Feedbacks", lambda body: body["fbs"][0]["state"] in (1, -1, -2, 5)
    )
    assert end["fbs"][0]["state"] == 1, end

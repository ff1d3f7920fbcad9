"""Sends the robot to a parking place when its battery is low."""

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from woosh_robot_msgs.action import ExecTask
from woosh_robot_msgs.msg import Battery


class ParkWhenLow(Node):
    """Watches the battery and starts one parking task.

    Attributes:
        outcome: Result of the task; empty until it has ended.
    """

    def __init__(self) -> None:
        super().__init__("park_when_low")
        self.outcome = ""
        self._limit = self.declare_parameter("limit", 20).value
        self._mark = self.declare_parameter("mark", "P1").value
        self._is_started = False
        self._tasks = ActionClient(self, ExecTask, "/woosh_robot/robot/ExecTask")
        self._tasks.wait_for_server()
        # The robot pushes changes only. A transient local topic first delivers the last value.
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(Battery, "/woosh_robot/robot/Battery", self._on_battery, latched)

    def _on_battery(self, battery: Battery) -> None:
        if battery.power > self._limit or self._is_started:
            return
        self._is_started = True
        goal = ExecTask.Goal()
        goal.arg.mark_no = self._mark
        goal.arg.type.value = goal.arg.type.K_PARKING
        self._tasks.send_goal_async(goal).add_done_callback(self._on_accepted)

    def _on_accepted(self, sent) -> None:
        sent.result().get_result_async().add_done_callback(self._on_ended)

    def _on_ended(self, result) -> None:
        ret = result.result().result.ret
        parked = ret.state.value == ret.state.K_COMPLETED
        self.outcome = "parked" if parked else f"not parked: {ret.msg}"
        self.get_logger().info(self.outcome)


def main() -> None:
    rclpy.init()
    rclpy.spin(ParkWhenLow())


if __name__ == "__main__":
    main()

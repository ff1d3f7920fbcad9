"""The agent's node, with its parameters declared and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from woosh_robot_agent.logs import log_as
from woosh_robot_agent.parameter import Parameter
from woosh_robot_agent.parameters import PARAMETERS, Settings, check
from woosh_robot_agent.ros_release import on_parameters_set


class ParameterNode(Node):
    """The node `agent`, with its parameters declared and checked.

    Args:
        defaults: defaults by name that override those of `PARAMETERS`.
        options: rclpy's options of a node, e.g. `context` and `parameter_overrides`.

    Attributes:
        settings: current values of the parameters.

    Raises:
        ValueError: a parameter is invalid.
    """

    def __init__(self, defaults: Mapping[str, Any] | None = None, **options: Any) -> None:
        super().__init__("agent", **options)
        self._callback: Callable[[Settings], None] | None = None
        try:
            for each in PARAMETERS:
                initial = (defaults or {}).get(each.name, each.initial)
                self.declare_parameter(each.name, initial, each.descriptor())
            self.settings = check(self._values())
        except BaseException:
            self.destroy_node()
            raise

    def on_change(self, callback: Callable[[Settings], None]) -> None:
        """Accept parameter changes from now on.

        Args:
            callback: called after each change with the previous settings.
        """
        self._callback = callback
        on_parameters_set(self, self._check_change, self._apply_change)

    def _values(self, changed: list[RosParameter] | None = None) -> dict[str, Any]:
        values = {p.name: self._value(p) for p in PARAMETERS}
        values.update((p.name, p.value) for p in changed or () if p.name in values)
        return values

    def _value(self, parameter: Parameter) -> Any:
        if parameter.holds_names:  # an empty list in a file has no type, so rclpy leaves it unset
            return self.get_parameter_or(parameter.name).value or []
        return self.get_parameter(parameter.name).value

    def _check_change(self, changed: list[RosParameter]) -> SetParametersResult:
        log_as(self.get_logger())
        try:
            check(self._values(changed))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_change(self, changed: list[RosParameter]) -> None:
        before, self.settings = self.settings, check(self._values(changed))
        if self._callback is not None:
            self._callback(before)

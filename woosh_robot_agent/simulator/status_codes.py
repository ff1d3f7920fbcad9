"""The status codes that the simulated robot can send, with their texts."""

from __future__ import annotations

from typing import Literal, NamedTuple

from woosh_robot_agent.pb.robot import robot_count_pb2
from woosh_robot_agent.pb.util import action_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.robot.status_codes import meaning

Language = Literal["zh", "en", "none"]
"""Language of the texts of status codes; `none` for codes without a text."""

_Status = robot_count_pb2.StatusCode
_LEVELS = (_Status.kNormal, _Status.kTips, _Status.kWarn, _Status.kFault)
"""Severities by the last digit of a code's number."""


class Code(NamedTuple):
    """A status code.

    Attributes:
        number: number of the code, as in the table of `woosh_robot_agent.robot.status_codes`.
        chinese: text in Chinese. The English text is in that table.
    """

    number: int
    chinese: str

    @property
    def level(self) -> robot_count_pb2.StatusCode.Level:
        """Severity: the last digit of the number."""
        return _LEVELS[self.number % 10]

    def text(self, language: Language) -> str:
        """Return the text in a language; empty for `none`."""
        return {"zh": self.chinese, "en": meaning(self.number), "none": ""}[language]


# Events
NEW_NAVIGATION = Code(130104000000, "收到新的导航任务，开启避障")
DRIVING_STRAIGHT = Code(130104000061, "直行")
TURNING_RIGHT = Code(130104000071, "右转")
TURNING_LEFT = Code(130104000081, "左转")
OBSTACLE_AVOIDED = Code(130104000031, "绕障成功")
CONTROL_AUTOMATIC = Code(140802000051, "已切换到自动模式")
CONTROL_MANUAL = Code(140802000061, "已切换到手动模式")
CONTROL_MAINTENANCE = Code(140802000071, "已切换到维护模式")

# Problems, which are also listed in AbnormalCodes
EMERGENCY_STOP = Code(110201000013, "急停1按下")
LOCALISATION_LOST = Code(130103000012, "定位丢失")
BATTERY_LOW = Code(110401000111, "电源板电压过低")
OBSTACLE_IN_THE_WAY = Code(130104000011, "前方有障碍物")

# Failed jobs
GOAL_OCCUPIED = Code(130101000011, "无可用路径，目标点被占用")
GOAL_UNREACHABLE = Code(130101000021, "无可用路径，目标点不可达")
NAVIGATION_FAILED = Code(140304000012, "导航失败")
CHARGING_FAILED = Code(140501000012, "充电控制失败")
LIFT_FAILED = Code(140502000032, "举升控制失败")
STEPS_FAILED = Code(140506000012, "步进控制失败")
DOCKING_FAILED = Code(130503000012, "二次定位进入失败")
LEAVING_DOCK_FAILED = Code(130505000012, "二次定位退出失败")

# Reasons of refusals
STEP_CONTROL_OCCUPIED = Code(120301000022, "步进控制被占用")
PATH_NOT_NAVIGATING = Code(140801000061, "未在导航中，无法更改路径")
MODE_NOT_NAVIGATING = Code(140801000071, "未在导航中，无法更改导航模式")
NOT_AUTOMATIC = Code(140801000081, "非自动模式，拒绝执行")
SPEED_CONTROL_FORBIDDEN = Code(140801000091, "当前状态不允许速度控制")
TASK_RUNNING = Code(140801000131, "任务正在执行，拒绝执行")
NO_SUCH_TASK_SET = Code(140801000141, "任务集不存在")
MAP_CHANGE_FORBIDDEN = Code(140801000221, "当前状态不允许切换地图")
INITIALISATION_FORBIDDEN = Code(140801000232, "当前状态不允许初始化")
PATH_EMPTY = Code(140801000251, "新路径为空")
PAUSING_FORBIDDEN = Code(140801000271, "当前状态不允许暂停")
WORK_MODE_FORBIDDEN = Code(140801000031, "当前状态不允许切换工作模式")
MAPPING_FORBIDDEN = Code(140801000041, "非自动或部署模式，拒绝建图")
SAVING_FORBIDDEN = Code(140801000051, "非自动或部署模式，拒绝保存地图")
DEPLOYMENT_FORBIDDEN = Code(140801000101, "非部署模式，拒绝部署")
WRONG_UPDATE_PARAMETERS = Code(140701000021, "更新地图参数错误")
SAVING_WHILE_LOST = Code(140703000031, "机器人定位丢失，地图保存失败")
RESUMING_FORBIDDEN = Code(140801000281, "当前状态不允许继续")
NOT_WAITING = Code(140801000291, "不是等待任务，无法结束等待")

CONTROL_MODES = {
    util_robot_pb2.kAuto: CONTROL_AUTOMATIC,
    util_robot_pb2.kManual: CONTROL_MANUAL,
    util_robot_pb2.kMaintain: CONTROL_MAINTENANCE,
}
"""Codes of changes of the control mode, by the new mode."""

_FAILURE_CODES = {
    action_pb2.kCharge: CHARGING_FAILED,
    action_pb2.kCarry: LIFT_FAILED,
    action_pb2.kStepCtrl: STEPS_FAILED,
    action_pb2.kSecondposEnter: DOCKING_FAILED,
    action_pb2.kSecondposQuit: LEAVING_DOCK_FAILED,
}
"""Codes of failed jobs, by the type of the job. All other jobs have `NAVIGATION_FAILED`."""


def failure_code(kind: action_pb2.Type) -> Code:
    """Return the status code that reports the failure of a job of this type in a task."""
    return _FAILURE_CODES.get(kind, NAVIGATION_FAILED)

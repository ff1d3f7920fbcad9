"""Errors of the state from the status codes of the robot."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.vda5050.messages.state import ErrorLevel
from woosh_robot_agent.vda5050.robot.status import code_errors, field_violated

BUSY, IDLE, SCANNER = 120301000022, 140801000071, 110203000012


def codes(*found: tuple[int, StatusCode.Level.ValueType, str]) -> AbnormalCodes:
    return AbnormalCodes(
        scs=[StatusCode(code=code, level=level, msg=text) for code, level, text in found]
    )


def test_warnings_and_faults_are_errors_with_meaning_and_hint() -> None:
    warning, fault = code_errors(
        codes((IDLE, StatusCode.kWarn, ""), (BUSY, StatusCode.kFault, "in its own words"))
    )
    assert (warning.level, fault.level) == (ErrorLevel.WARNING, ErrorLevel.FATAL)
    assert "robot is not navigating" in warning.description
    assert "in its own words (step control is already in use)" in fault.description
    assert fault.references == (("statusCode", str(BUSY)),)
    assert "resolve the cause" in warning.hint


def test_a_code_counts_once_and_lower_levels_are_no_errors() -> None:
    twice = codes((BUSY, StatusCode.kWarn, ""), (BUSY, StatusCode.kWarn, ""))
    assert len(code_errors(twice)) == 1
    assert code_errors(codes((BUSY, StatusCode.kTips, ""))) == ()


def test_a_safety_scanner_that_has_tripped_violates_the_field() -> None:
    assert field_violated(codes((SCANNER, StatusCode.kWarn, "")))
    assert not field_violated(codes((BUSY, StatusCode.kFault, "")))

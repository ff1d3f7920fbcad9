"""The README's tables are those of the code."""

from pathlib import Path

import pytest

from woosh_robot_agent import endpoints
from woosh_robot_agent.standard import table

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_endpoints():
    assert endpoints.markdown() in README


def test_standard_layer():
    assert table.markdown() in README


def test_parameters():
    pytest.importorskip("rclpy")
    from woosh_robot_agent import parameters

    assert parameters.markdown() in README

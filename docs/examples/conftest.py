"""Fixtures for the tests in this folder."""

from woosh_robot_agent.testing import pytest_configure, simulated_chassis, woosh_agent

__all__ = ["pytest_configure", "simulated_chassis", "woosh_agent"]

"""The link's configuration: defaults, addresses and invalid values."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from woosh_robot_agent.link import ChassisClient, LinkConfig


def test_the_defaults_are_those_of_real_chassis() -> None:
    config = LinkConfig()
    assert (config.ip, config.effective_port) == ("169.254.128.2", 5480)
    assert config.address == "ws://169.254.128.2:5480"
    assert (config.transport, config.encoding) == ("websocket", "json")
    assert (config.backoff_min, config.backoff_max) == (0.5, 15.0)
    assert config.liveness_timeout == 10.0
    assert config.max_frame_size == 64 * 1024 * 1024


def test_tcp_has_its_own_default_port() -> None:
    assert LinkConfig(transport="tcp").address == "tcp://169.254.128.2:5481"
    assert LinkConfig(transport="tcp", port=7).effective_port == 7


@pytest.mark.parametrize(
    ("ip", "address"),
    [
        ("robot-7.local", "ws://robot-7.local:5480"),
        ("my_robot", "ws://my_robot:5480"),
        ("robot.", "ws://robot.:5480"),
        ("::1", "ws://[::1]:5480"),
        ("fe80::1%eth0", "ws://[fe80::1%eth0]:5480"),
    ],
)
def test_names_and_addresses_of_every_kind_are_accepted(ip: str, address: str) -> None:
    assert LinkConfig(ip=ip).address == address


@pytest.mark.parametrize(
    "ip",
    ["", "a b", "ws://robot", "[::1]", "a@b", "1.2.3.4:5480", "a..b", ".a", "a%b", "x" * 64,
     "::1::", "a\n"],
)  # fmt: skip
def test_an_ip_that_is_not_a_host_is_refused(ip: str) -> None:
    with pytest.raises(ValueError, match="ip"):
        LinkConfig(ip=ip)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, 0)
          for name in ("request_timeout", "connect_timeout", "handshake_timeout", "close_timeout",
                       "liveness_timeout", "backoff_min", "max_frame_size", "max_in_flight",
                       "push_queue")),
        *(("request_timeout", value) for value in (-1, math.nan, math.inf)),
        ("port", -1), ("port", 65536), ("transport", "udp"), ("encoding", "xml"),
        ("backoff_max", 0.1), ("backoff_max", math.inf), ("backoff_max", math.nan),
        ("stable_after", -1), ("stable_after", math.nan),
    ],
)  # fmt: skip
def test_the_error_names_the_invalid_value(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=name):
        LinkConfig(**{name: value})


@pytest.mark.parametrize(
    ("change", "keeps"),
    [
        ({"request_timeout": 1.0, "connect_timeout": 6.0, "handshake_timeout": 6.0}, True),
        ({"encoding": "protobuf"}, False),
        ({"ip": "10.0.0.2"}, False),
        ({"port": 5479}, False),
        ({"robot_id": 2}, False),
    ],
)
def test_which_changes_keep_the_connection(change: Any, keeps: bool) -> None:
    config = LinkConfig(ip="10.0.0.1")
    assert replace(config, **change).keeps_connection(config) is keeps


def test_the_clients_ip_overrides_the_configurations() -> None:
    config = LinkConfig(ip="a", port=9)
    assert ChassisClient("b", config).config.address == "ws://b:9"
    assert ChassisClient(config=config).config is config
    assert ChassisClient("1.2.3.4").config.address == "ws://1.2.3.4:5480"

"""The generator of interface files: its conventions, proven by the manufacturer's interfaces."""

from __future__ import annotations

import re
import shutil
from itertools import pairwise
from pathlib import Path

import pytest

from scripts.interface_files import InterfaceError, interface_files
from tests.tooling.interface_facts import PACKAGES, facts_of, parts_of

ROOT = Path(__file__).parents[2]
PROTO = ROOT / "proto"


@pytest.fixture(scope="module")
def generated() -> dict[str, str]:
    return interface_files(PROTO)


@pytest.fixture
def proto(tmp_path: Path) -> Path:
    """A copy of proto/ to change."""
    return shutil.copytree(PROTO, tmp_path / "proto")


def generated_parts(
    generated: dict[str, str], package: str
) -> dict[str, list[dict[str, list[str]]]]:
    """Return the parts of a package's files by name (`msg/Mode`), as the facts have them."""
    prefix = f"{package}/"
    return {
        path.removeprefix(prefix).rpartition(".")[0]: parts_of(text)
        for path, text in generated.items()
        if path.startswith(prefix)
    }


ADDED = {
    "woosh_action_msgs": set(),
    "woosh_common_msgs": set(),
    "woosh_map_msgs": {
        "msg/StorageCreate",
        "msg/StorageDelete",
        "msg/StorageFind",
        "msg/StorageStorages",
        "msg/StorageUpdate",
        "srv/Delete",
        "srv/Download",
        "srv/Rename",
        "srv/SceneData",
        "srv/SceneList",
        "srv/SceneMd5",
        "srv/SceneSync",
        "srv/StorageCreate",
        "srv/StorageDelete",
        "srv/StorageFind",
        "srv/StorageStorages",
        "srv/StorageUpdate",
        "srv/Upload",
    },
    "woosh_nav_msgs": set(),
    "woosh_robot_msgs": {
        "action/ExecPreTask",
        "msg/AgentInfo",
        "msg/LED",
        "msg/RfRemoteController",
        "srv/BuildMap",
        "srv/CountData",
        "srv/Deployment",
        "srv/ExecTaskSet",
        "srv/LED",
        "srv/PlanNavPath",
    },
    "woosh_ros_msgs": {"action/ChargeControl", "action/LiftControl2", "action/NavigationMode"},
    "woosh_task_msgs": {"srv/RepeatTask"},
}
"""Types that the manufacturer's packages lack."""


@pytest.mark.parametrize("package", PACKAGES)
def test_the_manufacturers_definitions_are_reproduced(generated, package):
    ours = generated_parts(generated, package)
    facts = facts_of(package)
    assert {name: ours.get(name) for name in facts} == facts
    assert ours.keys() - facts.keys() == ADDED[package]


def test_each_field_and_enum_constant_has_a_comment(generated: dict[str, str]) -> None:
    bare = [
        f"{path}: {line}"
        for path, text in generated.items()
        for before, line in pairwise(text.splitlines())
        if re.match(r"[a-z]\S+ (K_|[a-z])\w*", line) and not before.startswith("#")
    ]
    assert not bare


def test_each_package_declares_the_packages_that_it_uses(generated: dict[str, str]) -> None:
    for package in PACKAGES:
        declared = set(
            re.findall(r"<depend>(\w+)</depend>", (ROOT / package / "package.xml").read_text())
        )
        texts = [text for path, text in generated.items() if path.startswith(f"{package}/")]
        used = {name for text in texts for name in re.findall(r"^(\w+)/\w", text, re.M)}
        if any(path.startswith(f"{package}/action/") for path in generated):
            used.add("action_msgs")
        assert used - {package} <= declared, package


@pytest.mark.parametrize(
    ("addition", "error"),
    [
        ("message ScannerDataOneOfCommu {}", "two definitions .*msg/ScannerDataOneOfCommu.msg"),
        ("message Far { woosh.custom.Anchor anchor = 1; }", "has no ROS message.*custom.Anchor"),
    ],
)
def test_an_unsuitable_schema_is_refused(proto: Path, addition: str, error: str) -> None:
    path = proto / "woosh/proto/robot/robot_pack.proto"
    text = path.read_text().replace(
        "import", 'import "woosh/proto/custom/custom.proto";\nimport', 1
    )
    path.write_text(f"{text}\n{addition}\n")

    with pytest.raises(InterfaceError, match=error):
        interface_files(proto)


def test_a_message_that_an_endpoint_needs_is_missed(proto: Path) -> None:
    path = proto / "woosh/proto/robot/robot_pack.proto"
    path.write_text(path.read_text().replace("message Speak ", "message Talk "))

    with pytest.raises(InterfaceError, match=r"proto/ does not define: woosh\.robot\.Speak"):
        interface_files(proto)

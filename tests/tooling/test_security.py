"""The SROS2 policies, and the script that makes a keystore with them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as xml

import pytest

from scripts import sros2_policies
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, TOPICS
from woosh_robot_agent.ros.standard_endpoints import NAV2, Kind

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "make_keystore"


def names(policy: str, kind: str) -> set[str]:
    """Return the names for which a policy allows an operation, e.g. `topics subscribe`."""
    tag, operation = kind.split(" ")
    found = xml.fromstring(policy).findall(f".//{tag}[@{operation}='ALLOW']/*")
    return {str(each.text) for each in found}


# The policies


def test_a_client_may_use_all_endpoints_but_not_set_parameters() -> None:
    policy = sros2_policies.client_policy()
    services = {f"/woosh_robot/{each.name}" for each in (*QUERIES, *COMMANDS)}
    services |= {"/woosh_robot/cancel", "/woosh_robot/stop"}
    services |= {f"/woosh_robot/{each.name}" for each in NAV2 if "service" in each.kind.value}
    assert names(policy, "services request") == services
    actions = {f"/woosh_robot/{each.name}" for each in ACTIONS}
    actions |= {f"/woosh_robot/{each.name}" for each in NAV2 if each.kind is Kind.ACTION}
    assert names(policy, "actions call") == actions
    topics = {f"/woosh_robot/{each.name}" for each in TOPICS}
    assert names(policy, "topics subscribe") > topics
    assert {"/woosh_robot/odom", "/diagnostics"} <= names(policy, "topics subscribe") - topics
    assert "/woosh_robot/cmd_vel" in names(policy, "topics publish")
    assert "/woosh_robot/agent/" not in policy


def test_a_read_only_client_may_read_by_commands_and_send_none() -> None:
    only = ["map/*", "robot/Pose*", "robot/ExecTask"]
    policy = sros2_policies.client_policy(read_only=True, only=only)
    services = names(policy, "services request")
    assert {f"/woosh_robot/{name}" for name in ("map/SceneList", "map/Download")} <= services
    assert "/woosh_robot/map/Upload" not in services
    assert "/woosh_robot/robot/PoseSpeed" in services
    assert names(policy, "topics subscribe") == {"/woosh_robot/robot/PoseSpeed"}
    assert names(policy, "actions call") == set()


@pytest.mark.parametrize(("namespace", "prefix"), [("/", ""), ("/hall/r2", "/hall/r2")])
def test_policies_can_be_made_for_another_namespace(namespace: str, prefix: str) -> None:
    agent = sros2_policies.agent_policy(namespace)
    assert f"{prefix}/robot/Mode" in names(agent, "services reply")
    assert f"{prefix}/agent/set_parameters" in names(agent, "services reply")
    assert xml.fromstring(agent).find(f".//enclave[@path='{prefix}/agent']") is not None
    profile = xml.fromstring(agent).find(f".//profile[@ns='{prefix or '/'}']")
    assert profile is not None
    assert profile.get("node") == "agent"
    client = sros2_policies.client_policy(namespace, "/ui/panel")
    assert f"{prefix}/robot/Mode" in names(client, "services request")
    assert xml.fromstring(client).find(f".//enclave[@path='{prefix}/ui/panel']") is not None
    assert "woosh_robot/" not in agent + client


def test_clock_is_allowed_only_with_simulated_time() -> None:
    assert "/clock" not in sros2_policies.agent_policy() + sros2_policies.client_policy()
    inputs = names(sros2_policies.agent_policy(), "topics subscribe")
    assert names(sros2_policies.agent_policy(sim_time=True), "topics subscribe") - inputs == {
        "/clock"
    }


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["agent", "--namespace", "woosh_robot"], "not an absolute ROS name"),
        (["agent", "--namespace", "/a/*"], "not an absolute ROS name"),
        (["client", "--node", "/a/"], "not an absolute ROS name"),
        (["client", "--only", "robot/pose*"], "no endpoint matches"),
        (["client", "--read-only", "--only", "robot/Speak"], "only commands and actions match"),
        (["client", "--read-only", "--only", "Pose", "--only", "cmd_vel"], "no endpoint matches"),
    ],
)
def test_bad_arguments_are_refused(arguments, complaint, capsys):
    with pytest.raises(SystemExit) as ended:
        sros2_policies.main(arguments)
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err


# The script

FAKE_ROS2 = """#!/usr/bin/env bash
# Logs its arguments, and creates the files that the real one creates.
echo "$ROS_DOMAIN_ID $*" >>"$NOTES"
[ "$3" != --help ] || exit "${WITHOUT_SROS2:-0}"
case $2 in
  --help) exit "${WITHOUT_SROS2:-0}" ;;
  create_keystore)
    mkdir -p "$3/enclaves" && touch "$3/enclaves/governance.p7s"
    echo "<id>$ROS_DOMAIN_ID</id>" >"$3/enclaves/governance.xml"
    ;;
  create_enclave) mkdir -p "$3/enclaves$4" && touch "$3/enclaves$4/key.pem" ;;
  create_permission) cp "$5" "$3/enclaves$4/policy" ;;
esac
"""

_TOOLS = ["bash", "env", "cat", "cp", "dirname", "find", "grep", "mkdir", "mktemp", "rm", "sed"]
_TOOLS += ["sort", "touch"]


class Keystore:
    """Environment of the script: a fake `ros2` on its PATH, and a path for the keystore."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "key store"
        self.notes = folder / "notes"
        self.bin = folder / "bin"
        self.bin.mkdir()
        for tool in _TOOLS:
            self._link(tool, shutil.which(tool))
        self._link("python3", sys.executable)
        self.fake = self.bin / "ros2"
        self.fake.write_text(FAKE_ROS2)
        self.fake.chmod(0o755)

    def _link(self, tool: str, target: str | None) -> None:
        assert target is not None
        (self.bin / tool).symlink_to(target)

    def make(
        self, *arguments: str, status: int = 0, **environment: str
    ) -> subprocess.CompletedProcess[str]:
        """Run the script; check its exit status."""
        variables = {"PATH": str(self.bin), "NOTES": str(self.notes), **environment}
        done = subprocess.run(
            [SCRIPT, *arguments],
            env={**variables, "LD_LIBRARY_PATH": os.environ.get("LD_LIBRARY_PATH", "")},
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == status, done.stderr
        return done

    def asked(self) -> list[list[str]]:
        """Return and clear the logged calls of `ros2`, without the folders of the policies."""
        asked = [line.split(" security ") for line in self.notes.read_text().splitlines()]
        self.notes.unlink()
        return [
            [domain, re.sub(r" /\S+/(\w+\.policy\.xml)$", r" \1", words)]
            for domain, words in asked
            if words != "--help"
        ]


@pytest.fixture
def keystore(tmp_path: Path) -> Keystore:
    return Keystore(tmp_path)


def test_a_keystore_is_made_and_renewed(keystore: Keystore) -> None:
    made = keystore.make(str(keystore.path), ROS_DOMAIN_ID="42")
    agent = ["42", f"create_permission {keystore.path} /woosh_robot/agent agent.policy.xml"]
    client = ["42", f"create_permission {keystore.path} /woosh_robot/client client.policy.xml"]
    assert keystore.asked() == [
        ["42", f"create_keystore {keystore.path}"],
        ["42", f"create_enclave {keystore.path} /woosh_robot/agent"],
        agent,
        ["42", f"create_enclave {keystore.path} /woosh_robot/client"],
        client,
    ]
    for whose in ("agent", "client"):
        policy = keystore.path / "enclaves" / "woosh_robot" / whose / "policy"
        assert policy.read_text() == (ROOT / "config" / f"{whose}.policy.xml").read_text()
    key = keystore.path / "enclaves" / "woosh_robot" / "agent" / "key.pem"
    assert key.stat().st_mode & 0o077 == 0  # only the owner can read it
    assert f"ROS_SECURITY_KEYSTORE={keystore.path}".replace(" ", "\\ ") in made.stdout
    assert "ROS_DOMAIN_ID=42" in made.stdout

    keystore.make("--node", "/client", str(keystore.path), ROS_DOMAIN_ID="42")
    assert keystore.asked() == [agent, client]


def test_a_run_changes_and_names_only_its_own_enclaves(keystore: Keystore) -> None:
    for node in ("/client", "/ui/panel"):
        made = keystore.make("--node", node, str(keystore.path))
        for enclave in ("/woosh_robot/agent", f"/woosh_robot{node}"):
            assert f"--enclave {enclave}\n" in made.stdout
            assert f"/./enclaves{enclave} " in made.stdout
    assert "--enclave /woosh_robot/client" not in made.stdout
    assert "--node /client" in made.stdout.partition("not renewed")[2]
    keystore.notes.unlink()
    renewed = keystore.make(str(keystore.path))  # without a node
    assert keystore.asked() == [
        ["0", f"create_permission {keystore.path} /woosh_robot/agent agent.policy.xml"],
    ]
    assert "--node /ui/panel" in renewed.stdout.partition("not renewed")[2]


def test_options_reach_the_keystore(keystore: Keystore) -> None:
    arguments = ("--namespace", "/r2", "--node", "/ui/panel", str(keystore.path))
    keystore.make(*arguments, "--", "--read-only")
    assert ["0", f"create_enclave {keystore.path} /r2/ui/panel"] in keystore.asked()
    policy = keystore.path / "enclaves" / "r2" / "ui" / "panel" / "policy"
    expected = sros2_policies.client_policy("/r2", "/ui/panel", read_only=True)
    assert policy.read_text() == expected


def test_a_keystore_is_for_one_domain(keystore: Keystore) -> None:
    keystore.make(str(keystore.path), ROS_DOMAIN_ID="1")
    keystore.notes.unlink()
    refused = keystore.make(str(keystore.path), status=1, ROS_DOMAIN_ID="2")
    assert "not for ROS_DOMAIN_ID=2" in refused.stderr
    assert keystore.asked() == []


def test_missing_programs_are_reported(keystore: Keystore) -> None:
    refused = keystore.make(str(keystore.path), status=1, WITHOUT_SROS2="1")
    assert "apt-get install ros-jazzy-sros2" in refused.stderr
    keystore.fake.unlink()
    refused = keystore.make(str(keystore.path), status=1)
    assert "source ROS 2" in refused.stderr
    assert not keystore.path.exists()


def test_bad_arguments_create_no_keystore(keystore: Keystore) -> None:
    for arguments in ([], ["a", "b"], ["--what"], ["a", "--", "--only", "nothing"]):
        assert keystore.make(*arguments, status=2).stderr
        assert not keystore.notes.exists() or keystore.asked() == []

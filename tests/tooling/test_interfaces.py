"""The built interface packages match the facts, including constants and type hashes."""

from __future__ import annotations

import ctypes
import importlib
from pathlib import Path
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix
from ament_index_python.resources import get_resource

from scripts.interface_files import interface_files
from tests.harness import HUMBLE
from tests.tooling.interface_facts import HASHES, KINDS, PACKAGES, facts_of

PROTO = Path(__file__).parents[2] / "proto"


class TypeHash(ctypes.Structure):
    """The C type rosidl_type_hash_t."""

    _fields_ = [("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32)]

    def __str__(self) -> str:
        return f"RIHS{self.version:02}_{bytes(self.value).hex()}"


def built_hash(name: str) -> str:
    """Return the hash of a type, e.g. `woosh_robot_msgs/msg/Mode`, from its compiled library."""
    package = name.split("/")[0]
    path = Path(get_package_prefix(package)) / "lib" / f"lib{package}__rosidl_generator_c.so"
    function = getattr(ctypes.CDLL(str(path)), name.replace("/", "__") + "__get_type_hash")
    function.restype = ctypes.POINTER(TypeHash)
    return str(function(None).contents)


def part_classes(package: str, name: str) -> list[Any]:
    """Return the Python classes of the parts of a type."""
    kind, short = name.split("/")
    cls = getattr(importlib.import_module(f"{package}.{kind}"), short)
    parts = dict(KINDS.values())[kind]
    return [getattr(cls, part.capitalize()) if part else cls for part in parts]


@pytest.mark.parametrize("package", PACKAGES)
class TestPackage:
    def test_all_types_and_no_others_are_installed(self, package: str):
        content, _ = get_resource("rosidl_interfaces", package)
        installed = {
            name
            for name, _, suffix in (line.rpartition(".") for line in content.split())
            # Humble lists the parts of services as well.
            if suffix != "idl" and not name.endswith(("_Request", "_Response"))
        }
        hashed = {name.partition("/")[2] for name in HASHES if name.startswith(package + "/")}
        assert hashed == facts_of(package).keys()
        # test_interface_files compares these with the facts
        files = {path.rpartition(".")[0] for path in interface_files(PROTO)}
        assert {f"{package}/{name}" for name in installed} == {
            name for name in files if name.startswith(package + "/")
        }

    @pytest.mark.skipif(HUMBLE, reason="types have no hashes on Humble")
    def test_type_hashes_match_the_facts(self, package: str):
        wanted = {name: text for name, text in HASHES.items() if name.startswith(package + "/")}
        assert {name: built_hash(name) for name in wanted} == wanted

    def test_constants_and_defaults_of_the_classes_match_the_facts(self, package: str):
        for name, parts in facts_of(package).items():
            for cls, part in zip(part_classes(package, name), parts, strict=True):
                compare_class(cls, part)


def compare_class(cls: Any, facts: dict[str, list[str]]) -> None:
    constants = {
        name: getattr(cls, name)
        for name in vars(type(cls))
        if name.isupper() and not name.startswith("_") and not name.endswith("__DEFAULT")
    }
    wanted = (text.split(" ", 1)[1].split("=") for text in facts["constants"])
    assert constants == {name: int(value) for name, value in wanted}, cls
    message = cls()
    assert list(cls.get_fields_and_field_types()) == [f.split()[1] for f in facts["fields"]]
    for field in facts["fields"]:
        ros_type, name, *default = field.split()
        value = getattr(message, name)
        if default:
            assert value == int(default[0]), (cls, name)
        elif "/" in ros_type and not ros_type.endswith("[]"):
            assert isinstance(value, ros_class(ros_type)), (cls, name)
        else:
            assert not value, (cls, name)


def ros_class(ros_type: str) -> Any:
    package, short = ros_type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), short)

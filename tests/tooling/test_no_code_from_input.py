"""Input is never executed: the sources do not use functions that could do it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DANGEROUS = re.compile(
    r"eval|exec|compile|__import__|importlib\.import_module"
    r"|(pickle|marshal|shelve|runpy|ctypes|subprocess|xml|lxml)(\..*)?"
    r"|os\.(system|popen|exec\w*|spawn\w*|posix_spawn\w*)|.*create_subprocess_\w+"
    r"|yaml\.((unsafe_|full_)?load(_all)?|(Unsafe|Full)?Loader)"
)
"""Names that can turn input into code or commands."""
PERMITTED = {
    ("convert/mapping.py", "exec"): "code generated from descriptors and ROS types only",
    ("convert/to_ros.py", "ctypes"): "c_float rounds a number to 32 bits",
    ("convert/mapping.py", "importlib.import_module"): "ROS types of the table and of their fields",
    ("link/protos.py", "importlib.import_module"): "the package's own protobuf modules",
    ("link/codecs/json_codec.py", "ctypes"): "c_float rounds a number to 32 bits",
    ("simulator/__init__.py", "importlib.import_module"): "the package's own modules, by a table",
    ("simulator/command_line.py", "importlib.import_module"): "the page's module, a constant",
    ("tools/__main__.py", "importlib.import_module"): "the package's own programs",
    ("agent.py", "ctypes"): "memory settings and exit of the C library, with constants",
    ("data_files.py", "yaml.load"): "a loader derived from SafeLoader",
    ("testing/agents.py", "subprocess"): "runs the agent in tests, without a shell",
}
"""Reason why each permitted use is safe, by file and name."""


def dangers(source: str) -> set[str]:
    """Return the dangerous names that Python code imports or uses."""
    used: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            used.update(name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            used.add(node.module)
            used.update(f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Name | ast.Attribute):
            used.add(ast.unparse(node))
    found = {name for name in used if DANGEROUS.fullmatch(name)}
    # `import a` and the use of `a.b` count once.
    return {name for name in found if not any(name.startswith(f"{each}.") for each in found)}


def test_only_permitted_uses_are_found() -> None:
    package = ROOT / "woosh_robot_agent"
    found = {
        (path.relative_to(package).as_posix(), danger)
        for path in sorted(package.rglob("*.py"))
        if "pb" not in path.relative_to(package).parts
        for danger in dangers(path.read_text())
    }
    assert found == set(PERMITTED)


def test_scripts_do_not_evaluate_input() -> None:
    for path in sorted((ROOT / "scripts").iterdir()):
        if path.is_file():
            assert not re.search(r"^\s*eval\b|\bcurl\b.*\|\s*(ba)?sh\b", path.read_text(), re.M), (
                path
            )

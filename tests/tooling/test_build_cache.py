"""The caches of the interface packages do not change what the code generators of rosidl write."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

BUILD_CACHE = Path(__file__).parents[2] / "woosh_common_msgs" / "cmake"

TEMPLATE = """\
@{
from os import path
def twice(text):
    return 2 * text
}@
@[def quoted(text)]'@(text)'@[end def]
@[for number, name in enumerate(names)]@
@[  if number % 2]@
@( name.upper() ) @number @(path.join("a", name)) @(number > 1 ? "many" ! "one")
@[  else]@
@(quoted(twice(name))) @@ @\\x41
@[  end if]@
@[end for]@
@# a comment
"""

GENERATOR = f"""
import io, sys, em

scans = 0
one = em.Scanner.one

def counted(self):
    global scans
    scans += 1
    return one(self)

em.Scanner.one = counted
for names in (["ab", "cd", "ef"], ["gh"], []):
    output = io.StringIO()
    interpreter = em.Interpreter(output=output, options={{em.BUFFERED_OPT: True, em.RAW_OPT: True}})
    interpreter.string({TEMPLATE!r}, locals={{"names": names}})
    interpreter.string({TEMPLATE!r} + "\\n", locals={{"names": names}})
    interpreter.string("a comment@# that ends with the text", locals={{}})
    print(output.getvalue())
    interpreter.shutdown()
print(scans, file=sys.stderr)
"""

INTERFACE = """
module some_msgs { module msg {
  module Some_Constants { const uint8 ONE = 1; };
  @verbatim (language="comment", text="A comment" "\\n" "of two lines")
  struct Some { @unit (value="m") double x; sequence<string, 3> names; };
}; };
"""

PARSER = f"""
from rosidl_parser import parser

for again in range(2):
    content = parser.parse_idl_string({INTERFACE!r})
    struct = content.elements[-1].structure
    print([type(element).__name__ for element in content.elements])
    print([(member.name, type(member.type).__name__) for member in struct.members])
    print([(note.name, note.value) for note in struct.annotations + struct.members[0].annotations])
"""


def run(tmp_path: Path, program: str, *, cached: bool) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("em")
    pytest.importorskip("rosidl_parser")
    script = tmp_path / "rosidl_generator"  # only programs of rosidl use the caches
    script.write_text(program)
    path = [str(BUILD_CACHE)] if cached else []
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([*path, os.environ.get("PYTHONPATH", "")]),
        "WOOSH_IDL_CACHE": str(tmp_path / "idl"),
    }
    return subprocess.run(
        [sys.executable, str(script)], env=environment, capture_output=True, text=True, check=True
    )


def test_templates_expand_to_the_same_text(tmp_path: Path) -> None:
    plain = run(tmp_path, GENERATOR, cached=False)
    cached = run(tmp_path, GENERATOR, cached=True)
    assert "'abab' @ A\nCD 1 a/cd one\n'efef' @ A" in plain.stdout
    assert cached.stdout == plain.stdout
    assert int(cached.stderr) < int(plain.stderr) / 2, "templates were parsed again"


def test_interfaces_are_parsed_to_the_same_content(tmp_path: Path) -> None:
    plain = run(tmp_path, PARSER, cached=False)
    assert "A comment" in plain.stdout
    for kind in ("parsed", "from the cache"):
        assert run(tmp_path, PARSER, cached=True).stdout == plain.stdout, kind
    (cached,) = (tmp_path / "idl").iterdir()
    damaged = b"cos\nno_such_function\n."  # pickle raises AttributeError
    cached.write_bytes(damaged)
    for kind in ("parsed again", "from the cache"):
        assert run(tmp_path, PARSER, cached=True).stdout == plain.stdout, kind
    assert cached.read_bytes() != damaged

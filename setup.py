"""Build of woosh_robot_agent, an ament_python package, and compilation of its protobuf modules.

``python setup.py build_proto`` compiles them into the source tree (``woosh_robot_agent/pb``, which
git ignores), so that ``python -m woosh_robot_agent.simulator`` runs from a plain checkout. A wheel
or a regular colcon build compiles them into its own build folder.
"""

import contextlib
import hashlib
import importlib.metadata
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from setuptools import Command, find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.develop import develop

PACKAGE = "woosh_robot_agent"
# resolved, because colcon --symlink-install runs a symlink to this file in its build folder
ROOT = Path(__file__).resolve().parent
PROTO_ROOT = ROOT / "proto"
# Folder of the .proto files, and prefix of their imports. The Python modules do not have it.
PROTO_PREFIX = "woosh/proto"


def proto_files():
    return sorted((PROTO_ROOT / PROTO_PREFIX).rglob("*.proto"))


def protoc():
    """Return command and version of the compiler: grpcio-tools, or protoc on the PATH."""
    candidates = [["protoc"]]
    if importlib.util.find_spec("grpc_tools"):
        import grpc_tools

        # the .proto files of protobuf itself, e.g. google/protobuf/any.proto
        include = Path(grpc_tools.__file__).parent / "_proto"
        candidates.insert(0, [sys.executable, "-m", "grpc_tools.protoc", f"-I{include}"])
    for command in candidates:
        with contextlib.suppress(OSError, subprocess.CalledProcessError):
            version = subprocess.run(
                [*command, "--version"], capture_output=True, text=True, check=True
            ).stdout
            # --pyi_out needs 3.20. grpcio-tools of Debian and Ubuntu is older; protoc is not.
            if [int(part) for part in re.findall(r"\d+", version)[:2]] >= [3, 20]:
                return command, version
    raise SystemExit(
        "no protobuf compiler of release 3.20 or later; run pip install grpcio-tools, or apt-get "
        "install protobuf-compiler"
    )


def protobuf_requirement():
    """Return the protobuf releases that are compatible with code of the installed grpcio-tools."""
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        for requirement in importlib.metadata.requires("grpcio-tools") or ():
            if re.match(r"protobuf\b", requirement):
                return requirement.split(";")[0].strip()
    return "protobuf>=4.21"


def rewrite(text, package):
    """Replace the module names in generated code by those in the target package."""
    dotted = PROTO_PREFIX.replace("/", ".")
    text = re.sub(rf"^from {re.escape(dotted)}\b", f"from {package}", text, flags=re.MULTILINE)
    # the module name that generated code passes to the builder; pickle needs the new one
    return text.replace(f"'{dotted}.", f"'{package}.")


def generate(target, package=f"{PACKAGE}.pb"):
    """Compile proto/ into the folder `target`, unless it is up to date; return the files."""
    command, version = protoc()
    digest = hashlib.sha256(version.encode() + Path(__file__).read_bytes())
    for source in proto_files():
        digest.update(f"{source.relative_to(PROTO_ROOT)}\0".encode() + source.read_bytes())
    stamp = target / ".stamp"
    # the stamp lists the files, so that missing ones are noticed
    if stamp.exists():
        key, *names = stamp.read_text().splitlines()
        files = [target / name for name in names]
        if key == digest.hexdigest() and all(file.exists() for file in files):
            return files
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target, prefix=".protoc") as temporary:
        names = [str(source.relative_to(PROTO_ROOT)) for source in proto_files()]
        subprocess.run(
            [
                *command,
                f"-I{PROTO_ROOT}",
                f"--python_out={temporary}",
                f"--pyi_out={temporary}",
                *names,
            ],
            check=True,
        )
        made = Path(temporary) / PROTO_PREFIX
        for module in list(made.rglob("*_pb2.py*")):
            module.write_text(rewrite(module.read_text(), package))
            (module.parent / "__init__.py").touch()
        (made / "__init__.py").touch()
        wanted = sorted(file.relative_to(made) for file in made.rglob("*") if file.is_file())
        for name in wanted:
            (target / name).parent.mkdir(exist_ok=True)
            # atomic, so that a concurrent import never reads a partial file
            os.replace(made / name, target / name)
    for file in list(target.rglob("*.py")) + list(target.rglob("*.pyi")):
        if file.relative_to(target) not in wanted:
            file.unlink()
    stamp.write_text("\n".join([digest.hexdigest(), *map(str, wanted)]) + "\n")
    return [target / name for name in wanted]


class BuildProto(Command):
    """Compile proto/ into the source tree, or into another folder."""

    description = "compile the .proto files to Python modules"
    user_options = [("output=", "o", f"folder of the modules (default: {PACKAGE}/pb)")]

    def initialize_options(self):
        self.output = None

    def finalize_options(self):
        self.output = Path(self.output) if self.output else ROOT / PACKAGE / "pb"

    def run(self):
        generate(self.output)


class BuildPy(build_py):
    """build_py that adds the protobuf modules to what it builds."""

    def run(self):
        super().run()
        if getattr(self, "editable_mode", False):
            generate(ROOT / PACKAGE / "pb")
        else:
            generate(Path(self.build_lib) / PACKAGE / "pb")

    def get_outputs(self, include_bytecode=1):
        generated = Path(self.build_lib) / PACKAGE / "pb"
        return super().get_outputs(include_bytecode) + [
            str(file) for file in generated.rglob("*.py*") if file.suffix in (".py", ".pyi")
        ]


class Develop(develop):
    """develop (colcon build --symlink-install) with the modules in the source tree."""

    def run(self):
        generate(ROOT / PACKAGE / "pb")
        super().run()


def data_files(*folders):
    for folder, pattern in folders:
        names = sorted(str(file.relative_to(ROOT)) for file in (ROOT / folder).glob(pattern))
        if names:
            yield f"share/{PACKAGE}/{folder}", names


setup(
    name=PACKAGE,
    version="0.1.0",
    # pb is excluded where it is generated in the source tree: each build compiles its own.
    packages=find_packages(
        str(ROOT), include=[PACKAGE, f"{PACKAGE}.*"], exclude=[f"{PACKAGE}.pb", f"{PACKAGE}.pb.*"]
    ),
    package_data={
        PACKAGE: ["py.typed"],
        f"{PACKAGE}.robot": ["status_codes.json"],
        f"{PACKAGE}.simulator": ["data/*.json", "data/*/*"],
        f"{PACKAGE}.tools.dashboard": ["page/*.*", "page/*/*"],
        f"{PACKAGE}.vda5050.messages": ["schemas/LICENSE", "schemas/*/*.schema"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *data_files(("launch", "*.launch.py"), ("config", "*.*")),
    ],
    cmdclass={"build_proto": BuildProto, "build_py": BuildPy, "develop": Develop},
    python_requires=">=3.10",
    install_requires=[
        "websockets>=10.4",
        "aiohttp>=3.9",
        "rich>=13.7",
        protobuf_requirement(),
        # For the simulator's scene files and map images; the minimum versions are Ubuntu 24.04's.
        "pyyaml>=6.0",
        "numpy>=1.26",
        "scipy>=1.11",
        "pillow>=10.2",
    ],
    # No distribution and no rosdep key has these packages.
    extras_require={
        # for record and replay
        "recording": [
            "mcap>=1.6",
            "mcap-protobuf-support>=0.3",
            "foxglove-schemas-protobuf>=0.3",
        ],
        # without them, JSON takes longer to read
        "fast": ["orjson>=3.6", "pybase64>=1.3"],
        # for vda5050
        "vda5050": ["aiomqtt>=2.3", "jsonschema>=4.20"],
    },
    zip_safe=False,
    author="woosh_robot_agent maintainers",
    author_email="maintainers@example.com",
    maintainer="woosh_robot_agent maintainers",
    maintainer_email="maintainers@example.com",
    description="ROS 2 driver for Woosh mobile robots, with a simulated chassis.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "agent = woosh_robot_agent.agent:main",
            "simulator = woosh_robot_agent.simulator.__main__:main",
            "dashboard = woosh_robot_agent.tools.__main__:dashboard",
            "monitor = woosh_robot_agent.tools.__main__:monitor",
            "doctor = woosh_robot_agent.tools.__main__:doctor",
            "record = woosh_robot_agent.tools.__main__:record",
            "replay = woosh_robot_agent.tools.__main__:replay",
            "maps = woosh_robot_agent.tools.__main__:maps",
            "vda5050 = woosh_robot_agent.vda5050.__main__:main",
        ],
    },
)

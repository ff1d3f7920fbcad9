"""Cache of parsed interface files, shared by packages, generators and checkouts.

scripts/setup puts this folder on the PYTHONPATH during the build, and Python imports a module with
this name at every start. Each of seven generators parses every interface file with a slow parser,
which takes most of the time of a build with a warm ccache.
"""

import contextlib
import hashlib
import os
import pickle
import sys
import tempfile
from pathlib import Path


def install():
    from rosidl_parser import definition, parser

    folder = Path(os.environ["WOOSH_IDL_CACHE"])
    folder.mkdir(parents=True, exist_ok=True)
    release = hashlib.sha256(sys.version.encode())
    for source in (definition.__file__, parser.__file__, parser.grammar_file):
        release.update(Path(source).read_bytes())
    parse = parser.parse_idl_string

    def remembered(text, png_file=None):
        key = release.copy()
        key.update(text.encode())
        file = folder / key.hexdigest()
        try:
            return pickle.loads(file.read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            content = parse(text, png_file=png_file)
            with contextlib.suppress(OSError):  # the build does not need the cache
                with tempfile.NamedTemporaryFile(dir=folder, delete=False) as new:
                    pickle.dump(content, new)
                os.replace(new.name, file)  # atomic: another generator may write the same file
            return content

    parser.parse_idl_string = remembered


if any("rosidl" in argument for argument in sys.orig_argv[1:2]):
    install()

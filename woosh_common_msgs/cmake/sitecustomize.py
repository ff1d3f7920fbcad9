"""Caches for the code generators of rosidl: each interface file and template is parsed once only.

woosh_interfaces.cmake puts this folder on the PYTHONPATH of the generators, and Python imports a
module with this name at every start. Without it, each of seven generators parses every interface
file with a slow parser, and its templates again for every interface. That takes longer than the
compiler.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import sys
import tempfile
from pathlib import Path


def cache_interfaces():
    """Keep parsed interface files for the other generators, in the folder $WOOSH_IDL_CACHE."""
    from rosidl_parser import definition, parser

    folder = Path(os.environ["WOOSH_IDL_CACHE"])
    parser_key = hashlib.sha256(sys.version.encode())  # another parser returns other objects
    for source in (definition.__file__, parser.__file__, parser.grammar_file):
        parser_key.update(Path(source).read_bytes())
    parse = parser.parse_idl_string

    def parse_cached(text, png_file=None):
        key = parser_key.copy()
        key.update(text.encode())
        file = folder / key.hexdigest()
        # A damaged file may raise any exception. The build does not need the cache.
        with contextlib.suppress(Exception):
            return pickle.loads(file.read_bytes())
        content = parse(text, png_file=png_file)
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=folder, delete=False) as new:
                pickle.dump(content, new)
            os.replace(new.name, file)  # atomic: another generator may write the same file
        return content

    parser.parse_idl_string = parse_cached


def cache_templates():
    """Let empy parse each template once, and compile each piece of Python in it once."""
    import em

    if not em.__version__.startswith("3."):
        return  # empy 4 parses in another way
    parse = em.Interpreter.parse

    @functools.cache
    def tokens(prefix, text):
        return list(iter(em.Scanner(prefix, text).one, None))

    def parse_once(self, scanner, locals=None):
        try:
            found = tokens(scanner.prefix, scanner.rest())
        except em.TransientParseError:  # the text ends within a token
            parse(self, scanner, locals)
            return
        self.invoke("atParse", scanner=scanner, locals=locals)
        for token in found:
            self.invoke("atToken", token=token)
            token.run(self, locals)

    @functools.cache
    def compiled(source, mode):
        return compile(source.lstrip(" \t"), "<string>", mode)

    em.Interpreter.parse = parse_once
    em.eval = lambda source, *namespaces: eval(compiled(source, "eval"), *namespaces)
    em._exec = lambda source, *namespaces: exec(compiled(source, "exec"), *namespaces)


if "WOOSH_IDL_CACHE" in os.environ and any("rosidl" in word for word in sys.orig_argv[1:3]):
    cache_interfaces()
    cache_templates()

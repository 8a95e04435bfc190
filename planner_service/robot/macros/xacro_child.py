"""A script that expands a xacro file in a process of its own, which reads nothing but the folders it is given.

Nothing imports it. It is given JSON with ``file``, ``folders`` (resolved, the file's own among them), ``packages``
(folders by the name of the ROS package), ``args`` (texts by name) and ``most`` (bytes). It answers with JSON that has
``urdf``, or ``problem`` with ``files`` (those that were read, the one in which it ended first) and, if that is the
problem, the ``argument`` that has no value or is ``unused``, the ``package`` that is missing or the ``expression``.

xacro evaluates ``${...}`` as Python. That only looks safe: it refuses names with two underscores, but not inside of a
lambda, gives ``vars`` and ``type`` away, and ``$(eval ...)`` has all builtins, ``open`` included. So there are three
walls: expressions of both kinds are checked before they are evaluated, an audit hook ends all but reading in the
folders, and the process has limits on time and memory, cannot write to files and sees no environment variables
(``run_confined``).
"""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import xml.dom.minidom
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

FORBIDDEN = (ast.Lambda, ast.GeneratorExp, ast.Await, ast.Yield, ast.YieldFrom, ast.NamedExpr)
"""What gives access to a frame, or hides names from xacro's own check."""
HARMLESS = {"compile", "exec", "sys._getframe", "builtins.id", "object.__getattr__", "code.__new__"}
"""Events of the interpreter itself, which neither read nor write anything."""
FOLDER_EVENTS = {"os.scandir", "os.listdir", "glob.glob", "glob.glob/2"}
OUTSIDE = "lies outside the folders that may be read, to which --package-dir (package_dirs) adds"
MARKS = (b"<!DOCTYPE", b"<!ENTITY")
LOST = "package://"
"""What ``$(find name)`` is, before the name, if there is no such package: it matters only where something is read."""
INNER = r"(?:[^()]|\((?:[^()]|\([^()]*\))*\))"
EXTENSION = rf"^\$\(eval {INNER}*\)|^\$\([^\)]*\)"
"""As xacro has it, but that an ``$(eval ...)`` may have parentheses in it: for xacro it ends at the first."""


class Refused(Exception):
    """The file asks for what it may not have."""


class Missing(Exception):
    """An argument has no value, or a package is not there: its ``kind`` and ``name``."""

    def __init__(self, kind: str, name: str) -> None:
        super().__init__(f"the {kind} {name!r} is missing")
        self.kind, self.name = kind, name


def answer(job: dict[str, Any], data: bytes) -> bytes:
    import xacro
    import yaml
    from xacro import substitution_args

    job = json.loads(data)
    xml.dom.minidom.parseString("<a/>").toxml()  # both import modules at first use, which the hook does not let them
    yaml.safe_load("a: 1")
    files: dict[str, str] = {}
    _guard(xacro, substitution_args, job, files)
    sys.addaudithook(_hook([os.path.realpath(folder) for folder in job["folders"]]))
    try:
        text = xacro.process_file(job["file"], mappings=dict(job["args"])).toxml()
        fits = len(text.encode()) <= job["most"]
        out: dict[str, Any] = {"urdf": text} if fits else {"problem": f"expands to more than {job['most']:,} bytes"}
        if unused := [name for name in job["args"] if not any(_names(name, each) for each in files.values())]:
            out = {"problem": "no such argument", "unused": unused[0]}
    except Exception as error:
        out = {"problem": f"{_words(error)}{_where(xacro)}", **_cause(error)}
    last = [name for name in (xacro.filestack or [])[::-1] if name in files]
    return json.dumps({"files": list(dict.fromkeys([*last, *files])), **out}).encode()


def _names(argument: str, text: str) -> bool:
    """Whether a file has an argument of that name."""
    name = re.escape(argument)
    return re.search(rf"name\s*=\s*[\"']{name}[\"']|\barg\s+{name}\s*\)|\barg\(\W*{name}\W", text) is not None


def _cause(error: BaseException) -> dict[str, str]:
    """What is missing, or the expression that could not be evaluated."""
    found: dict[str, str] = {}
    each: Any = error
    while isinstance(each, BaseException):
        if isinstance(each, Missing):
            return {each.kind: each.name}
        if evaluated := re.search(r"when evaluating expression '(.*)'", str(getattr(each, "suffix", None) or "")):
            found = {"expression": evaluated.group(1)}
        each = getattr(each, "exc", None) or each.__cause__
    return found


def _words(error: Any) -> str:
    while isinstance(getattr(error, "exc", None), Exception):  # what xacro wraps
        error = error.exc
    if isinstance(error, RecursionError):
        return "macros or includes call each other without end"
    if isinstance(error, MemoryError):
        return "too much memory is needed"
    text = " ".join(str(error).split()) or type(error).__name__
    text = f"not well-formed XML: {text}" if isinstance(error, ExpatError) else text
    return text if len(text) <= 300 else f"{text[:300]} ..."


def _where(xacro: Any) -> str:
    """The included file, and the macro, in which it ended."""
    places = [f"in {Path(name).name}" for name in (xacro.filestack or [])[1:][-1:]]
    places += [f"in macro {macro.body.getAttribute('name')}" for macro in (xacro.macrostack or [])[-1:]]
    return f" ({', '.join(places)})" if places else ""


def _guard(xacro: Any, substitution_args: Any, job: dict[str, Any], files: dict[str, str]) -> None:
    """Put our checks before what xacro evaluates, looks up and parses; ``files`` is filled with what was parsed."""
    evaluate: Callable[..., Any] = xacro.safe_eval
    absolute: Callable[[str], str] = xacro.abs_filename_spec
    known = substitution_args._eval_dict
    plain = {name: value for name, value in {**known["__builtins__"], **known}.items() if not name.startswith("_")}

    def checked(expression: str, *symbols: Any) -> Any:
        _require_plain(expression, "${%s}")
        return evaluate(expression, *symbols)

    def find(package: str) -> str:
        return str(job["packages"].get(package, f"{LOST}{package}"))

    def named(file: str) -> str:
        if file.startswith(LOST):
            raise Missing("package", file.removeprefix(LOST).split("/")[0])
        return absolute(file)

    def argument(name: str, args: dict[str, str]) -> str:
        if name not in args:
            raise Missing("argument", name)
        return args[name]

    def evaluated(expression: str, context: dict[str, Any]) -> str:
        _require_plain(expression, "$(eval %s)")
        given = context.setdefault("arg", {})
        values = {name: substitution_args.convert_value(value, "auto") for name, value in given.items()}
        own = {"arg": lambda name: substitution_args.convert_value(argument(name, given), "auto"), "find": find}
        try:
            return str(evaluate(expression, {**values, **plain, **own}))
        except Exception as error:
            raise xacro.XacroException(exc=error, suffix=f"when evaluating expression '{expression}'") from None

    def parse(file: Any) -> xml.dom.minidom.Document:
        content = file.buffer.read(job["most"] + 1)
        if len(content) > job["most"]:
            raise Refused(f"{Path(file.name).name} has more than {job['most']:,} bytes")
        for mark in MARKS:
            if mark in content.upper():
                raise Refused(f"{mark.decode()} is not allowed: write the file without a document type or entities")
        files[os.path.normpath(file.name)] = content.decode("utf-8", "replace")
        document = xml.dom.minidom.parseString(content)
        for element in document.getElementsByTagName("xacro:arg"):
            name = element.getAttribute("name")
            if not element.hasAttribute("default"):  # xacro asks for one even if a value is given
                if name not in job["args"]:
                    raise Missing("argument", name)
                element.setAttribute("default", "")
        return document

    xacro.safe_eval, xacro.abs_filename_spec, xacro.xml.dom.minidom.parse = checked, named, parse
    substitution_args._eval_find, substitution_args._eval_arg, substitution_args._eval = find, argument, evaluated
    xacro.LEXER.res[xacro.LEXER.EXTENSION] = re.compile(EXTENSION)
    python, own = (xacro._global_symbols[space] for space in ("python", "xacro"))
    for name in ("vars", "type"):
        del python[name]
    own["arg"] = lambda name: argument(name, xacro.substitution_args_context["arg"])


def _require_plain(expression: str, form: str) -> None:
    """Refuse expressions that do more than compute."""
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        name = getattr(node, "id", getattr(node, "attr", ""))
        if isinstance(node, FORBIDDEN) or name.startswith("_") or "_frame" in name or name in ("format", "format_map"):
            raise Refused(f"{form % expression} is not allowed: it does more than compute")


def _hook(folders: list[str]) -> Callable[[str, tuple[Any, ...]], None]:
    """An audit hook that ends what is neither harmless nor a look into the folders."""

    def inside(path: Any) -> bool:
        real = os.path.realpath(os.fspath(path))
        return any(os.path.commonpath([real, folder]) == folder for folder in folders)

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in HARMLESS:
            return
        if event == "open" and not isinstance(arguments[0], int):
            path, mode, _ = arguments
            if mode is not None and not set(mode) - set("rbt") and inside(path):
                return
            raise Refused(f"{os.fspath(path)!s} {OUTSIDE} ({', '.join(folders)})")
        if event in FOLDER_EVENTS and inside(arguments[0] or "."):
            return
        raise Refused(f"{event}{arguments!r:.100} is not allowed")

    return hook

"""A script that expands a xacro file in a process of its own, which reads nothing but the folders it is given.

Nothing imports it. Its job has ``file``, ``folders`` (resolved, the file's own among them), ``packages`` (folders by
the name of the ROS package) and ``most`` (bytes); it answers with JSON that has ``urdf`` or ``problem``.

xacro evaluates ``${...}`` as Python. That only looks safe: it refuses names with two underscores, but not inside of a
lambda, gives ``vars`` and ``type`` away, and ``$(eval ...)`` has all builtins, ``open`` included. So there are three
walls: expressions are checked before they are evaluated, an audit hook ends all but reading in the folders, and the
process has limits on time and memory, cannot write to files and sees no environment variables (``run_confined``).
"""

from __future__ import annotations

import ast
import json
import os
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
MARKS = (b"<!DOCTYPE", b"<!ENTITY")


class Refused(Exception):
    """The file asks for what it may not have."""


def answer(job: dict[str, Any], data: bytes) -> bytes:
    import xacro
    import yaml
    from xacro import substitution_args

    xml.dom.minidom.parseString("<a/>").toxml()  # both import modules at first use, which the hook does not let them
    yaml.safe_load("a: 1")
    _guard(xacro, substitution_args, job)
    sys.addaudithook(_hook([os.path.realpath(folder) for folder in job["folders"]]))
    try:
        text = xacro.process_file(job["file"]).toxml()
        fits = len(text.encode()) <= job["most"]
        out = {"urdf": text} if fits else {"problem": f"expands to more than {job['most']:,} bytes"}
    except Exception as error:
        out = {"problem": f"{_words(error)}{_where(xacro)}"}
    return json.dumps(out).encode()


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


def _guard(xacro: Any, substitution_args: Any, job: dict[str, Any]) -> None:
    """Put our checks before what xacro evaluates, looks up and parses."""
    evaluate: Callable[..., Any] = xacro.safe_eval

    def checked(expression: str, *symbols: Any) -> Any:
        _require_plain(expression)
        return evaluate(expression, *symbols)

    def find(package: str) -> str:
        if package not in job["packages"]:
            known = ", ".join(sorted(job["packages"])) or "none"
            raise Refused(f"$(find {package}): no such package in the folders that may be read; known: {known}")
        return str(job["packages"][package])

    def refuse_eval(expression: str, context: object) -> str:
        raise Refused(f"$(eval {expression}) is not supported; write ${{...}} instead")

    def parse(file: Any) -> xml.dom.minidom.Document:
        content = file.buffer.read(job["most"] + 1)
        if len(content) > job["most"]:
            raise Refused(f"{Path(file.name).name} has more than {job['most']:,} bytes")
        for mark in MARKS:
            if mark in content.upper():
                raise Refused(f"{mark.decode()} is not allowed: write the file without a document type or entities")
        return xml.dom.minidom.parseString(content)

    xacro.safe_eval, substitution_args._eval_find, substitution_args._eval = checked, find, refuse_eval
    xacro.xml.dom.minidom.parse = parse
    for name in ("vars", "type"):
        del xacro._global_symbols["python"][name]


def _require_plain(expression: str) -> None:
    """Refuse expressions that do more than compute."""
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        name = getattr(node, "id", getattr(node, "attr", ""))
        if isinstance(node, FORBIDDEN) or name.startswith("_") or "_frame" in name or name in ("format", "format_map"):
            raise Refused(f"${{{expression}}} is not allowed: it does more than compute")


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
            raise Refused(f"{os.fspath(path)!s} lies outside the folders that may be read ({', '.join(folders)})")
        if event in FOLDER_EVENTS and inside(arguments[0] or "."):
            return
        raise Refused(f"{event}{arguments!r:.100} is not allowed")

    return hook

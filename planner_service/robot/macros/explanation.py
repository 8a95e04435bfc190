"""Why the macros of a xacro file could not be expanded: where in its files, and what to do about it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import MAX_XML_BYTES, Malformed, parse_xml

__all__ = ["explained"]

MOST = 20
"""Values, arguments or packages that are listed."""
LONGEST = 200
"""Characters of a comment that is quoted, and of an expression that is looked into."""
NEAR = 1_000
"""Characters before and behind a declaration in which its comment stands."""
COMMENT = r"<!--((?:(?!-->).)*)-->"
STAND_IN = "the_argument_"
"""What an argument is called while expressions are looked into."""

Files = Mapping[Path, str]


def explained(told: Mapping[str, Any], packages: Mapping[str, str], folder: Path) -> str:
    """The problem that ``xacro_child`` tells of, with file and line, and the step that helps.

    Args:
        packages: Folders by the names of the packages that are known.
        folder: That of the file that was to be expanded; others are named from there.
    """
    files = _texts([Path(name) for name in told.get("files", ())])
    if "argument" in told:
        return _argument(str(told["argument"]), files, packages, folder)
    if "unused" in told:
        names = _listed(_arguments(files)) or "none"
        return f"it has no argument {told['unused']!r} (xacro_args, --xacro-arg); it has {names}"
    if "package" in told:
        name = str(told["package"])
        place = _place([f"$(find {name})"], files, folder)
        known = _listed(sorted(packages)) or "none"
        step = "name the folder that holds it with --package-dir (package_dirs)"
        return f"{place}$(find {name}): no such package in the folders that may be read; {step}; known: {known}"
    if "expression" in told:
        expression = str(told["expression"])
        place = _place([f"${{{expression}}}", f"$(eval {expression})", expression], files, folder)
        return f"{place}{told['problem']}, in {expression!r}{_step(str(told['problem']))}"
    return f"{told['problem']}{_step(str(told['problem']))}"


def _step(problem: str) -> str:
    """What helps against something that xacro itself says."""
    unseen = "no environment variable is seen here; expand the file where it is set, with xacro FILE -o FILE.urdf"
    return f"; {unseen}" if "environment variable" in problem else ""


def _argument(name: str, files: Files, packages: Mapping[str, str], folder: Path) -> str:
    """What to say of an argument without a value."""
    uses = [f"$(arg {name})", f"arg('{name}')", f'arg("{name}")', f'<xacro:arg name="{name}"']
    values = _listed(sorted({*_compared(name, files), *_files_so_called(name, files, packages)}))
    comments = [f"its comment says {text!r}" for text in _comments(name, files)]
    hints = [*([f"the file lists {values}"] if values else []), *comments[:1]]
    step = f"give it one with --xacro-arg {name}:=VALUE (xacro_args={{{name!r}: VALUE}})"
    return "; ".join([f"{_place(uses, files, folder)}the argument {name!r} has no value", step, *hints])


def _texts(names: Sequence[Path]) -> dict[Path, str]:
    """The files that can be read, by path."""
    texts = {}
    for name in names:
        try:
            texts[name] = read_bytes(name, MAX_XML_BYTES).decode("utf-8-sig", "replace")
        except InvalidFile:
            continue
    return texts


def _place(words: Sequence[str], files: Files, folder: Path) -> str:
    """The first file and line that has the first of the words which any has; empty if none has one."""
    for word in words:
        for file, text in files.items():
            if (at := text.find(word)) >= 0:
                name = file.relative_to(folder) if file.is_relative_to(folder) else file
                return f"{name}, line {text.count(chr(10), 0, at) + 1}: "
    return ""


def _attributes(files: Files) -> Iterator[tuple[ElementTree.Element, str, str]]:
    """Each attribute of the files, with its element."""
    for text in files.values():
        try:
            root = parse_xml(text.encode())
        except Malformed:
            continue
        for element in root.iter():
            yield from ((element, key, value) for key, value in element.attrib.items())


def _arguments(files: Files) -> list[str]:
    tags = (each for each in _attributes(files) if each[0].tag == "xacro:arg" and each[1] == "name")
    return sorted({value for _, _, value in tags})


def _aliases(name: str, files: Files) -> set[str]:
    """The properties and parameters of macros that have the value of the argument."""
    given = (f"$(arg {name})", f"${{xacro.arg('{name}')}}")
    found = set[str]()
    for element, key, value in _attributes(files):
        if value.strip() in given:
            found.add(element.get("name", "") if element.tag == "xacro:property" else key)
    return found - {"value", "filename", ""}


def _compared(name: str, files: Files) -> Iterator[str]:
    """The values with which expressions of the files compare the argument."""
    aliases, quoted = _aliases(name, files), re.escape(name)
    mention = rf"[\"']?\$\(arg\s+{quoted}\s*\)[\"']?|(?:xacro\.)?\barg\(\s*[\"']{quoted}[\"']\s*\)"
    for _, _, value in _attributes(files):
        for expression in chain(re.findall(r"\$\{([^}]*)\}", value), re.findall(r"^\$\(eval (.*)\)$", value)):
            plain = re.sub(mention, STAND_IN, expression)[:LONGEST].strip()
            try:
                tree = ast.parse(plain, mode="eval")
            except (SyntaxError, ValueError, RecursionError, MemoryError):
                continue
            for node in ast.walk(tree):
                if isinstance(node, ast.Compare):
                    sides = [node.left, *node.comparators]
                    if any(isinstance(each, ast.Name) and each.id in {STAND_IN, name, *aliases} for each in sides):
                        yield from (str(each.value) for side in sides for each in _constants(side))


def _constants(side: ast.expr) -> list[ast.Constant]:
    each = side.elts if isinstance(side, ast.List | ast.Tuple | ast.Set) else [side]
    return [one for one in each if isinstance(one, ast.Constant) and isinstance(one.value, str | int | float)]


def _files_so_called(name: str, files: Files, packages: Mapping[str, str]) -> Iterator[str]:
    """The parts of names of files and folders that stand where the files have the argument in a path."""
    ways = (rf"$(arg {name})", *(f"${{{alias}}}" for alias in _aliases(name, files)))
    for text, way in ((value, way) for _, _, value in _attributes(files) for way in ways if way in value):
        found = re.fullmatch(r".*?\$\(find\s+([^)\s]+)\s*\)/([^'\"]*)", text.partition(way)[0], re.DOTALL)
        if found is None or found[1] not in packages or "$" in found[2]:
            continue
        above, _, begin = found[2].rpartition("/")
        end = re.split(r"[/'\"]", text.partition(way)[2])[0]
        place = Path(packages[found[1]], above)
        if "$" in end or not place.resolve().is_relative_to(Path(packages[found[1]]).resolve()) or not place.is_dir():
            continue
        for entry in place.iterdir():
            if entry.name.startswith(begin) and entry.name.endswith(end) and len(entry.name) > len(begin + end):
                yield entry.name[len(begin) : len(entry.name) - len(end)]


def _comments(name: str, files: Files) -> Iterator[str]:
    """What comments say that stand right before or behind the declaration of the argument."""
    declared = rf"<xacro:arg\s[^>]*name\s*=\s*[\"']{re.escape(name)}[\"'][^>]*>"
    for text in files.values():
        for found in re.finditer(declared, text):
            above, below = text[max(0, found.start() - NEAR) : found.start()], text[found.end() : found.end() + NEAR]
            before = re.search(rf"{COMMENT}\s*$", above, re.DOTALL)
            behind = re.match(rf"[ \t]*{COMMENT}", below, re.DOTALL)
            for comment in (behind, before):
                if comment is not None and comment[1].strip():
                    yield " ".join(comment[1].split())[:LONGEST]


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
    return f"{', '.join(names[:MOST])}{more}"

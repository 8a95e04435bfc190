"""Results files: a line that says where and how they were made, then a line for each run, failures among them.

A row is a JSON object: one problem, planned by one planner of one tool with one seed. What ``KEYS`` names is always
there, what ``OPTIONAL`` names where a tool tells it; further keys are a tool's own.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import Node
from planner_service.files.reading import read_bytes
from planner_service.files.writing import require_writable, write_whole

__all__ = [
    *("KEYS", "OPTIONAL", "VERSION", "Key", "Results", "Row"),
    *("appending", "key_of", "line_of", "make_folder", "read", "read_some", "states_of"),
]

VERSION = 1

Row = dict[str, Any]
Key = tuple[str, str, str, str, int]
"""Suite, tool, planner, problem and seed: what makes two rows rows of the same run."""

MAX_BYTES = 500_000_000
"""A row takes about a kilobyte: half a million of them."""

MAX_PROBLEMS = 20
"""Problems of a file that are told; after these it is clear that it is another kind of file."""

VERDICTS = ("free", "colliding", "outside_limits", "not_asked")


@dataclass(frozen=True, eq=False)
class Results:
    """A results file: its header, and its rows in the order in which they were finished."""

    header: dict[str, Any]
    rows: tuple[Row, ...]


def key_of(row: Row) -> Key:
    """What the row is a run of."""
    return (row["suite"], row["tool"], row["planner"], row["problem"], row["seed"])


def states_of(row: Row, stage: str | None = None) -> int:
    """Configurations judged in a stage, in all stages if None."""
    told = row["checks"].values() if stage is None else [row["checks"].get(stage, {})]
    return sum(counts.get("states", 0) for counts in told)


def read(path: Path) -> Results:
    """The results in a file; a last line that was torn by an interruption is left out.

    Raises:
        InvalidFile: unreadable, not a results file, or rows that are not; with the first problems found.
    """
    lines = read_bytes(path, MAX_BYTES).split(b"\n")
    problems: list[str] = []
    whole = lines[:-1]  # what follows the last line feed was never finished, or is empty
    told = {number: line for number, line in enumerate(whole, 1) if line.strip()}
    if not told:
        raise InvalidFile(path, ["no results: the first line is missing"])
    found = {number: content for number, line in told.items() for content in _parsed(number, line, problems)}
    first = min(told)
    header = Node(f"line {first}", found.pop(first, _UNREAD), problems)
    if header.value is not _UNREAD:
        header = header.at("header")
        _check_header(header)
    for number, row in found.items():
        if len(problems) >= MAX_PROBLEMS:
            break
        _check_row(Node(f"line {number}", row, problems))
    if problems:
        raise InvalidFile(path, problems[:MAX_PROBLEMS])
    return Results(header.value, tuple(found.values()))


_UNREAD = object()


def read_some(path: Path) -> Results:
    """The results in a file, of which there has to be at least one.

    Raises:
        InvalidFile: as ``read``, or there is none.
    """
    results = read(path)
    if not results.rows:
        raise InvalidFile(path, ["no row in it; expected at least one"])
    return results


def make_folder(path: Path) -> None:
    """Make the folder of a file that is to be written, if it is not there.

    Raises:
        InvalidFile: it cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidFile(path, [f"its folder {path.parent} cannot be made: {reason}"]) from None


def line_of(content: Mapping[str, Any]) -> str:
    """A line of a file; no number in it may be infinite or NaN."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False) + "\n"


@contextmanager
def appending(path: Path, results: Results) -> Iterator[Callable[[Row], None]]:
    """Begin a file with a header, or go on after what there is in it; each row handed over is on disk when it returns.

    Args:
        results: The header, and the rows that are in the file already: a torn last line is cut off.

    Raises:
        InvalidRequest: another process is appending to it: its rows would be lost.
    """
    with _opened(path, "".join(map(line_of, [{"header": results.header}, *results.rows]))) as file:
        yield lambda row: _put(file, row)


def _opened(path: Path, content: str) -> IO[str]:
    """The file with that content, open for more, and locked until it is closed."""
    require_writable(path)
    folder = os.open(path.resolve().parent, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)  # for a moment: two that begin at once do so one after the other
        if path.exists():
            with open(path, "rb") as old:
                _lock(old, path)
        write_whole(path, content)
        file = open(path, "a", encoding="utf-8")  # noqa: SIM115 - closed by who asked for it
        _lock(file, path)
        return file
    finally:
        os.close(folder)


def _lock(file: IO[Any], path: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        message = f"--out: another process is writing to {path}; name another file, or wait until it is done"
        raise InvalidRequest("--out", str(path), "a file that nobody else writes to", message=message) from None


def _put(file: IO[str], row: Row) -> None:
    file.write(line_of(row))
    file.flush()
    os.fsync(file.fileno())


def _parsed(number: int, line: bytes, problems: list[str]) -> tuple[Any, ...]:
    """What a line says; nothing if it says nothing, which is one more problem."""
    try:
        return (json.loads(line.decode("utf-8"), parse_constant=_refused),)
    except (ValueError, RecursionError) as error:
        problems.append(f"line {number}: malformed JSON: {error}")
        return ()


def _refused(name: str) -> float:
    raise ValueError(f"{name} is not a number")


def _check_header(header: Node) -> None:
    version = header.at("version").whole()
    if header.sound and header.has("version") and version != VERSION:
        header.problem(f"version {version} is not {VERSION}, the one that is understood")
    header.at("suite").text()
    environment = header.at("environment")
    for key in ("python", "platform", "cpu"):
        environment.at(key).text()
    environment.at("cores").whole()
    if not isinstance(environment.at("versions").value, dict):
        environment.at("versions").wrong("an object")


def _check_row(row: Node) -> None:
    for key, check in KEYS.items():
        check(row.at(key))
    for key, check in OPTIONAL.items():
        if row.has(key):
            check(row.at(key))


def _maybe(read: Callable[[Node], object]) -> Callable[[Node], object]:
    return lambda node: node.optional(read)


def _counts(node: Node) -> None:
    for stage in _names(node):
        counts = node.at(stage)
        for kind in ("states", "edges", "distances"):
            counts.at(kind).whole()


def _seconds(node: Node) -> None:
    for stage in _names(node):
        node.at(stage).number()


def _peaks(node: Node) -> None:
    for kind in ("velocity", "acceleration", "jerk"):
        node.at(kind).optional(Node.number)


def _audit(node: Node) -> None:
    if node.at("verdict").text() not in VERDICTS:
        node.at("verdict").wrong(f"one of {', '.join(VERDICTS)}")
    node.at("step").optional(Node.number)
    node.at("depth").optional(Node.number)
    pair = node.at("pair")
    if pair.value is not None and len([item.text() for item in pair.items()]) != 2:
        pair.wrong("two names, or null")


def _built(node: Node) -> None:
    for kind in ("states", "edges", "distances", "milestones", "joined"):
        node.at(kind).whole()
    node.at("cpu_seconds").number()


def _texts(node: Node) -> None:
    for name in _names(node):
        node.at(name).text()


def _audits(node: Node) -> None:
    for what in _names(node):
        _audit(node.at(what))


def _names(node: Node) -> Iterable[str]:
    if isinstance(node.value, dict):
        return list(node.value)
    node.wrong("an object")
    return ()


KEYS: Mapping[str, Callable[[Node], object]] = {
    **dict.fromkeys(("suite", "problem", "kind", "robot", "tool", "planner", "detail"), Node.text),
    "seed": Node.whole,
    "ok": Node.flag,
    "failure": _maybe(Node.text),
    "checks": _counts,
    "seconds": _seconds,
    "total_seconds": Node.number,
    "cpu_seconds": Node.number,
    **dict.fromkeys(("raw_length", "length", "duration", "clearance"), _maybe(Node.number)),
    "peaks": _maybe(_peaks),
    "path_hash": _maybe(Node.text),
    "audit": _audit,
}
"""What every row has, and what is wrong with it if it is."""

OPTIONAL: Mapping[str, Callable[[Node], object]] = {
    "built": _built,
    "versions": _texts,
    "audits": _audits,
    **dict.fromkeys(("raw_duration", "raw_waypoints", "waypoints"), Node.number),
}
"""What building a planner cost, once for its scene and seed; versions of a peer's packages, its audits one by one, and
what the lesson's exercise tells besides."""

"""Results files: a line that says where and how they were made, then a line for each run, failures among them.

A row is a JSON object: one problem, planned by one planner of one tool with one seed. ``RowRecord`` says what is in it;
further keys are a tool's own.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated, Any

from pydantic import AfterValidator, ConfigDict, Field

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import read_bytes
from planner_service.files.schema import Count, Reading, Record, of_length, read_record
from planner_service.files.writing import require_writable, write_whole

__all__ = [
    *("VERSION", "Key", "Results", "Row", "RowRecord"),
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
    header = found.pop(first, None)
    if header is not None:
        _check(_FirstLine, header, path, first, problems)
    for number, row in found.items():
        if len(problems) >= MAX_PROBLEMS:
            break
        _check(RowRecord, row, path, number, problems)
    if problems or header is None:
        raise InvalidFile(path, problems[:MAX_PROBLEMS])
    return Results(header["header"], tuple(found.values()))


def _check(model: type[Record], line: Any, path: Path, number: int, problems: list[str]) -> None:
    """Note what is wrong with a line."""
    try:
        read_record(model, line, path, Reading(where=f"line {number}"))
    except InvalidFile as error:
        problems += error.problems


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


# Lines, declared.


def _expected(fits: Callable[[Any], bool], what: str) -> AfterValidator:
    def read(value: Any) -> Any:
        if not fits(value):
            raise ValueError(what)
        return value

    return AfterValidator(read)


Words = Annotated[str, _expected(lambda text: text.replace("\n", "").isprintable(), "a text of printable characters")]
Version = Annotated[Count, _expected(lambda version: version == VERSION, f"version {VERSION}")]
Verdict = Annotated[str, _expected(lambda verdict: verdict in VERDICTS, f"one of {', '.join(VERDICTS)}")]


class _Open(Record):
    """An object that may have further keys."""

    model_config = ConfigDict(extra="ignore")


class _Environment(_Open):
    python: Words
    platform: Words
    cpu: Words
    cores: Count
    versions: dict[str, Any]


class _Header(_Open):
    version: Version
    suite: Words
    environment: _Environment


class _FirstLine(_Open):
    header: _Header


class _Cost(_Open):
    states: Count
    edges: Count
    distances: Count


class _Built(_Cost):
    """What building a planner cost, once for its scene and seed."""

    milestones: Count
    joined: Count
    cpu_seconds: float


class _Peaks(_Open):
    velocity: float | None
    acceleration: float | None
    jerk: float | None


class _Audit(_Open):
    verdict: Verdict
    step: float | None
    depth: float | None
    pair: Annotated[list[Words], of_length(2, "two names, or null")] | None


class RowRecord(_Open):
    """A row. It may lack what some tools alone have: what building cost, a peer's versions and its single audits."""

    suite: Words
    problem: Words
    kind: Words
    robot: Words
    tool: Words
    planner: Words
    detail: Words
    seed: Count
    ok: bool
    failure: Words | None
    checks: dict[str, _Cost]
    seconds: dict[str, float]
    total_seconds: float
    cpu_seconds: float
    raw_length: float | None
    length: float | None
    duration: float | None
    clearance: float | None
    peaks: _Peaks | None
    path_hash: Words | None
    audit: _Audit
    built: _Built | None = None
    versions: dict[str, Words] = Field({})
    audits: dict[str, _Audit] = Field({})

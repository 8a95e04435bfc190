"""What can go wrong, and who can mend it.

::

    PlannerServiceError
    ├─ InvalidRequest (ValueError)       the caller's mistake: .field, .value, .expected
    │  ├─ UnknownName (LookupError)      .kind, .name, .available
    │  ├─ InvalidFile                    .path, .problems: all of them, not the first
    │  └─ NotProven                      .problems: of a plan that was proven again before its use
    ├─ PlanningFailed                    only from PlanResult.unwrap(); carries .failure
    ├─ BrokenInvariant                   our bug; nobody catches it
    ├─ MissingDependency (ImportError)   names the package, and the extra that brings it
    └─ TimingFailed                      from a timing law used by itself; in a plan it is a Failure

That no plan was found is not an error: ``PlanResult.failure`` says why.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

__all__ = [
    "BrokenInvariant",
    "InvalidFile",
    "InvalidRequest",
    "MissingDependency",
    "NotProven",
    "PlannerServiceError",
    "PlanningFailed",
    "UnknownName",
    "shown",
]


MOST_PROBLEMS = 10
"""Of a plan that does not hold, in one message; a file can have thousands."""

MAX_LISTED = 100
"""Problems of a file that are listed; a small file can have a million."""

SHOWN = 300
"""Characters of a value that an error message shows; callers can hand in a list of a million."""


def shown(value: object) -> str:
    """``repr`` for error messages: shortened in the middle, and never an error of its own."""
    try:
        text = repr(_plain(value))
    except Exception:  # Python refuses to print integers of thousands of digits; other objects may raise anything
        return f"<{type(value).__name__}>"
    return text if len(text) <= SHOWN else f"{text[: SHOWN // 2]}...{text[-SHOWN // 4 :]}"


def _plain(value: object, depth: int = 2) -> object:
    """numpy's numbers as Python's, which are written without the name of their type, in short lists and tuples, too."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist() if value.size <= SHOWN else value
    if depth > 0 and isinstance(value, (list, tuple)) and type(value) in (list, tuple) and len(value) <= SHOWN:
        return type(value)([_plain(each, depth - 1) for each in value])
    return value


class PlannerServiceError(Exception):
    """Everything this package raises on purpose. It comes back from another process as it was."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), self.args), dict(self.__dict__)


def _again(kind: type[PlannerServiceError], args: tuple[Any, ...]) -> PlannerServiceError:
    """An error of that kind, made without its own arguments, which its message was made of."""
    return kind.__new__(kind, *args)


class InvalidRequest(PlannerServiceError, ValueError):
    """A value the caller gave cannot be used; the message names it and says what would be right.

    Attributes:
        field: The argument or attribute, such as ``start`` or ``goal[1]``.
        value: What was given.
        expected: What would be right, in words.
    """

    def __init__(self, field: str, value: Any, expected: str, *, message: str | None = None) -> None:
        super().__init__(message or f"{field}: got {shown(value)}; expected {expected}")
        self.field = field
        self.value = value
        self.expected = expected


class UnknownName(InvalidRequest, LookupError):
    """A name that nothing has; the message offers the nearest that exists.

    Attributes:
        kind: Of what: a robot, a scene, an obstacle.
        name: What was given.
        available: The names there are, sorted.
    """

    def __init__(self, kind: str, name: str, available: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.available = tuple(sorted(available))
        near = _nearest(name if isinstance(name, str) else shown(name), self.available)
        hint = f"did you mean {near[0]!r}?" if near else f"available: {', '.join(self.available) or 'none'}"
        message = f"unknown {kind} {shown(name)}; {hint}"
        super().__init__(kind, name, f"one of {', '.join(self.available)}", message=message)


def _nearest(name: str, available: Sequence[str]) -> list[str]:
    """The name that was probably meant: the shortest that has it as a part, or else one that is spelt alike."""
    if len(name) > SHOWN:  # comparing spellings takes as long as the product of their lengths
        return []
    part = name.casefold()
    having = [other for other in available if len(part) > 2 and part in other.casefold()]
    having.sort(key=lambda other: (not other.casefold().startswith(part), len(other)))
    return having[:1] or get_close_matches(name, available, n=1)


class InvalidFile(InvalidRequest):
    """A file that cannot be used, with the problems found in it.

    Attributes:
        path: The file.
        problems: One line each, in the order of the file; after the first 100 one line that counts the rest.
    """

    def __init__(self, path: Path | str, problems: Sequence[str]) -> None:
        self.path = Path(path)
        more = len(problems) - MAX_LISTED
        self.problems = (*problems[:MAX_LISTED], *([f"and {more:,} more"] if more > 0 else []))
        lines = "".join(f"\n  - {problem}" for problem in self.problems)
        name = str(path).encode("utf-8", "backslashreplace").decode()  # half a surrogate pair cannot be printed
        super().__init__("file", str(path), "a valid file", message=f"{name}: {len(problems):,} problem(s){lines}")


class NotProven(InvalidRequest):
    """A plan or a task that was proven again before its use, and does not hold.

    Attributes:
        problems: Which motion, and why: one line each.
    """

    def __init__(self, *problems: str) -> None:
        self.problems = problems
        listed = [f"\n  - {problem}" for problem in problems[:MOST_PROBLEMS]]
        listed += [f"\n  ... and {len(problems) - len(listed)} more"] if len(problems) > len(listed) else []
        lines = f" {problems[0]}" if len(problems) == 1 else "".join(listed)
        super().__init__("plan", lines.strip(), "a plan that is proven again", message=f"not proven:{lines}")


class PlanningFailed(PlannerServiceError):
    """``PlanResult.unwrap()`` was called on a result without a plan.

    Attributes:
        failure: Why there is none (``Failure``).
    """

    def __init__(self, failure: Any) -> None:
        super().__init__(str(failure))
        self.failure = failure


class BrokenInvariant(PlannerServiceError):
    """A promise of this package does not hold: please report it."""


class MissingDependency(PlannerServiceError, ImportError):
    """An optional package is not installed.

    Attributes:
        package: Its name.
        extra: Which extra of this package brings it.
    """

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; pip install 'planner-service[{extra}]' brings it")
        self.package = package
        self.extra = extra

"""What every attack is made of: inputs that can be drawn and run, and how an outcome is judged.

An input is a dictionary of plain JSON values, so whatever fails can be stored as it is, and run again.
"""

from __future__ import annotations

import abc
import base64
import binascii
import json
import resource
import time
import traceback
import warnings
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import planner_service as ps

__all__ = ["Case", "Finding", "Part", "Wrong", "further", "judged", "packed", "read_finding", "rng_of", "unpacked"]

Case = dict[str, Any]

MEMORY_GROWTH = 1_000_000_000
"""Bytes that one input may add to the peak of the process."""


class Wrong(Exception):
    """An answer that breaks a law."""

    def __init__(self, law: str, detail: str = "") -> None:
        super().__init__(f"{law}: {detail}" if detail else law)
        self.law = law


@dataclass(frozen=True)
class Finding:
    """An input that does harm.

    Attributes:
        kind: crash, hang, untyped, invariant, wrong, memory or leftover.
        signature: What tells one fault from another: the error and where it came from, or the law that was broken.
        number: Which input of this seed it was.
        seen: How many inputs had this signature.
    """

    part: str
    kind: str
    signature: str
    detail: str
    seed: int
    number: int
    case: Case
    seen: int = 1

    def text(self) -> str:
        """As it is stored."""
        return json.dumps(asdict(self), indent=1) + "\n"


def read_finding(path: Path) -> Finding:
    """A finding as ``Finding.text`` has it."""
    return Finding(**json.loads(path.read_text("utf-8")))


class Part(abc.ABC):
    """One attack. Everything that it needs is made in the worker, after it has lost its rights.

    Attributes:
        limit: Seconds after which an input hangs.
    """

    name: ClassVar[str]
    what: ClassVar[str]
    limit: ClassVar[float] = 10.0

    def __init__(self) -> None:
        self.counted: Counter[str] = Counter()
        self.extremes: dict[str, float] = {}

    @abc.abstractmethod
    def draw(self, rng: np.random.Generator) -> Case:
        """An input."""

    @abc.abstractmethod
    def run(self, case: Case) -> int | None:
        """Do it, and raise ``Wrong`` for a wrong answer; how many inputs it was if not one."""

    def extreme(self, what: str, value: float) -> None:
        """Keep the least of something that is measured, or the most if that is how ``what`` begins."""
        self.extremes[what] = further(what, value, self.extremes.get(what))


def packed(data: bytes) -> str:
    """Bytes as a text of JSON."""
    return base64.b64encode(data).decode("ascii")


def unpacked(text: str) -> bytes:
    """Bytes of such a text."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return text.encode("utf-8", "surrogatepass")


def further(what: str, value: float, other: float | None) -> float:
    """Of two measured values the one to keep."""
    if other is None:
        return value
    return max(value, other) if what.startswith("most") else min(value, other)


def rng_of(seed: int, number: int) -> np.random.Generator:
    """What an input is drawn with: the same for the same seed and number, in any process."""
    return np.random.default_rng((seed, number))


@dataclass
class Outcome:
    """How one input went: ``kind`` is passed, refused, or that of a finding."""

    kind: str
    inputs: int = 1
    signature: str = ""
    detail: str = ""
    seconds: float = field(default=0.0)


def judged(part: Part, case: Case) -> Outcome:
    """Run an input in this process, and say how it went."""
    before, clock = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            count = part.run(case)
        out = Outcome("passed", 1 if count is None else count)
    except Wrong as error:
        out = Outcome("wrong", 1, f"wrong: {error.law}", str(error))
    except ps.BrokenInvariant as error:
        out = Outcome("invariant", 1, f"BrokenInvariant at {_where(error)}", str(error))
    except ps.PlannerServiceError:
        out = Outcome("refused")
    except MemoryError as error:
        out = Outcome("memory", 1, f"MemoryError at {_where(error)}", "no memory within the cap")
    except BaseException as error:
        out = Outcome("untyped", 1, f"{type(error).__name__} at {_where(error)}", _told(error))
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    if grown > MEMORY_GROWTH and out.kind in ("passed", "refused"):
        out = Outcome("memory", 1, "one input takes much memory", f"{grown / 1e9:.1f} GB more")
    out.seconds = time.perf_counter() - clock
    return out


def _told(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"[:500]
    except Exception:
        return type(error).__name__


def _where(error: BaseException) -> str:
    """The innermost place of the package that an error went through."""
    ours = [
        f"{frame.filename.rsplit('planner_service/', 1)[1]}:{frame.name}"
        for frame in traceback.extract_tb(error.__traceback__)
        if "/planner_service/" in frame.filename
    ]
    return ours[-1] if ours else "the attack itself"

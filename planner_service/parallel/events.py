"""What workers report: they are ready, have an answer or an error, or are no more."""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from typing import Any

from planner_service.parallel.engine import Work

__all__ = ["Answered", "Event", "Gone", "Raised", "Ready", "outcome"]


@dataclass(frozen=True)
class Ready:
    """It has its work, and waits for items."""


@dataclass(frozen=True)
class Answered:
    """It is done with its item."""

    value: Any


@dataclass(frozen=True, eq=False)
class Raised:
    """Its work raised this, there."""

    error: Exception
    traceback: str


@dataclass(frozen=True)
class Gone:
    """It ended; ``blameless`` if that is known to have nothing to do with its item."""

    detail: str
    blameless: bool = False


Event = Ready | Answered | Raised | Gone


def outcome(work: Work[Any, Any], item: Any) -> Answered | Raised | Gone:
    """What one item comes to, told by the worker; without memory it can go on no more."""
    try:
        return Answered(work(item))
    except MemoryError as error:
        return Gone(f"it ran out of memory: {error}" if str(error) else "it ran out of memory")
    except Exception as error:
        return Raised(error, traceback.format_exc())

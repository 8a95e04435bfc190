"""How arms were driven together: where each was commanded and seen, and how far one was behind another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner_service.errors import PlannerServiceError
from planner_service.execute.report import Recording
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import copied_in, numbers

__all__ = ["ArmCourse", "CellReport", "CellStopped"]


@dataclass(frozen=True, eq=False)
class ArmCourse:
    """What one arm did.

    Attributes:
        recording: Commands and readings, tick by tick; its times count from the common start.
        clock: Seconds of the plan at which the arm was commanded to be, shape (m,).
        seen: The same of where it was seen: no later than it was there.
        off: The largest distance of a joint from where the arm was commanded to be, lag apart, in rad or m.
    """

    recording: Recording
    clock: FloatArray
    seen: FloatArray
    off: float

    def __post_init__(self) -> None:
        for name in ("clock", "seen"):
            object.__setattr__(self, name, numbers(name, getattr(self, name), "numbers"))


@dataclass(frozen=True, eq=False)
class CellReport:
    """An execution of several arms.

    Attributes:
        arms: By their names.
        speed: Part of the planned speed.
        seconds: Wall time, settling included.
        simulated: Whether nothing real moved.
        tolerated: Seconds of the plan by which any arm could be late.
        behind: The most by which one was seen to be behind another.
        stopped: Why it ended before its end, and how each arm came to rest; None if it did not.
    """

    arms: Mapping[str, ArmCourse]
    speed: float
    seconds: float
    simulated: bool
    tolerated: float
    behind: float
    stopped: str | None = None

    def __post_init__(self) -> None:
        copied_in(self, "arms")

    @property
    def ok(self) -> bool:
        """Whether everything was executed."""
        return self.stopped is None

    def document(self) -> dict[str, Any]:
        """The figures, of plain JSON values; positions are in the recordings."""
        return {
            "ok": self.ok,
            "stopped": self.stopped,
            "simulated": self.simulated,
            "speed": self.speed,
            "seconds": self.seconds,
            "tolerated": self.tolerated,
            "behind": self.behind,
            "arms": {
                name: {
                    "ticks": len(course.clock),
                    "skipped": course.recording.skipped,
                    "off": course.off,
                    "until": float(course.clock[-1]) if len(course.clock) else 0.0,
                    "latest_tick": float(np.max(course.recording.lateness, initial=0.0)),
                }
                for name, course in self.arms.items()
            },
        }


class CellStopped(PlannerServiceError):
    """An execution of several arms that ended before its end. ``report`` says how each came to rest."""

    def __init__(self, report: CellReport) -> None:
        super().__init__(report.stopped)
        self.report = report

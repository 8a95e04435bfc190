"""What a gate decides about targets, and how often it decided what."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from planner_service.geometry.arrays import FloatArray

__all__ = ["Counts", "Kind", "Refused", "Verdict"]


class Kind(Enum):
    """Why a target is refused."""

    NUMBER = "number"
    LIMIT = "limit"
    SPEED = "speed"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    TORQUE = "torque"
    CONTACT = "contact"
    STOP = "stop"
    TRACKING = "tracking"
    SCENE = "scene"
    LATE = "late"


@dataclass(frozen=True)
class Refused:
    """Why targets did not pass.

    Attributes:
        kind: Of what is wrong.
        index: Of the first of the chunk that did not.
        detail: In words, with numbers.
        time: Seconds from the check until that target was to be sent.
        joint: The joint that is at fault, by name; empty for contacts.
        pair: What would, or could, touch; none if it is not that.
        at: The configuration at which, (n,); empty likewise.
        depth: Metres by which the two overlap there, at most; 0 where they do not, but are nearer than the room that
            the arm may need.
    """

    kind: Kind
    index: int
    detail: str
    time: float = 0.0
    joint: str = ""
    pair: tuple[str, str] | None = None
    at: tuple[float, ...] = ()
    depth: float = 0.0

    def __str__(self) -> str:
        return f"target {self.index}: {self.detail}"


@dataclass(frozen=True, eq=False)
class Verdict:
    """What may be sent of a chunk.

    Attributes:
        targets: What passes, (a, n), one to be sent each period.
        stop: What brings the arm to rest, (m, n), to be sent after these if nothing else passes. Its last row is where
            the arm comes to rest.
        refused: Why the rest of the chunk did not pass, or the whole of it as it is if ``repaired``; None if all did.
        speed: 1, or the share of its way that the chunk gets done in its time where it was to be slowed down.
        repaired: Whether the targets are what passes of the chunk, a plan round what is in the way, and the rest of it.
        proven: Whether all of ``rows`` is proven free. If not, the arm is told to stay where it is, for the reason in
            ``refused``: it is not where its driver should have it, or the scene changed too close to it.
        bounds: What the proof asked.
        due: Seconds, counted from when the next target was to be sent, within which the first row is to be with the
            driver: the jitter. A verdict that is late counts for nothing, and the gate is to know that (``late``).
    """

    targets: FloatArray
    stop: FloatArray
    refused: Refused | None
    speed: float = 1.0
    repaired: bool = False
    proven: bool = True
    bounds: int = 0
    due: float = math.inf

    @property
    def rows(self) -> FloatArray:
        """What to send, (a + m, n), one each period, until there is another verdict: targets, then the stop."""
        return np.concatenate([self.targets, self.stop])

    @property
    def accepted(self) -> int:
        """How many targets pass."""
        return len(self.targets)

    @property
    def ok(self) -> bool:
        """Whether the whole chunk passes as it is."""
        return self.refused is None and self.speed == 1.0


@dataclass(eq=False)
class Counts:
    """What a gate has decided so far.

    Attributes:
        chunks: Checked.
        accepted: Targets that passed, changed or not.
        refused: Chunks of which something did not pass, by kind.
        slowed: Chunks that passed at less than their own speed.
        repaired: Chunks that passed with a plan in them.
        bounds: What the proofs asked.
        unlogged: Refusals and changes that are not in the log, because it is full or cannot be written any more.
    """

    chunks: int = 0
    accepted: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    slowed: int = 0
    repaired: int = 0
    bounds: int = 0
    unlogged: int = 0

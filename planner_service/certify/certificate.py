"""What was proven of a curve, and where a proof ended, as values."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field

from planner_service.certify.interval_proof import Span
from planner_service.certify.kept_proof import Kept, KeptRefusal
from planner_service.certify.pairs import pairs_of_names
from planner_service.geometry.validation import copied_in, number
from planner_service.robot.model import AllowedContact

__all__ = ["CARRIED_TOGETHER", "Certificate", "ExemptInterval", "Refusal", "clearance_text", "proof_text"]

CARRIED_TOGETHER = "carried together"
"""Why two objects on the tool are not judged: nothing moves them against each other."""


@dataclass(frozen=True)
class ExemptInterval:
    """A stretch of the path, in path length s, on which named pairs need not be apart, and why.

    Attributes:
        depth: Metres by which the pairs may overlap there: that they do so by no more is proven. None: they are not
            judged there at all.

    Raises:
        InvalidRequest: ``pairs`` are not pairs of two names, the ends are no numbers in order, or the depth is
            negative or not finite.
    """

    s_start: float
    s_end: float
    pairs: tuple[tuple[str, str], ...]
    reason: str
    depth: float | None = None

    def __post_init__(self) -> None:
        start = number("s_start", self.s_start, "a number >= 0", 0.0, math.inf)
        number("s_end", self.s_end, f"a number >= {start:.9g}", start, math.inf)
        object.__setattr__(self, "pairs", pairs_of_names("pairs", self.pairs))
        if self.depth is not None:
            number("depth", self.depth, "metres >= 0, or None", 0.0, sys.float_info.max)

    def __str__(self) -> str:
        pairs = ", ".join(f"{a} x {b}" for a, b in self.pairs)
        if self.depth is not None:
            where = f"from s = {self.s_start:.3f} to {self.s_end:.3f}"
            return f"overlapping by at most {self.depth * 1e3:.4f} mm {where}: {pairs} ({self.reason})"
        return f"not judged from s = {self.s_start:.3f} to {self.s_end:.3f}: {pairs} ({self.reason})"


@dataclass(frozen=True)
class Refusal:
    """Where a proof ended.

    Attributes:
        s_start: Where, in path length s, the stretch begins on which a pair could not be proven apart.
        s_end: Where it ends.
        s: Where on it.
        a: One of the pair, by name.
        b: The other.
        detail: Why, in words.
        spent: Whether there was no end to it, rather than a place where the two are too close.
    """

    s_start: float
    s_end: float
    s: float
    a: str
    b: str
    detail: str
    spent: bool = False

    def __str__(self) -> str:
        where = f"from s = {self.s_start:.6g} to {self.s_end:.6g}"
        return f"{self.what} is not proven apart {where}: {self.detail}"

    @property
    def what(self) -> str:
        """The pair, in words."""
        return f"{self.a} x {self.b}"


@dataclass(frozen=True)
class Certificate:
    """What was proven of a curve.

    Attributes:
        clearance: Metres that every judged pair keeps on the whole curve, a lower bound in whole nanometres; infinite
            when no pair is judged, and -inf for a refused curve.
        distances: (configuration, pair) bounds asked.
        padding: Every judged pair was proven farther apart than this and ``MARGIN``.
        exempt: Stretches on which named pairs were not judged, or proven to overlap by no more than a depth.
        refusal: None when the whole curve is proven, else the pair or the constraint that is not, and where.
        part: From where to where in s the curve was judged; None: all of it.
        allowed: Pairs that were judged nowhere because the caller allows them to touch, sorted.
        kept: What is proven of each constraint, in their order; none if one of them is refused.
        contacts: The pairs that were judged nowhere, each with its reason: of links with shapes that the robot allows
            to touch, and of objects that are carried together, which cannot move against each other. They follow from
            the robot and the scene of a plan file, so a certificate read from one has none itself.
    """

    clearance: float
    distances: int
    padding: float
    exempt: tuple[ExemptInterval, ...] = ()
    refusal: Refusal | KeptRefusal | None = None
    part: Span | None = None
    allowed: tuple[tuple[str, str], ...] = ()
    kept: tuple[Kept, ...] = ()
    contacts: tuple[AllowedContact, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        copied_in(self, "exempt", "kept", "contacts")

    def __str__(self) -> str:
        if self.refusal is not None:
            return self.verdict
        return "; ".join([f"proven: {proof_text(self.clearance, self.distances)}", *map(str, self.kept)])

    @property
    def verdict(self) -> str:
        """The same without what it cost."""
        if self.refusal is not None:
            return f"refused: {self.refusal}"
        return "; ".join([f"proven: {clearance_text(self.clearance)}", *map(str, self.kept)])

    @property
    def certified(self) -> bool:
        """Whether the whole curve, or the part of it that was judged, is proven."""
        return self.refusal is None

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Where pairs were not judged that neither the robot nor the caller allows to touch, in words."""
        together = [contact.links for contact in self.contacts if contact.reason == CARRIED_TOGETHER]
        return (*map(str, self.exempt), *(f"not judged: {a} x {b} ({CARRIED_TOGETHER})" for a, b in together))


def clearance_text(metres: float) -> str:
    """A proven clearance in words, rounded down."""
    if metres == math.inf:
        return "nothing to touch"
    return f"{math.floor(metres * 1e5) / 100:.2f} mm clear" if metres < 0.1 else f"{metres:.3f} m clear"


def proof_text(clearance: float, bounds: int) -> str:
    """What is proven of one or more motions: their smallest clearance in metres, and what it cost."""
    return f"{clearance_text(clearance)}, between samples too ({bounds:,} bounds)"

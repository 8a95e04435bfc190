"""Clearances, proofs and rounded numbers as text."""

from __future__ import annotations

import math
from collections.abc import Iterable

__all__ = ["clearance_text", "numbers_text", "proof_text"]


def clearance_text(metres: float) -> str:
    """A proven clearance in words, rounded down."""
    if metres == math.inf:
        return "nothing to touch"
    return f"{math.floor(metres * 1e5) / 100:.2f} mm clear" if metres < 0.1 else f"{metres:.3f} m clear"


def proof_text(clearance: float, bounds: int) -> str:
    """What is proven of one or more motions: their smallest clearance in metres, and what it cost."""
    return f"{clearance_text(clearance)}, between samples too ({bounds:,} bounds)"


def numbers_text(values: Iterable[float], separator: str = ", ") -> str:
    """Numbers rounded to a tenth of a milliradian or millimetre."""
    return separator.join(f"{round(value, 4):g}" for value in values)

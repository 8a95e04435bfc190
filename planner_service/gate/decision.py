"""What a gate decided last, as a value: for whoever looks on from another thread, such as the viewer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from planner_service.certify.certifier import Certifier
from planner_service.gate.tracking import Setpoint, Tracking, Whereabouts
from planner_service.gate.verdict import Verdict
from planner_service.geometry.arrays import FloatArray

__all__ = ["Decision"]


@dataclass(frozen=True, eq=False)
class Decision:
    """One decision of a gate, and what it knew of the arm then.

    Attributes:
        number: How many chunks the gate had checked by then.
        q: Where the arm was measured, (n,); None if the scene changed and nothing was measured.
        verdict: What was decided.
        here: Where the arm could be then.
        setpoint: Where its setpoint could be then.
        target: The last that had been sent, (n,); None if there was none.
        tracking: What is assumed of the driver.
        rate: Targets a second.
        padding: Metres that everything keeps beyond the room that the arm may need.
        certifier: Of the scene as the gate knew it.
    """

    number: int
    q: FloatArray | None
    verdict: Verdict
    here: Whereabouts
    setpoint: Setpoint
    target: FloatArray | None
    tracking: Tracking
    rate: float
    padding: float
    certifier: Certifier

    @cached_property
    def ahead(self) -> Whereabouts:
        """Where the arm can be from then on, until it rests: on its way if nothing more is sent, then to each row."""
        return self.setpoint.ahead(self.target, self.verdict.rows, self.tracking, 1.0 / self.rate)

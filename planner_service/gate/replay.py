"""What a gate would have let pass of motions that were recorded without one."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planner_service.errors import InvalidRequest
from planner_service.gate.action_gate import ActionGate
from planner_service.gate.log import Logged
from planner_service.gate.verdict import Refused
from planner_service.geometry.arrays import FloatArray

__all__ = ["Replayed", "replayed"]


@dataclass(frozen=True, eq=False)
class Replayed:
    """How far a recording passes.

    Attributes:
        targets: That were recorded.
        passed: Before the first that does not pass; all of them if none is refused.
        refused: Why it does not; its ``index`` and ``time`` are the recording's. None if all pass.
        logged: What a log would have of it; None likewise.
    """

    targets: int
    passed: int
    refused: Refused | None
    logged: Logged | None = None


def replayed(gate: ActionGate, measured: FloatArray, targets: FloatArray) -> Replayed:
    """Check a recording, target by target, up to the first that does not pass.

    Args:
        gate: Of the cell in which it was recorded; it is reset first. What passes slowed down, or led round something,
            is refused here.
        measured: Where the arm was when each target was sent, (m, n); it stood still at the first.
        targets: What was sent, one each period, (m, n).

    Raises:
        InvalidRequest: other shapes, or a first measurement that is not finite.
    """
    if measured.shape != targets.shape:
        raise InvalidRequest("measured", measured.shape, f"one row for each target, {targets.shape}")
    gate.reset()
    for k, (q, target) in enumerate(zip(measured, targets, strict=True)):
        verdict = gate.check(q, target)
        if not verdict.ok:
            refused = verdict.refused and replace(verdict.refused, index=k, time=k / gate.rate)
            logged = Logged.of(k / gate.rate, k + 1, replace(verdict, refused=refused), q)
            return Replayed(len(targets), k, refused, logged)
    return Replayed(len(targets), len(targets), None)

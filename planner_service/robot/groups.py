"""Planning groups: parts of a robot that an SRDF names, such as one arm of two."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PlanningGroup"]


@dataclass(frozen=True)
class PlanningGroup:
    """Joints that are planned for together, in the order of the SRDF, and the link at the end of their chain, if any.

    Joints that do not move by themselves, being fixed or mimics, may be among them.
    """

    name: str
    joints: tuple[str, ...]
    tip: str | None = None

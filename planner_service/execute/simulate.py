"""Executes a plan on the simulated arm, and reports what touched what and where carried objects ended up."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from planner_service.errors import BrokenInvariant
from planner_service.execute.preconditions import Executable
from planner_service.execute.report import ExecutionReport, ExecutionStopped
from planner_service.execute.settings import Streaming
from planner_service.execute.simulator import ArmContact, SimulatedArm
from planner_service.execute.stream import execute
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import PlanResult
from planner_service.robot.model import Robot
from planner_service.scene.names import Kind, Owner, owner_of
from planner_service.service import PlannerService

__all__ = ["Rehearsal", "meant_contacts", "rehearse", "taken"]


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """An execution in simulation.

    Attributes:
        report: How it was executed, also if it was stopped.
        contacts: Unexpected ones: the robot, or what it carried, with anything.
        meant: Those of pairs that the plan says may touch: fingers and what they take, that and its supports.
        loose: Where loose obstacles are in the end, by name.
    """

    report: ExecutionReport
    contacts: tuple[ArmContact, ...]
    meant: tuple[ArmContact, ...]
    loose: Mapping[str, Pose]

    def __post_init__(self) -> None:
        copied_in(self, "contacts", "meant", "loose")

    @property
    def ok(self) -> bool:
        """Whether all of it was executed, and nothing touched that was not meant to."""
        return self.report.ok and not self.contacts

    def document(self) -> dict[str, Any]:
        """The figures, of plain JSON values."""
        return {
            **self.report.document(),
            "contacts": [_record(contact) for contact in self.contacts],
            "meant_contacts": [_record(contact) for contact in self.meant],
            "loose": {
                name: {"position": list(pose.position), "quaternion_wxyz": list(pose.quaternion)}
                for name, pose in self.loose.items()
            },
        }


def rehearse(
    arm: SimulatedArm,
    plan: Executable,
    robot: Robot,
    streaming: Streaming | None = None,
    *,
    service: PlannerService | None = None,
    allowed: Sequence[tuple[str, str]] = (),
    allow_unproven: bool = False,
) -> Rehearsal:
    """Execute a plan on a simulated arm, which stands where it begins; see ``execute``.

    Raises:
        InvalidRequest: as ``execute`` says.
        ExecutionStopped: it was stopped, and the simulation cannot say any more what touched: it ended itself.
    """
    with closing(arm.connect()) as driver:
        ended: ExecutionStopped | None = None
        try:
            report = execute(
                plan, driver, robot, streaming, service=service, allowed=allowed, allow_unproven=allow_unproven
            )
        except ExecutionStopped as stopped:
            report, ended = stopped.report, stopped
        try:
            loose, contacts = arm.poses(), arm.contacts()
        except BrokenInvariant:
            if ended is not None:
                raise ended from None
            raise
    may = meant_contacts(plan)
    return Rehearsal(
        report,
        tuple(contact for contact in contacts if contact.pair not in may),
        tuple(contact for contact in contacts if contact.pair in may),
        loose,
    )


def meant_contacts(plan: Executable) -> Collection[frozenset[str]]:
    """Pairs of names that are not checked on some stretch of a plan, because they are meant to touch there."""
    if isinstance(plan, Trajectory):
        return frozenset()
    results = [plan] if isinstance(plan, PlanResult) else [segment.result for segment in plan.segments]
    return frozenset(frozenset(pair) for result in results for interval in result.exempt for pair in interval.pairs)


def taken(plan: Executable, robot: Robot) -> tuple[str, ...]:
    """The obstacles that a plan takes: those that the robot's fingers are meant to touch."""
    fingers = {Owner(Kind.LINK, link) for link in (() if robot.gripper is None else robot.gripper.links)}
    pairs = [{owner_of(name, robot) for name in pair} for pair in meant_contacts(plan)]
    return tuple(sorted({owner.name for pair in pairs if pair & fingers for owner in pair - fingers}))


def _record(contact: ArmContact) -> dict[str, Any]:
    return {**vars(contact), "position": list(contact.position)}

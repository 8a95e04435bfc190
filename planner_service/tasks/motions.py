"""What a task is made of: searched motions, given lines, gripper motions, and inverse kinematics, with what they cost.

Every question of a task that costs something is asked here, counted here, and asked once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from typing import Any, TypeVar

import numpy as np

from planner_service.certify import GripperMotion
from planner_service.collision import CancelToken, CheckCounts, CollisionChecker
from planner_service.collision.budget import Cancelled
from planner_service.constraints import Constraint
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.grasping.kinds import GraspKind, GraspKinds
from planner_service.kinematics.cartesian_waypoints import line_blends
from planner_service.kinematics.inverse import ToolChain, inverse_kinematics
from planner_service.memory import Memory
from planner_service.planning.follow import AllowedStretch
from planner_service.planning.request import Pace, PlanRequest, keeps_torques
from planner_service.planning.result import Failure, PlanResult, Reason, Stage
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.timing.laws import Timing

__all__ = ["Ended", "Motions", "NoMotion", "Touch"]

Pair = tuple[str, str]

T = TypeVar("T")

FoundGrasps = tuple[GraspKind, tuple[Pose, ...], str]
"""A kind, its grasps, and why there are none."""

LOOKS = 3
"""Ways whose lines may be proven for each search that a task may try."""


class NoMotion(Exception):
    """A motion, or something that it needs, is not possible.

    Attributes:
        result: The plan that failed; None if it was none.
    """

    def __init__(self, why: str, result: PlanResult | None = None) -> None:
        super().__init__(why)
        self.result = result


class Ended(Exception):
    """The task ends here: cancelled, or its time or its searches are used up."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(str(failure))
        self.failure = failure


class Touch:
    """Pairs that may touch, within how many metres of the contact (None for all of the line), and why."""

    def __init__(self, pairs: tuple[Pair, ...], within: float | None, reason: str) -> None:
        self.pairs, self.within, self.reason = pairs, within, reason


class Motions:
    """Plans and proves what a task asks for, with the settings of one request.

    Attributes:
        request: Planner, timing, seed, padding, scales, constraints and limits of all motions; its start is where the
            task begins.
        law: The timing law along given lines; the request's if None.
        memory: What is remembered where the task stands; None to go without.
        spent: The collision checks of everything so far.
    """

    def __init__(
        self, request: PlanRequest, law: Timing | None, cancel: CancelToken | None, *, turns: int, searches: int
    ) -> None:
        """See the class; the time limit of the request holds ``turns`` times, and searches are tried at most so many
        times."""
        self.request, self.law, self.spent = request, law, CheckCounts()
        self.memory: Memory | None = None
        self._cancel = cancel
        limit = request.time_limit
        self._deadline = None if limit is None else time.monotonic() + turns * limit
        self._searches, self._left, self._looks = searches, searches, LOOKS * searches
        self._grips: dict[tuple[Any, ...], GripperMotion] = {}
        self._services: dict[tuple[float, Scene], PlannerService] = {}
        self._solutions: dict[tuple[Any, ...], FloatArray] = {}
        self._grasps: dict[tuple[GraspKinds, Obstacle], tuple[list[FoundGrasps], Iterator[FoundGrasps]]] = {}

    def look(self) -> None:
        """The lines of one more way are looked at.

        Raises:
            Ended: Too many were.
        """
        self._looks -= 1
        if self._looks < 0:
            detail = f"the lines of {LOOKS * self._searches:,} ways were looked at, {LOOKS} for each search"
            raise Ended(Failure(Stage.STRAIGHT_LINE, Reason.PLANNING_FAILED, detail))

    # Worlds.

    def begin(self, service: PlannerService) -> PlannerService:
        """The service in whose world the task begins."""
        return self._services.setdefault((service.robot.gripper_width, service.scene), service)

    def changed(
        self, service: PlannerService, *, gripper: float | None = None, scene: Scene | None = None
    ) -> PlannerService:
        """``service.changed``: in one world one service, however it came about."""
        key = (service.robot.gripper_width if gripper is None else gripper, service.scene if scene is None else scene)
        if key not in self._services:
            self._services[key] = service.changed(gripper=gripper, scene=scene)
        return self._services[key]

    # Inverse kinematics.

    def solutions(self, robot: Robot, pose: Pose, still: FloatArray) -> FloatArray:
        """The configurations (k, n) that bring the tool to a pose, the joints that do not move it as in ``still``."""
        columns = ToolChain.of(robot, robot.home).columns
        key = (pose, np.delete(still, columns).tobytes())
        if key not in self._solutions:
            self._solutions[key] = inverse_kinematics(robot, pose, seed=self.request.seed, still=still)
        return self._solutions[key]

    def grasps(self, kinds: GraspKinds, robot: Robot, target: Obstacle) -> Iterator[FoundGrasps]:
        """``GraspKinds.by_kind``: each kind is looked for once, however often an object stands like this.

        Raises:
            InvalidRequest: The gripper can do none of the kinds.
            Ended: It was cancelled, or no time is left for another kind.
        """
        found, rest = self._grasps.setdefault((kinds, target), ([], kinds.by_kind(robot, target)))
        return self._each(found, rest)

    def _each(self, found: list[FoundGrasps], rest: Iterator[FoundGrasps]) -> Iterator[FoundGrasps]:
        """What is found, and what else will be; several callers may be at different places of the same."""
        for k in count():
            if k == len(found):
                if k > 0:  # a kind may take a second to find
                    self._share_of_time(one_of_many=True)
                    if self._cancel is not None and self._cancel.cancelled:
                        raise Ended(Failure(Stage.SEARCH, Reason.PREEMPTED, "cancelled"))
                following = next(rest, None)
                if following is None:
                    return
                found.append(following)
            yield found[k]

    # Motions.

    def searched(
        self,
        service: PlannerService,
        q: FloatArray,
        goal: Any,
        constraints: Sequence[Constraint] = (),
        *,
        one_of_many: bool = False,
    ) -> PlanResult:
        """The plan from q (n,) to a goal.

        Args:
            one_of_many: Whether there are others if it has none: then it gets half of the time that is left.

        Raises:
            NoMotion: There is none.
            Ended: It was cancelled, or no time or no search is left.
        """
        share = self._share_of_time(one_of_many=one_of_many)
        self._left -= 1
        if self._left < 0:
            detail = f"all {self._searches:,} searches were tried"
            raise Ended(Failure(Stage.SEARCH, Reason.PLANNING_FAILED, detail))
        asked = replace(
            self.request, start=q, goal=goal, time_limit=share, constraints=(*self.request.constraints, *constraints)
        )
        return self._having_plan(service.plan(asked, memory=self.memory, cancel=self._cancel))

    def stands_free(self, service: PlannerService, q: FloatArray, standing: FloatArray) -> bool:
        """Whether motions can begin at q (n,), as far as one state tells; if not, ``leaving`` says why.

        Args:
            standing: q within the limits.
        """
        request = self.request
        if np.abs(q - standing).max() > request.start_tolerance or request.constraints or service.scene.constraints:
            return False
        if keeps_torques(request.timing):
            return False
        return self.counted(service.checker, lambda checker: checker.state_is_free(standing))

    def counted(self, checker: CollisionChecker, ask: Callable[[CollisionChecker], T]) -> T:
        """What a checker answers, its cost counted."""
        tally = checker.ledger.own
        before = tally.counts
        answer = ask(checker)
        self.spent += tally.counts - before
        return answer

    def leaving(self, service: PlannerService, q: FloatArray, standing: FloatArray) -> tuple[PlanResult, bool]:
        """The motion with which a task begins at q (n,), and whether it is one: what stays there if nothing is touched.

        Where the robot touches something by so little that a plan begins with a way out, it is that way.

        Args:
            standing: q within the limits.
        """
        stays = self._counted(service.plan(replace(self.request, start=q, goal=q), cancel=self._cancel))
        if stays.failure is None or stays.failure.reason is not Reason.GOAL_IN_COLLISION:
            return stays, False
        way = service.way_out(standing, padding=self.request.padding)
        if way is None:
            return stays, False
        self.spent += CheckCounts(distances=way.distances)
        asked = replace(self.request, start=q, goal=way.path.waypoints[-1])
        return self._counted(service.plan(asked, cancel=self._cancel)), True

    def followed(
        self,
        service: PlannerService,
        waypoints: FloatArray,
        contacts: Sequence[AllowedStretch] = (),
        constraints: Sequence[Constraint] = (),
        blend: float | None = None,
    ) -> PlanResult:
        """The motion through waypoints (N, n).

        Args:
            blend: Radians at most by which corners are blended; None as wide as the tool stays on a straight line.

        Raises:
            NoMotion: It is not free.
            Ended: It was cancelled.
        """
        if blend is None:
            blends = np.minimum(line_blends(service.robot, waypoints), self.request.blend)
        else:
            blends = np.full(len(waypoints), blend)
        result = service.follow(
            waypoints, contacts=contacts, blends=blends, memory=self.memory, **self._line_settings(constraints)
        )
        return self._having_plan(result)

    def along(self, move: Callable[..., PlanResult], constraints: Sequence[Constraint] = ()) -> PlanResult:
        """The motion of the tool that ``move`` plans with the settings of lines.

        Raises:
            NoMotion: It is not possible as a whole.
            Ended: It was cancelled.
        """
        return self._having_plan(move(**self._line_settings(constraints)))

    def _line_settings(self, constraints: Sequence[Constraint]) -> dict[str, Any]:
        return {
            "pace": Pace.of(self.request, self.law),
            "padding": self.request.padding,
            "constraints": (*self.request.constraints, *constraints),
            "cancel": self._cancel,
        }

    def gripper(
        self, service: PlannerService, q: FloatArray, width: float, touch: Touch | None = None
    ) -> GripperMotion | None:
        """The gripper going from its width to another one; None if it has it already. It is proven once and remembered.

        Raises:
            NoMotion: It is not proven free.
            Ended: It was cancelled.
        """
        now = service.robot.gripper_width
        if width == now:
            return None
        key = (service, q.tobytes(), width)
        if key not in self._grips:
            touching, reason = ((), "") if touch is None else (touch.pairs, touch.reason)
            try:
                motion = service.certify_gripper(q, now, width, touching=touching, reason=reason, cancel=self._cancel)
            except Cancelled as cancelled:
                raise Ended(Failure(Stage.CERTIFY, Reason.PREEMPTED, str(cancelled))) from cancelled
            self._grips[key] = motion
            self.spent += CheckCounts(distances=motion.certificate.distances)
        if self._grips[key].refused:
            raise NoMotion(self._grips[key].refused)
        return self._grips[key]

    def _share_of_time(self, *, one_of_many: bool) -> float | None:
        """Seconds for the next search: those of the request, or half of what is left, so that others get their turn.

        Raises:
            Ended: No time is left.
        """
        limit = self.request.time_limit
        if self._deadline is None or limit is None:
            return None
        left = self._deadline - time.monotonic()
        if left <= 0.0:
            raise Ended(Failure(Stage.SEARCH, Reason.TIMED_OUT, f"the time limit of {limit:g} s passed"))
        return left / 2.0 if one_of_many else min(left, limit)

    def _having_plan(self, result: PlanResult) -> PlanResult:
        """The result itself if it has a plan. Its cost is counted either way, and a cancelled one ends the task."""
        failure = self._counted(result).failure
        if failure is None:
            return result
        raise NoMotion(failure.detail, result)

    def _counted(self, result: PlanResult) -> PlanResult:
        self.spent += result.counts
        if result.failure is not None and result.failure.reason is Reason.PREEMPTED:
            raise Ended(result.failure)
        return result

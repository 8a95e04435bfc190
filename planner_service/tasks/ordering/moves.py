"""Picks and places as visits: the proven ways of each, in a scene that holds whatever was moved before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from types import NoneType

from numpy.typing import ArrayLike

from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest, PlanningFailed
from planner_service.geometry.arrays import BoolArray, set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, items, text, whole
from planner_service.parallel import Engine
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.planning.task_result import Handling, Segment, TaskResult
from planner_service.scene.scene import Obstacle
from planner_service.service import PlannerService
from planner_service.tasks import pick_steps, place_steps, proven_ways
from planner_service.tasks.ordering.order import order
from planner_service.tasks.ordering.result import OrderResult
from planner_service.tasks.ordering.visits import Branch, Visit, require_visits
from planner_service.tasks.steps import GraspSource

__all__ = ["Move", "order_moves"]

MAX_MOVES, MAX_POSES, MAX_WAYS = 200, 16, 64


@dataclass(frozen=True, eq=False)
class Move:
    """An object that is to be picked and placed.

    Attributes:
        object: The name of an obstacle, or an obstacle that is there only when it is its turn, as on a feeder.
        poses: Where it may be set down, in the base frame; each is kept free by all other motions.
        grasps: As of ``tasks.Grasp``.
        handling: How it is taken; its request is not used.
        onto: The obstacle that it stands on afterwards.
        after: Names of objects that must have been placed before.
    """

    object: str | Obstacle
    poses: Sequence[Pose]
    grasps: Sequence[Pose] | GraspSource | None = None
    handling: Handling | None = None
    onto: str | None = None
    after: Sequence[str] = ()

    def __post_init__(self) -> None:
        instance("object", self.object, (str, Obstacle), "the name of an obstacle, or an Obstacle")
        instance("handling", self.handling, (Handling, NoneType), "a Handling, or None")
        if self.onto is not None:
            text("onto", self.onto)
        poses = items("poses", self.poses, Pose, "a list of Pose", MAX_POSES)
        if not poses:
            raise InvalidRequest("poses", self.poses, "at least one Pose")
        set_fields(self, poses=poses, after=items("after", self.after, str, "names of objects"))

    @property
    def name(self) -> str:
        """Of the object."""
        return self.object if isinstance(self.object, str) else self.object.name


def order_moves(
    service: PlannerService,
    moves: Sequence[Move],
    request: PlanRequest,
    *,
    end: ArrayLike | None = None,
    gap: float = 0.05,
    plans: int = 3000,
    grasps: int = 8,
    places: int = 2,
    engine: Engine | None = None,
    cancel: CancelToken | None = None,
) -> OrderResult:
    """The order of picks and places, with their grasps and branches, that takes least time, as ``order`` has it of
    visits.

    The visits are called "pick NAME" and "place NAME". A motion must be free whatever was moved before. So it is
    planned in a scene that has every object both where it is and in each of its places, but for the one that is
    moved, for those that must have been placed before, which are no longer where they were, and for those that must
    be placed afterwards, which are not in their places yet. What is proven there holds in the scene as it is when the
    motion is made, which is the one that the result has.

    Args:
        service: With the objects in its scene, but those that arrive in their turn.
        moves: What is to be moved.
        request: Its start is where the arm starts. Its settings are those of all motions.
        grasps: Proven ways of each pick that are considered, at most.
        places: The same of each place after each of these.
        end: As for ``order``; so are the others.

    Raises:
        InvalidRequest: A value is of the wrong kind or out of its range, or an object is named twice.
        UnknownName: There is no such obstacle.
        PlanningFailed: An object has no proven way of being picked and placed; it is named.
        Cancelled: by ``cancel``.
    """
    instance("service", service, PlannerService, "a PlannerService")
    instance("request", request, PlanRequest, "a PlanRequest")
    given = items("moves", moves, Move, "a list of Move", MAX_MOVES)
    grasps, places = whole("grasps", grasps, 1, MAX_WAYS), whole("places", places, 1, MAX_WAYS)
    names = [move.name for move in given]
    if len(set(names)) != len(names) or not names:
        raise InvalidRequest("moves", names, "at least one, each object once")
    everywhere = service.scene
    for move in given:
        shape = _obstacle(service, move).shape
        for k, pose in enumerate(move.poses):
            everywhere = everywhere.with_obstacle(Obstacle(_there(move, k), shape, pose))
    full = service.changed(scene=everywhere)
    _, waiting = require_visits([Visit(move.name, [request.start], after=move.after) for move in given])
    ways = _Ways(full, given, waiting, request, grasps, places, cancel)
    visits = [ways.visit(k) for k in range(len(given))]
    found = order(full, visits, request, end=end, gap=gap, plans=plans, engine=engine, cancel=cancel)
    return replace(found, task=_as_it_is(found.task, service, given)) if found.ok else found


def _as_it_is(task: TaskResult, service: PlannerService, moves: Sequence[Move]) -> TaskResult:
    """Motions with the scenes in which they are made, each of which has no more in it than the one it was proven in."""
    arriving = {move.name: move.object for move in moves if not isinstance(move.object, str)}
    scene, world, segments = service.scene, service.world, list[Segment]()
    for segment in task.segments:
        here = segment.world_after(world)
        names = {held.name for held in here.scene.attached}
        for name in names - {held.name for held in scene.attached}:  # it has been taken
            scene = scene.without(name) if name in scene.names else scene
            scene = scene.with_attached(next(held for held in here.scene.attached if held.name == name))
        for held in scene.attached:
            if held.name not in names:  # it has been left
                scene = scene.without_attached(held.name).with_obstacle(here.scene.obstacle(held.name))
        for name, obstacle in arriving.items():
            if name in here.scene.names and name not in scene.names:
                scene = scene.with_obstacle(obstacle)
        world = replace(here, scene=scene)
        origin = segment.result.origin
        result = segment.result if origin is None else replace(segment.result, origin=replace(origin, world=world))
        segments.append(replace(segment, result=result, scene=scene))
    return replace(task, segments=tuple(segments), world=world)


def _obstacle(service: PlannerService, move: Move) -> Obstacle:
    return service.scene.obstacle(move.object) if isinstance(move.object, str) else move.object


def _there(move: Move, k: int) -> str:
    """The name of an object in its k-th place."""
    return f"{move.name}, place {k + 1}"


@dataclass(frozen=True, eq=False)
class _Ways:
    """How moves become visits, in a scene with every object in all its places."""

    service: PlannerService
    moves: tuple[Move, ...]
    before: BoolArray
    request: PlanRequest
    grasps: int
    places: int
    cancel: CancelToken | None

    def around(self, number: int) -> PlannerService:
        """What plans a move: its scene has whatever may be there by then."""
        scene = self.service.scene
        for k, move in enumerate(self.moves):
            if self.before[k, number] and isinstance(move.object, str):
                scene = scene.without(move.object)
            if self.before[number, k] or k == number:
                for place in range(len(move.poses)):
                    scene = scene.without(_there(move, place))
        own = self.moves[number].object
        return self.service.changed(scene=scene if isinstance(own, str) else scene.with_obstacle(own))

    def visit(self, number: int) -> Visit:
        """A pick, and the place that must follow it."""
        picks, placed = list[Branch](), list[Branch]()
        move, here = self.moves[number], self.around(number)
        handling, start = move.handling or Handling(), self.request.start
        taking = pick_steps(move.name, move.grasps, handling)
        setting = place_steps(move.name, move.poses, replace(handling, support=move.onto, upright=None))
        found = proven_ways(
            here, taking, start, request=self.request, line_timing=handling.line_timing, cancel=self.cancel
        )
        for pick in found:
            ways = proven_ways(
                pick.after,
                setting,
                pick.q_out,
                request=self.request,
                line_timing=handling.line_timing,
                cancel=self.cancel,
            )
            some = [
                Branch(
                    way.q_in,
                    way.q_out,
                    way.segments,
                    pick.after,
                    self.service.changed(gripper=way.after.robot.gripper_width if way.after.robot.gripper else None),
                )
                for way in islice(ways, self.places)
            ]
            if some:
                picks.append(Branch(pick.q_in, pick.q_out, pick.segments, pick.before, pick.after))
                placed += some
            if len(picks) == self.grasps:
                break
        if not picks:
            detail = f"{move.name}: no way of picking it has one of placing it, with proven lines"
            raise PlanningFailed(Failure(Stage.ENDPOINTS, Reason.PLANNING_FAILED, detail))
        after = [f"place {name}" for name in move.after]
        return Visit(f"pick {move.name}", picks, Visit(f"place {move.name}", placed), after)

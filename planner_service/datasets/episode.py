"""One episode, from its index to plain data: the work of a worker."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

import numpy as np

from planner_service.collision import CheckCounts
from planner_service.constraints.values import constraint_names
from planner_service.datasets.frames import EpisodeMotion, Frames, frames, timeline
from planner_service.datasets.parquet import TABLES, Rows
from planner_service.datasets.task import EpisodeTask, EpisodeWorld, RandomDraws
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Sphere
from planner_service.geometry.validation import instance, number, whole
from planner_service.parallel import Lost
from planner_service.path.joint_path import JointPath
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Reason
from planner_service.planning.task_result import Segment, TaskResult
from planner_service.records.result import certificate_record
from planner_service.robot.model import JointLimits, Robot
from planner_service.scene.scene import Obstacle
from planner_service.service import PlannerService

__all__ = ["Episode", "EpisodeWork", "Layout", "as_layout", "counter_stats", "lost_episode"]

Layout = Literal["v3.0", "v2.1"]

PARTS = (1, 10, 50, 90, 99)
"""Percentiles in the statistics, by which some policies normalise."""


def as_layout(value: object) -> Layout:
    """The layout of that name.

    Raises:
        InvalidRequest: there is none.
    """
    for layout in get_args(Layout):
        if isinstance(value, str) and value == layout:
            return cast(Layout, layout)
    raise InvalidRequest("layout", value, " or ".join(f'"{layout}"' for layout in get_args(Layout)))


@dataclass(frozen=True, eq=False)
class Episode:
    """The result of one request.

    Attributes:
        rows: Rows of the tables, without the values that depend on earlier episodes.
        columns: float32 arrays (m, k) of the m frames, by feature; None if there is no episode.
    """

    rows: Rows
    columns: Mapping[str, Any] | None


@dataclass(frozen=True, eq=False)
class EpisodeWork:
    """Makes the episode of an index; sent to each worker once.

    Attributes:
        robot: The robot, with a gripper that has fingers.
        task: The task to show.
        seed: Seed of the data set.
        fps: Frames per second.
        gripper_speed: Speed of the gripper's opening in m/s.
        max_checks: States that each plan may check.
        chunk: Requests per file of a table, and per file of frames; in layout "v2.1", episodes per folder.
        layout: LeRobot's version: "v3.0", which it reads since 0.4, or "v2.1", with a file per episode.

    Raises:
        InvalidRequest: the robot has no gripper, or one that sucks: no frame would say when it does; a number is out
            of range, or no such layout.
    """

    robot: Robot
    task: EpisodeTask
    seed: int = 0
    fps: int = 30
    gripper_speed: float = 0.05
    max_checks: int = 50_000
    chunk: int = 1000
    layout: Layout = "v3.0"

    def __post_init__(self) -> None:
        gripper = instance("robot", self.robot, Robot, "a Robot").gripper
        if gripper is None or gripper.kind == "vacuum":
            raise InvalidRequest("robot", self.robot.name, "a robot with a gripper that has fingers")
        for name, most in (("seed", 2**63 - 1), ("fps", 1000), ("max_checks", 10**9), ("chunk", 10_000)):
            whole(name, getattr(self, name), 0 if name == "seed" else 1, most)
        number("gripper_speed", self.gripper_speed, "metres per second in [0.001, 10]", 0.001, 10.0)
        as_layout(self.layout)

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """The columns of the frames, in LeRobot's form."""
        robot = [*self.robot.joint_names, "gripper_width"]
        names: dict[str, list[str] | None] = {
            "observation.state": robot,
            "observation.environment_state": [f"target_{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
            + [f"onto_{part}" for part in "xyz"],
            "action": robot,
            "timestamp": None,
            **dict.fromkeys(("frame_index", "episode_index", "index", "task_index")),
        }
        return {
            name: {
                "dtype": "int64" if name.endswith("index") else "float32",
                "shape": [1 if parts is None else len(parts)],
                "names": parts,
            }
            for name, parts in names.items()
        }

    def prepare(self) -> None:
        """Load the libraries for timing, so that the first plan does not have to."""
        limits = self.robot.limits
        path = JointPath(np.array([limits.lower, limits.upper]))
        PlanRequest(limits.lower, limits.upper).timing.time_path(path, limits)

    def __call__(self, item: int) -> Episode:
        """The episode of that index, or the failure; independent of any clock."""
        index, draws = item, RandomDraws(self.seed, item)
        planner_seed = draws.whole()
        drawn = self.task.draw(self.robot, draws)
        service = PlannerService(self.robot, drawn.scene)
        request = PlanRequest(drawn.start, drawn.start, seed=planner_seed, max_checks=self.max_checks, time_limit=None)
        solved = self.task.solve(service, drawn, request)
        _require_unconstrained(solved)
        rows = _rows(index, drawn, solved)
        request_row = rows["requests"][0] | {"planner_seed": planner_seed}
        if solved.failure is not None:
            failure: dict[str, Any] = {"stage": solved.failure.stage.value, "reason": solved.failure.reason.value}
            failure |= {"detail": solved.failure.detail, "motions_planned": len(solved.segments)}
            rows["failures"] = [{"request_index": index, **failure}]
            return Episode(rows | {"requests": [request_row]}, None)
        motions = timeline(solved.segments, self.task.carrying, self.gripper_speed)
        sampled = frames(self.robot, motions, drawn.scene.obstacle(drawn.target), self.fps)
        onto = drawn.scene.obstacle(drawn.onto).pose.position
        columns = _columns(sampled, onto, self.fps, self.robot.limits)
        rows["motions"] = [
            _motion_row(index, k, motion) | {"certified": row["certified"]}
            for k, (motion, row) in enumerate(zip(motions, rows["certificates"], strict=True))
        ]
        stats = {name: _stats(values) for name, values in columns.items()}
        rows["episodes"] = [{"request_index": index, "length": len(sampled.q), "stats": stats}]
        request_row |= {
            "ok": True,
            "frames": len(sampled.q),
            "motion_s": math.fsum(motion.trajectory.duration for motion in motions),
        }
        return Episode(rows | {"requests": [request_row]}, columns)


def _require_unconstrained(solved: TaskResult) -> None:
    """Refuse motions that keep constraints: a data set has no place for these."""
    asked = () if solved.request is None else solved.request.constraints
    names = constraint_names([*asked, *(kept for segment in solved.segments for kept in segment.result.constraints)])
    if names:
        raise InvalidRequest("task", f"a motion with constraints ({names})", "none: data sets do not store them")


def lost_episode(index: int, answer: Lost) -> Episode:
    """The failure of a request whose workers died or took too long."""
    reason = Reason.TIMED_OUT if answer.over_limit else Reason.WORKER_LOST
    nothing = CheckCounts().named
    request = {"request_index": index, "ok": False, "frames": 0, "motion_s": 0.0, **nothing}
    failure = {"request_index": index, "reason": reason.value, "detail": answer.detail}
    return Episode({**{name: [] for name in TABLES}, "requests": [request], "failures": [failure]}, None)


def counter_stats(first: int, length: int) -> dict[str, list[float]]:
    """LeRobot's statistics of a column that counts up."""
    last = first + length - 1
    spread = math.sqrt((length * length - 1) / 12.0)
    return {"min": [first], "max": [last], "mean": [(first + last) / 2.0], "std": [spread], "count": [length]}


def _columns(frames: Frames, onto: Sequence[float], fps: int, limits: JointLimits) -> dict[str, Any]:
    """The features that do not depend on earlier episodes; the action of a frame is the state of the next one.

    A joint at a limit is rounded inwards.
    """
    q, low, high = (values.astype(np.float32) for values in (frames.q, limits.lower, limits.upper))
    low = np.where(low < limits.lower, np.nextafter(low, np.float32(np.inf)), low)
    high = np.where(high > limits.upper, np.nextafter(high, np.float32(-np.inf)), high)
    state = np.concatenate([np.clip(q, low, high), frames.width[:, None].astype(np.float32)], axis=1)
    return {
        "observation.state": state,
        "observation.environment_state": np.concatenate(
            [frames.target, np.tile(onto, (len(state), 1))], axis=1, dtype=np.float32
        ),
        "action": np.concatenate([state[1:], state[-1:]]),
        "timestamp": (np.arange(len(state)) / fps).astype(np.float32)[:, None],
    }


def _stats(values: Any) -> dict[str, list[float]]:
    """LeRobot's statistics of a feature (m, k), from exactly rounded sums."""
    columns: list[list[float]] = values.astype(np.float64).T.tolist()
    means = [math.fsum(column) / len(column) for column in columns]
    spreads = [
        math.sqrt(math.fsum((v - mean) * (v - mean) for v in column) / len(column))
        for column, mean in zip(columns, means, strict=True)
    ]
    lowest, highest = [min(column) for column in columns], [max(column) for column in columns]
    quantiles = np.percentile(values.astype(np.float64), PARTS, axis=0).tolist()
    stats = {"min": lowest, "max": highest, "mean": means, "std": spreads, "count": [float(len(values))]}
    return stats | {f"q{part:02d}": row for part, row in zip(PARTS, quantiles, strict=True)}


def _rows(index: int, drawn: EpisodeWorld, solved: TaskResult) -> Rows:
    counts = solved.counts.named
    request = {
        "request_index": index,
        "ok": False,
        "frames": 0,
        "motion_s": 0.0,
        "scene_hash": drawn.scene.hash,
        "target": drawn.target,
        "onto": drawn.onto,
        "start": drawn.start.tolist(),
        **counts,
        "notes": list(solved.notes),
    }
    numbered = list(enumerate(solved.segments))
    return {
        "requests": [request],
        "scenes": [_obstacle_row(index, k, obstacle) for k, obstacle in enumerate(drawn.scene.obstacles)],
        "counts": [row for k, segment in numbered for row in _count_rows(index, k, segment)]
        + [_count_row(index, -1, "choosing", None, solved.choosing.named)],
        "certificates": [row for k, segment in numbered for row in _certificate_rows(index, k, segment)],
        "failures": [],
        "motions": [],
        "episodes": [],
    }


def _obstacle_row(index: int, position: int, obstacle: Obstacle) -> dict[str, Any]:
    shape = obstacle.shape
    if not isinstance(shape, Box | Sphere | Cylinder | Capsule):
        raise InvalidRequest("scene", type(shape).__name__, "boxes, spheres, cylinders and capsules")
    sizes = shape.size if isinstance(shape, Box) else tuple(vars(shape).values())
    return {
        "request_index": index,
        "position_in_scene": position,
        "name": obstacle.name,
        "shape": type(shape).__name__.lower(),
        "sizes": list(sizes),
        "position": list(obstacle.pose.position),
        "quaternion_wxyz": list(obstacle.pose.quaternion),
    }


def _count_rows(index: int, k: int, segment: Segment) -> Iterator[dict[str, Any]]:
    if segment.gripper is not None:
        counts = (segment.counts - segment.result.counts).named
        yield _count_row(index, k, segment.name, "gripper", counts)
    for report in segment.result.stages:
        yield _count_row(index, k, segment.name, report.stage.value, report.counts.named)


def _count_row(index: int, k: int, motion: str, stage: str | None, counts: Mapping[str, int]) -> dict[str, Any]:
    return {"request_index": index, "motion_index": k, "motion": motion, "stage": stage, **counts}


def _certificate_rows(index: int, k: int, segment: Segment) -> Iterator[dict[str, Any]]:
    certificate = segment.result.certificate
    if segment.result.ok and (certificate is None or not certificate.certified):
        raise BrokenInvariant(f"request {index}: {segment.name} has a plan and no proof")
    if certificate is not None:
        record = certificate_record(certificate)
        exempt = [
            {**{key: item[key] for key in ("s_start", "s_end", "reason")}, "a": a, "b": b}
            for item in record["exempt"]
            for a, b in item["pairs"]
        ]
        kept = {key: record[key] for key in ("certified", "clearance", "distances", "padding")}
        yield {"request_index": index, "motion_index": k, "motion": segment.name, **kept, "exempt": exempt}


def _motion_row(index: int, k: int, part: EpisodeMotion) -> dict[str, Any]:
    path, trajectory = part.trajectory.path, part.trajectory
    return {
        "request_index": index,
        "motion_index": k,
        "motion": part.name,
        "carrying": part.carrying,
        "begins_s": part.begins,
        "duration_s": trajectory.duration,
        "settle_s": part.settle,
        "gripping_s": part.gripping,
        "gripper_width": part.width,
        "waypoints": path.waypoints.tolist(),
        "blends": path.blends.tolist(),
        "dilation": trajectory.dilation,
        "durations": trajectory.durations.tolist(),
        "coefficients": trajectory.coefficients.tolist(),
    }

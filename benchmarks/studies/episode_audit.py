"""What a checker that is not ours says of a data set of episodes, read off its files and nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.harness.audit import Auditor, Pair, along, inside, stretches
from planner_service.geometry.arrays import FloatArray

__all__ = ["Audit", "EpisodeAudit", "Stored"]

ROUNDING = 2.0**-22
"""By how much a float32 of a few radians may be off."""

SHAPES: dict[str, Any] = {
    "box": lambda *sizes: ps.Box(sizes),
    "sphere": ps.Sphere,
    "cylinder": ps.Cylinder,
    "capsule": ps.Capsule,
}

Pairs = tuple[Pair, ...]
Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Stored:
    """One episode as it is in the files.

    Args:
        folder: Of the data set.
        episode: Its number.
    """

    folder: Path
    episode: int

    @cached_property
    def request(self) -> Row:
        """Its row in the table of requests."""
        return self._rows("requests", "episode_index", self.episode)[0]

    @cached_property
    def scene(self) -> ps.Scene:
        """The world at the beginning."""
        rows = self._rows("scenes", "request_index", self.request["request_index"])
        return ps.Scene(
            tuple(
                ps.Obstacle(row["name"], SHAPES[row["shape"]](*row["sizes"]), _pose(row))
                for row in sorted(rows, key=lambda row: int(row["position_in_scene"]))
            )
        )

    @cached_property
    def motions(self) -> list[Row]:
        """Its rows in the table of motions, in order."""
        return self._rows("motions", "episode_index", self.episode)

    @cached_property
    def certificates(self) -> list[Row]:
        """The rows of its motions in the table of certificates, in order."""
        return self._rows("certificates", "request_index", self.request["request_index"])

    @cached_property
    def frames(self) -> dict[str, FloatArray]:
        """Its columns: state, action and object as float64 (m, k), timestamps (m,)."""
        import pyarrow.parquet as pq

        table = pq.read_table(self.folder / "data", filters=[("episode_index", "==", self.episode)])
        kept = ("observation.state", "action", "observation.environment_state", "timestamp")
        return {name: np.array(table[name].to_pylist(), dtype=np.float64) for name in kept}

    def _rows(self, table: str, column: str, value: int) -> list[Row]:
        import pyarrow.parquet as pq

        found: list[Row] = pq.read_table(self.folder / "tables" / table, filters=[(column, "==", value)]).to_pylist()
        return found


@dataclass(eq=False)
class Audit:
    """What was found: how much was judged, and every objection in words."""

    configurations: int = 0
    frames: int = 0
    proven: int = 0
    objections: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class EpisodeAudit:
    """Judges episodes by their number: the exact curves every 0.01 rad, and every frame.

    Contact is allowed where the certificate of a motion says that it is meant, and between fingers and object while
    the gripper closes or opens.

    Args:
        folder: Of the data set.
        robot: The name of the robot.
    """

    folder: str
    robot: str

    def prepare(self) -> None:
        """Nothing: each episode has a world of its own."""

    def __call__(self, item: int) -> Audit:
        """The audit of that episode."""
        return _Judge(Stored(Path(self.folder), item), self.robot).audit()


class _Judge:
    def __init__(self, stored: Stored, robot: str) -> None:
        self._stored, self._robot = stored, robot
        self._found = Audit()
        self._target = stored.request["target"]

    def audit(self) -> Audit:
        stored, found = self._stored, self._found
        if stored.scene.hash != stored.request["scene_hash"]:
            found.objections.append("the scene is not the one that was planned in")
        if [row["certified"] for row in stored.certificates] != [True] * len(stored.motions):
            found.objections.append("a motion is not certified")
        found.frames = len(stored.frames["timestamp"])
        state, action = stored.frames["observation.state"], stored.frames["action"]
        if not np.array_equal(action, np.concatenate([state[1:], state[-1:]])):
            found.objections.append("an action is not the next state")
        scene, judged = stored.scene, 0
        for row, proof in zip(stored.motions, stored.certificates, strict=True):
            found.proven += proof["certified"]
            trajectory = _trajectory(row)
            before = scene
            if row["carrying"] and not scene.attached:
                before = self._taken(scene, trajectory(0.0))
            self._curve(row, proof["exempt"], trajectory, before)
            scene = before
            if row["carrying"] and row["gripping_s"] > 0.0:
                scene = self._left(before, trajectory(trajectory.duration))
            judged += self._frames(row, proof["exempt"], trajectory, (before, scene))
        if judged != found.frames:
            found.objections.append(f"{found.frames - judged} frames belong to no motion")
        return found

    def _curve(self, row: Row, exempt: Sequence[Row], trajectory: ps.Trajectory, scene: ps.Scene) -> None:
        """The exact curve, pairs being allowed to touch where that is meant."""
        path = trajectory.path
        for start, end, pairs in _stretches(exempt, path.length):
            Q = along(path, *inside(start, end, path.length))
            self._ask(f"{row['motion']}, s = {start:.3g} to {end:.3g}", Q, scene, (row["gripper_width"], pairs))

    def _frames(
        self, row: Row, exempt: Sequence[Row], trajectory: ps.Trajectory, scenes: tuple[ps.Scene, ps.Scene]
    ) -> int:
        """All frames from the beginning of a motion to that of the next; how many there are."""
        frames, name = self._stored.frames, row["motion"]
        times = np.arange(len(frames["timestamp"])) / round(1.0 / frames["timestamp"][1])
        after = [other["begins_s"] for other in self._stored.motions if other["begins_s"] > row["begins_s"]]
        mine = np.flatnonzero((times >= row["begins_s"]) & (times < min(after, default=np.inf)))
        since = times[mine] - row["begins_s"]
        state = frames["observation.state"][mine]
        exact = trajectory(np.minimum(since, trajectory.duration))
        if np.abs(state[:, :-1] - exact).max(initial=0.0) > ROUNDING:
            self._found.objections.append(f"{name}: a frame is not on the curve")
        s = trajectory.s(np.minimum(since, trajectory.duration))
        moving = since <= trajectory.duration + row["settle_s"]
        for start, end, pairs in _stretches(exempt, trajectory.path.length):
            last = end if end < trajectory.path.length else np.inf
            Q = state[moving & (s >= start) & (s < last), :-1]
            self._ask(f"frames of {name}", Q, scenes[0], (row["gripper_width"], pairs))
        fingers = tuple((finger, self._target) for finger in ("finger_left", "finger_right"))
        for one in state[~moving]:
            self._ask(f"gripper after {name}", one[None, :-1], scenes[1], (float(one[-1]), fingers))
        return len(mine)

    def _ask(self, what: str, Q: FloatArray, scene: ps.Scene, gripper: tuple[float, Pairs]) -> None:
        width, pairs = gripper
        if len(Q) == 0:
            return
        told = Auditor(self._robot, scene, gripper_width=width, allowed=pairs).judge(Q)
        self._found.configurations += len(Q)
        if told["verdict"] != "free":
            self._found.objections.append(f"{what}: {told['verdict']}, {told['pair']}, {told['depth']} m deep")

    def _taken(self, scene: ps.Scene, q: FloatArray) -> ps.Scene:
        """The world once the object moves with the tool."""
        target = scene.obstacle(self._target)
        tool = ps.Pose.from_matrix(Auditor(self._robot, scene).tool_pose(q))
        held = ps.Attached(target.name, target.shape, tool.inverse() @ target.pose, ("finger_left", "finger_right"))
        return scene.without(target.name).with_attached(held)

    def _left(self, scene: ps.Scene, q: FloatArray) -> ps.Scene:
        """The world once the object stands where it was brought to."""
        (held,) = scene.attached
        tool = ps.Pose.from_matrix(Auditor(self._robot, scene).tool_pose(q))
        there = ps.Obstacle(held.name, held.shape, tool @ held.pose)
        return scene.without_attached(held.name).with_obstacle(there)


def _trajectory(row: Row) -> ps.Trajectory:
    path = ps.JointPath(np.array(row["waypoints"]), np.array(row["blends"]))
    return ps.Trajectory(path, np.array(row["durations"]), np.array(row["coefficients"]), row["dilation"])


def _stretches(exempt: Sequence[Row], length: float) -> Iterator[tuple[float, float, Pairs]]:
    return stretches(((each["s_start"], each["s_end"], [(each["a"], each["b"])]) for each in exempt), length)


def _pose(row: Row) -> ps.Pose:
    (x, y, z), (w, i, j, k) = row["position"], row["quaternion_wxyz"]
    return ps.Pose((x, y, z), (w, i, j, k))

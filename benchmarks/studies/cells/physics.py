"""Motions carried out in MuJoCo by position control, faster than real time: what touched, and where things ended up.

Every shape that is planned with is in the model, the robot's included. A thing that is taken lies loose; it is welded
to the hand from when both fingers press on it, or the cup is on it and switched on, until they open and let go.
"""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import planner_service as ps
from benchmarks.studies.cells.arm_model import arm_text
from planner_service.execute.mjcf import MARK, link_of, mjcf_text
from planner_service.execute.simulator import arm_file
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.task_result import Segment
from planner_service.scene.names import Names

__all__ = ["Physics"]

RATE = 250.0
"""Commands a second."""

GRIP, SETTLE, REST = 0.5, 0.4, 0.3
"""Seconds that a gripper takes, that an arm may take to come to rest, and that a thing takes to fall on its support."""

SQUEEZE = 0.01
"""Metres by which fingers try to close beyond the width of what they take."""

SUCTION = 0.003
"""Metres that a cup may be away from what it takes."""

STIFF = (0.004, 1.0), (0.99, 0.9999, 1e-4)
"""How a weld gives way, in MuJoCo's terms (solref, solimp): by next to nothing."""

Pair = frozenset[str]


@dataclass
class Outcome:
    """What a run came to.

    Attributes:
        unexpected: Contacts that were not meant, by pair: how many steps, and the deepest in metres.
        off: Radians by which a joint was off its command's time, at most.
        lost: Things that were not taken although they were to be.
    """

    unexpected: Counter[str] = field(default_factory=Counter)
    deepest: float = 0.0
    off: float = 0.0
    lost: list[str] = field(default_factory=list)


class Physics:
    """A robot that stands at ``q`` among the obstacles of a scene, of which some lie loose.

    Args:
        still: Whether no time passes before anything is asked for; else what lies loose falls on its support first.
    """

    def __init__(
        self, robot: ps.Robot, scene: ps.Scene, q: FloatArray, loose: Iterable[str], *, still: bool = False
    ) -> None:
        self.robot, self.loose = robot, tuple(loose)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "arm.xml"
            file.write_text(arm_file().read_text("utf-8") if robot.name == "wxai" else arm_text(robot), "utf-8")
            text = mjcf_text(file, robot, scene, loose=self.loose)
        self.model = model = mujoco.MjModel.from_xml_string(text)
        self.data = data = mujoco.MjData(model)
        self._step = max(1, round(1.0 / (RATE * model.opt.timestep)))
        gripper = robot.gripper
        assert gripper is not None
        self._gripper = gripper
        self._arm = [self._actuator(name) for name in robot.joint_names]
        self._fingers = [act for name in gripper.joints for act in self._actuators(name)]
        self._at = [model.jnt_qposadr[model.joint(name).id] for name in robot.joint_names]
        for name, value in zip(robot.joint_names, q.tolist(), strict=True):
            data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
        for name in gripper.joints:
            data.qpos[model.jnt_qposadr[model.joint(name).id]] = robot.gripper_width / 2.0
        self._lag = np.array([model.actuator_biasprm[k, 2] / model.actuator_biasprm[k, 1] for k in self._arm])
        names = Names(robot, scene)
        self._links = {names.link(link) for link in robot.links}
        self._finger_names = [names.link(link) for link in gripper.links]
        self._label = {name: names.object(name) for name in self.loose}
        self._owners = [link_of(model.geom(k).name or "") for k in range(model.ngeom)]
        self._held: set[str] = set()
        self._opening = False
        self._command(q, np.zeros_like(q))
        self._width(robot.gripper_width)
        mujoco.mj_forward(model, data)
        self.outcome = Outcome()
        self._run(0.0 if still else REST, frozenset())

    def positions(self) -> FloatArray:
        """Where the arm's joints are, shape (n,)."""
        return np.array(self.data.qpos[self._at])

    def poses(self) -> dict[str, ps.Pose]:
        """Where loose things are now."""
        out = {}
        for name in self.loose:
            at = self.model.jnt_qposadr[self.model.joint(name + MARK).id]
            x, y, z, w, i, j, k = self.data.qpos[at : at + 7].tolist()
            out[name] = ps.Pose((x, y, z), (w, i, j, k))
        return out

    def run(self, segments: Sequence[Segment]) -> Outcome:
        """Carry out motions, one after another, and rest."""
        before = frozenset[Pair]()
        carried = frozenset[str]()
        for segment in segments:
            scene = segment.scene
            held = carried if scene is None else frozenset(each.name for each in scene.attached)
            may = _meant(segment)
            if self._gripper.kind == "vacuum":
                for name in held - carried:
                    self._suck(name)
                for name in carried - held:
                    self._let_go(name)
            elif segment.gripper is not None:
                closing = held - carried
                self._close(segment.gripper.start, segment.gripper.end - (SQUEEZE if closing else 0.0), before | may)
            self.outcome.lost += [name for name in held - self._held if name not in self.outcome.lost]
            self._move(segment, before | may)
            carried, before = held, may
        self._run(REST, before)
        return self.outcome

    def _actuators(self, joint: str) -> list[int]:
        number = self.model.joint(joint).id
        return [k for k in range(self.model.nu) if self.model.actuator_trnid[k, 0] == number]

    def _actuator(self, joint: str) -> int:
        return self._actuators(joint)[0]

    def _command(self, q: FloatArray, qd: FloatArray) -> None:
        self.data.ctrl[self._arm] = q + getattr(self, "_lag", 0.0) * qd

    def _width(self, width: float) -> None:
        self.data.ctrl[self._fingers] = max(0.0, width / 2.0)

    def _close(self, start: float, end: float, may: frozenset[Pair]) -> None:
        self._opening = end > start
        count = round(GRIP * RATE)
        for k in range(1, count + 1):
            self._width(start + (end - start) * k / count)
            self._steps(may)
        self._run(0.1, may)

    def _move(self, segment: Segment, may: frozenset[Pair]) -> None:
        trajectory = segment.result.trajectory
        if trajectory is None or trajectory.duration == 0.0:
            return
        count = math.ceil(trajectory.duration * RATE)
        times = np.minimum(np.arange(count + 1) / RATE, trajectory.duration)
        Q = trajectory(times)
        QD = np.gradient(Q, 1.0 / RATE, axis=0) if count else np.zeros_like(Q)
        for q, qd in zip(Q, QD, strict=True):
            self._command(q, qd)
            self._steps(may)
            off = float(np.abs(self.data.qpos[self._at] - q).max())
            self.outcome.off = max(self.outcome.off, off)
        self._command(Q[-1], np.zeros_like(Q[-1]))
        self._run(SETTLE, may)

    def _run(self, seconds: float, may: frozenset[Pair]) -> None:
        for _ in range(round(seconds * RATE)):
            self._steps(may)

    def _steps(self, may: frozenset[Pair]) -> None:
        for _ in range(self._step):
            mujoco.mj_step(self.model, self.data)
            if self._gripper.kind != "vacuum":
                self._pressed()
        self._judge(may)

    def _touching(self) -> Iterable[tuple[str, str, float]]:
        contacts = self.data.contact
        for (a, b), distance in zip(
            contacts.geom[: self.data.ncon].tolist(), contacts.dist[: self.data.ncon].tolist(), strict=True
        ):
            yield self._owners[a], self._owners[b], distance

    def _judge(self, may: frozenset[Pair]) -> None:
        """Contacts of the robot, or of what it holds, with anything that they are not meant to touch now."""
        moving = self._links | {self._label[name] for name in self._held}
        for a, b, distance in self._touching():
            if distance < 0.0 and (a in moving or b in moving) and frozenset((a, b)) not in may:
                self.outcome.unexpected[f"{a} x {b}"] += 1
                self.outcome.deepest = max(self.outcome.deepest, -distance)

    def _pressed(self) -> None:
        pressing: dict[str, set[str]] = {}
        for a, b, _ in self._touching():
            for finger, other in ((a, b), (b, a)):
                if finger in self._finger_names:
                    pressing.setdefault(other, set()).add(finger)
        for name in self.loose:
            fingers = pressing.get(self._label[name], set())
            if self._opening and not fingers and name in self._held:
                self._let_go(name)
            elif not self._opening and len(fingers) == len(self._finger_names) and name not in self._held:
                self._weld(name)

    def _suck(self, name: str) -> None:
        body = self.model.body(name + MARK).id
        mine = [k for k in range(self.model.ngeom) if self.model.geom_bodyid[k] == body]
        cups = [k for k, owner in enumerate(self._owners) if owner in self._finger_names]
        gap = min(
            mujoco.mj_geomDistance(self.model, self.data, cup, k, 0.05, np.zeros(6)) for cup in cups for k in mine
        )
        if gap <= SUCTION:
            self._weld(name)

    def _weld(self, name: str) -> None:
        model, data = self.model, self.data
        weld, body = model.equality(name + MARK).id, model.body(name + MARK).id
        hand = model.eq_obj1id[weld]
        model.eq_solref[weld], model.eq_solimp[weld, :3] = STIFF
        pose = model.eq_data[weld]
        back = data.xquat[hand] * (1.0, -1.0, -1.0, -1.0)
        pose[:3] = 0.0
        pose[3:6] = data.xmat[hand].reshape(3, 3).T @ (data.xpos[body] - data.xpos[hand])
        mujoco.mju_mulQuat(pose[6:10], back, data.xquat[body])
        data.eq_active[weld] = 1
        self._held.add(name)

    def _let_go(self, name: str) -> None:
        self.data.eq_active[self.model.equality(name + MARK).id] = 0
        self._held.discard(name)


def _meant(segment: Segment) -> frozenset[Pair]:
    """Pairs that may touch during a motion: on some stretch of it, and what is carried with what holds it."""
    pairs = {frozenset(pair) for each in segment.result.exempt for pair in each.pairs}
    held: Any = () if segment.scene is None else segment.scene.attached
    pairs |= {frozenset((each.name, link)) for each in held for link in each.touch_links}
    return frozenset(pairs)

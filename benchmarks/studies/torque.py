"""Plans with payload under torque limits, judged by Pinocchio on the model that it reads itself from the URDF.

Starts and goals are random and free of collisions, in front of a table. Each joint's torque is computed every
millisecond of each plan. What a joint cannot hold at an end has to be refused, and nothing else; what no plan comes of
on the way is counted. Each query is planned without torque limits, too: how much faster, and how far above the limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, grouped, p50, p95, table_of
from planner_service import PlannerService, PlanRequest, Reason, Robot, Stage, ToppRa, Trajectory
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.inertia import Payload, symmetric
from planner_service.robot.package_files import EXAMPLES, example_urdf
from planner_service.robot.toml_reader import read_robot_file
from planner_service.timing.torque_limits import BETWEEN, EXCESS

__all__ = ["LOADS", "PLANS", "Judge", "run"]

PLANS = 200

LOADS = {"ur5": 5.0, f"{EXAMPLES}:ur10_joint_limited_robot": 10.0, "panda": 3.0, "xarm7": 3.5, "kinova": 1.6}
"""Kilograms by robot: what its maker allows."""

ENDS = Reason.START_EXCEEDS_TORQUE, Reason.GOAL_EXCEEDS_TORQUE
STEP = 1e-3


class Judge:
    """Torques by Pinocchio's own reader, model and algorithm."""

    def __init__(self, name: str, robot: Robot, load: Payload) -> None:
        file = example_urdf(name.partition(":")[2]) if ":" in name else _urdf_of(name)
        full = pin.buildModelFromUrdf(str(file))
        locked = [full.getJointId(each) for each in full.names.tolist()[1:] if each not in robot.joint_names]
        self.model = pin.buildReducedModel(full, locked, pin.neutral(full))
        frame = self.model.frames[self.model.getFrameId(robot.tool_frame)]
        inertia = pin.Inertia(load.mass, np.array(load.com), symmetric(load.inertia))
        self.model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
        self.data = self.model.createData()
        self.order = [robot.joint_names.index(each) for each in self.model.names.tolist()[1:]]

    def shares(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Torques over efforts, (m, n), in Pinocchio's order of joints."""
        rows = zip(map(self._configuration, q), qd[:, self.order], qdd[:, self.order], strict=True)
        torques = [np.array(pin.rnea(self.model, self.data, *row)) for row in rows]
        return np.asarray(np.abs(np.array(torques)) / self.model.upperEffortLimit)

    def along(self, trajectory: Trajectory) -> float:
        """The largest share along a motion, every millisecond."""
        samples = trajectory.sample(STEP)
        return float(self.shares(samples.q, samples.qd, samples.qdd).max())

    def holds(self, q: FloatArray) -> bool:
        """Whether each joint can hold the robot still."""
        still = np.zeros((1, len(q)))
        return float(self.shares(q[None], still, still).max()) <= 1.0

    def _configuration(self, q: FloatArray) -> FloatArray:
        out = np.zeros(self.model.nq)
        for joint, k in zip(self.model.joints.tolist()[1:], self.order, strict=True):
            at = joint.idx_q
            out[at : at + joint.nq] = (math.cos(q[k]), math.sin(q[k])) if joint.nq == 2 else q[k]
        return out


def _urdf_of(name: str) -> Path:
    return read_robot_file(data_folder("robots") / name / "robot.toml").urdf


def run(queries: int = PLANS, seed: int = 0) -> Report:
    """That many plans of all robots together; about two minutes for 200."""
    rows = tuple(row for k, name in enumerate(LOADS) for row in _robot(name, -(-queries // len(LOADS)), [seed, k]))
    return Report("torque", rows, (_table(rows),), tuple(_promises(rows, queries)))


def _robot(name: str, plans: int, seed: Sequence[int]) -> Iterator[Row]:
    service, rng = PlannerService(name, "table"), np.random.default_rng(seed)
    robot, mass = service.robot, LOADS[name]
    moment = 0.4 * mass * 0.05**2  # a ball of 5 cm before the tool
    load = Payload(mass, (0.0, 0.0, 0.05), (moment, 0.0, 0.0, moment, 0.0, moment))
    judge, law, made = Judge(name, robot, load), ToppRa(torque=True), 0
    while made < plans:
        start, goal = _free(service, rng), _free(service, rng)
        asked = PlanRequest(start, goal, timing=law, payload=load, time_limit=None, max_checks=100_000)
        result = service.plan(asked)
        ends = result.failure is not None and result.failure.reason in ENDS
        way = result.failure is not None and result.failure.reason is Reason.TIMING_FAILED
        row: Row = {"robot": robot.name, "ok": result.ok, "ends": ends, "way": way}
        row["disagree"] = ends == (judge.holds(start) and judge.holds(goal))
        if result.ok:
            free = service.plan(replace(asked, timing=ToppRa(), payload=None))
            row |= _compared(judge, result, free)
            made += 1
        yield row


def _free(service: PlannerService, rng: np.random.Generator) -> FloatArray:
    limits, checker = service.robot.limits, service.checker
    while True:
        q = rng.uniform(limits.lower, limits.upper)
        if checker.state_is_free(q):
            return q


def _compared(judge: Judge, result: Any, free: Any) -> Row:
    return {
        "torque": judge.along(result.trajectory),
        "reported": max(peak.ratio for peak in result.motion.peaks.torques),
        "unlimited": judge.along(free.trajectory),
        "slower": result.trajectory.duration / free.trajectory.duration - 1.0,
        "ms": 1e3 * result.stage(Stage.TIMING).seconds,
        "free ms": 1e3 * free.stage(Stage.TIMING).seconds,
        "plan ms": 1e3 * result.seconds,
    }


def _table(rows: Sequence[Row]) -> Table:
    def line(robot: str, here: Sequence[Row]) -> Row:
        made = [row for row in here if row["ok"]]
        slower, ms, free, whole = ([row[key] for row in made] for key in ("slower", "ms", "free ms", "plan ms"))
        return {
            "robot": robot,
            "plans": len(made),
            "ends refused": sum(row["ends"] for row in here),
            "not held on the way": sum(row["way"] for row in here),
            "no path": sum(not (row["ok"] or row["ends"] or row["way"]) for row in here),
            "highest torque": f"{max(row['torque'] for row in made):.2%}",
            "without limits": f"{max(row['unlimited'] for row in made):.0%}",
            "too high without": sum(row["unlimited"] > 1.0 for row in made),
            "slower": f"{p50(slower):.1%} / {p95(slower):.1%} / {max(slower):.0%}",
            "timing, ms": f"{p50(ms):.1f} / {p95(ms):.1f}",
            "without, ms": f"{p50(free):.1f}",
            "plan, ms": f"{p50(whole):.1f}",
        }

    caption = "Torques over efforts, by Pinocchio every millisecond. Slower: p50 / p95 / most; ms: p50 / p95."
    lines = (line(*each) for each in grouped(rows, "robot").items())
    return table_of("Payload within torque limits", lines, caption=caption)


def _promises(rows: Sequence[Row], plans: int) -> Iterator[Promise]:
    made = [row for row in rows if row["ok"]]
    highest, unlike = max(row["torque"] for row in made), sum(row["disagree"] for row in rows)
    off = max(row["torque"] - row["reported"] for row in made)
    yield Promise(f"at least {plans} plans", f"{len(made)}", len(made) >= plans)
    yield Promise(
        f"no torque is more than {EXCESS:.1%} above its limit", f"{highest - 1.0:+.2%}", highest <= 1.0 + EXCESS
    )
    yield Promise(f"what is reported is at most {BETWEEN:.2%} of a limit too low", f"{off:+.3%}", off <= BETWEEN)
    yield Promise("exactly the ends that cannot be held are refused", f"{unlike} differ", unlike == 0)

"""Every job carried out in simulation: seen, planned, moved, and the next one planned in the world that this left.

The WidowX AI by its own simulated arm, through its vendor's driver and in real time; the others by position control in
MuJoCo. What touched is what the simulator says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import planner_service as ps
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.cells.physics import Physics
from benchmarks.studies.cells.work import Work, kept_rows, solved
from benchmarks.worlds.cells import Cell, Job
from planner_service.execute import SimulatedArm, Streaming, rehearse
from planner_service.planning.task_result import TaskResult

__all__ = ["run"]

PADDING = {"wxai": 0.004, "panda": 0.003, "ur5_vacuum": 0.003}
"""Metres that plans keep from everything, as an arm leaves its path by one to three millimetres."""

TIGHT, ROOM = 0.002, 0.006
"""Metres: a plan that keeps less, as it does beside what stands next to an object, is made anew with so much room for
each finger."""

NEAR = 0.01
"""Metres from its place within which a thing has come to lie."""

OWN = "wxai"
"""The robot with a simulated arm of its own."""

STREAMING = Streaming(speed=0.9, latest=0.5, gripper_time=0.6, squeeze=0.004)


@dataclass(frozen=True, eq=False)
class _Done:
    """What became of a job: contacts that were not meant, where its object lies, where the arm stands (n,)."""

    contacts: tuple[str, ...]
    pose: ps.Pose
    q: tuple[float, ...]
    trouble: str = ""


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """Each cell from its first object to its last."""
    rows = kept_rows("executed", _rows, queries, seed, robot, kept)
    lines = []
    for name in dict.fromkeys(row["cell"] for row in rows):
        mine = [row for row in rows if row["cell"] == name]
        lines.append(
            {
                "cell": name,
                "simulator": mine[0]["simulator"],
                "in place": f"{sum(row['ok'] for row in mine)} of {len(mine)}",
                "unexpected contacts": sum(len(row["contacts"]) for row in mine),
                "most mm from its place": f"{max(row['off'] for row in mine) * 1e3:.1f}",
                "motion s": f"{sum(row['seconds'] for row in mine):.0f}",
            }
        )
    late, touched = [row for row in rows if not row["ok"]], [row for row in rows if row["contacts"]]
    promises = (
        Promise("objects that are where they were to be", f"{len(rows) - len(late)} of {len(rows)}", not late),
        Promise("unexpected contacts in simulation", f"{sum(len(row['contacts']) for row in rows)}", not touched),
    )
    caption = "Planned with 3 or 4 mm of padding from where the simulator has the object."
    return Report("cells executed", tuple(rows), (table_of("Cells in simulation", lines, caption=caption),), promises)


def _rows(cell: Cell, queries: int | None) -> list[Row]:
    work, rows = Work.begun(cell), list[Row]()
    carry_out = _by_its_own_arm if cell.robot == OWN else _by_physics
    for job in cell.jobs[:queries]:
        work = work.facing(job)
        plan, done = carry_out(work, job)
        off = math.inf if done is None else _off(plan.world.scene, job, done.pose)
        rows.append(
            {
                "part": "executed",
                "cell": cell.name,
                "simulator": "its own" if cell.robot == OWN else "MuJoCo",
                "job": job.name,
                "planned": plan.ok,
                "failure": str(plan.failure or ""),
                "contacts": [] if done is None else list(done.contacts),
                "trouble": "" if done is None else done.trouble,
                "off": min(off, 9.999),
                "ok": off <= NEAR and done is not None and not done.trouble,
                "seconds": plan.duration,
            }
        )
        if done is not None:
            scene = plan.world.scene
            if job.name in scene.names:
                scene = scene.moved(job.name, done.pose)
            after = ps.PlannerService(plan.world.robot, scene)
            work = replace(work, service=after, q=plan.q)
    return rows


def _off(scene: ps.Scene, job: Job, pose: ps.Pose) -> float:
    """Metres from where an object was to be put."""
    if job.name not in [each.name for each in scene.obstacles]:
        return math.inf
    return math.dist(scene.obstacle(job.name).pose.position, pose.position)


def _plan(work: Work, job: Job, scene: ps.Scene) -> TaskResult:
    padding = PADDING[work.cell.robot]
    seen = replace(work, service=work.service.with_scene(scene))
    request = ps.PlanRequest(work.q, work.q, padding=padding, time_limit=None)
    plan = solved(seen, job, request)
    width = next((after.width for before, after in pairwise(plan.segments) if after.width < before.width), None)
    if not plan.ok or width is None or _tightest(plan) >= TIGHT:
        return plan
    roomy = solved(seen, job, request, opening=width + 2.0 * ROOM)
    return roomy if roomy.ok and _tightest(roomy) > _tightest(plan) else plan


def _tightest(plan: TaskResult) -> float:
    """Metres that every motion of a plan keeps, the gripper's among them."""
    proofs = [each.result.certificate for each in plan.segments]
    proofs += [each.gripper.certificate for each in plan.segments if each.gripper is not None]
    return min(proof.clearance for proof in proofs if proof is not None)


def _by_physics(work: Work, job: Job) -> tuple[TaskResult, _Done | None]:
    physics = Physics(work.service.robot, work.service.scene, work.q, (job.name,))
    plan = _plan(work, job, work.service.scene.moved(job.name, physics.poses()[job.name]))
    if not plan.ok:
        return plan, None
    outcome = physics.run(plan.segments)
    contacts = tuple(f"{pair}, {steps} steps" for pair, steps in outcome.unexpected.items())
    trouble = f"not taken: {', '.join(outcome.lost)}" if outcome.lost else ""
    return plan, _Done(contacts, physics.poses()[job.name], tuple(physics.positions().tolist()), trouble)


def _by_its_own_arm(work: Work, job: Job) -> tuple[TaskResult, _Done | None]:
    robot = work.service.robot
    with SimulatedArm(robot, work.service.scene, work.q, loose=(job.name,)) as arm:
        plan = _plan(work, job, arm.seen())
        if not plan.ok:
            return plan, None
        done = rehearse(arm, plan, robot, STREAMING)
    contacts = tuple(map(str, done.contacts))
    q = tuple(done.report.motions[-1].recording.measured[-1].tolist())
    return plan, _Done(contacts, done.loose[job.name], q, done.report.stopped or "")

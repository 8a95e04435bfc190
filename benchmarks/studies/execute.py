"""Pick-and-place on the simulated arm: tracking, contacts, what Coal says of where the arm really was, and stops.

Wall-clock: the simulation runs in real time. Under load the stream comes late, and the arm is behind where it was to be
at that time; its path, its contacts and where it ends are what is promised.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from rich.table import Table

import planner_service as ps
from benchmarks.harness.audit import Auditor, between
from benchmarks.harness.report import Promise, Report, Row, table
from planner_service import execute as streaming
from planner_service.geometry.arrays import FloatArray
from planner_service.records.plan_file import SavedTask
from planner_service.tasks import Segment
from planner_service.tasks.pick_place import places_on

__all__ = ["ERRANDS", "STREAMING", "Cut", "Errand", "audited", "control", "errand", "promises", "run", "stop_rows"]

STREAMING = streaming.Streaming(latest=0.5)
"""A stream that is half a second late is no measurement; less happens on a machine that does other things."""

PADDING = 0.005
"""Metres that plans keep: the arm leaves its path by 1 to 3 mm."""

FINAL, NEAR = 0.005, 0.005
"""Radians off at the end of each motion, at most, and metres by which what was placed may be off."""

AUDIT_STEP = 0.002
"""Radians between configurations of the recorded path that Coal is asked about."""


@dataclass(frozen=True, eq=False)
class Errand:
    """A pick-and-place with the world as it is during each of its motions, and the object's place in the end."""

    name: str
    task: SavedTask
    scenes: tuple[ps.Scene, ...]
    end: ps.Pose


def errand(name: str, arm: streaming.SimulatedArm) -> Errand:
    """Out of the bin round the post onto the tray, or from place to place on the board inside the shelf."""
    service = ps.PlannerService("wxai", arm.seen())
    home = service.robot.home
    request = ps.PlanRequest(home, home, padding=PADDING, time_limit=None)
    if name == "bin":
        block, under, onto = service.scene.obstacle("blue_block"), "bin_floor", "tray"
        grasps, places = ps.top_grasps(service.robot, block), places_on(block, service.scene.obstacle(onto))
    else:
        block, under, onto = service.scene.obstacle("block"), "shelf_board", "shelf_board"
        x, y, z = block.pose.position
        grasps = (ps.Pose.from_rpy((x, y, z), (0.0, math.radians(15.0), 0.0)),)  # reaching in, a little downwards
        places = (ps.Pose((x, -y, z + 0.001), block.pose.quaternion),)
    taking = ps.Handling(support=under, request=request)
    picked = _done(ps.pick(service, home, block.name, grasps, taking))
    putting = ps.Handling(support=onto, request=request)
    placed = _done(ps.place(ps.PlannerService.of(picked.world), picked.q, block.name, places, putting))
    back = ps.PlannerService.of(placed.world).plan(ps.PlanRequest(placed.q, home, padding=PADDING, time_limit=None))
    back.unwrap()
    home_again = Segment("home", back, placed.world.robot.gripper_width)
    to, into, lift, transfer, lower, away = (*picked.segments, *placed.segments)
    worlds = (service.scene, service.scene, *3 * (picked.world.scene,), *2 * (placed.world.scene,))
    segments = (to, into, lift, transfer, lower, away, home_again)
    task = SavedTask(service.world, name, segments, picked.choosing + placed.choosing, 0.0)
    return Errand(name, task, worlds, placed.world.scene.obstacle(block.name).pose)


def _done(result: ps.TaskResult) -> ps.TaskResult:
    if result.failure is not None:
        raise RuntimeError(str(result.failure))
    return result


BLOCK = ps.Obstacle("block", ps.Box((0.045, 0.045, 0.045)), ps.Pose((0.43, 0.08, 0.1935)))

ERRANDS = {
    "bin": (ps.load_scene("bin"), "blue_block"),
    "shelf": (ps.load_scene("shelf").with_obstacle(BLOCK), BLOCK.name),
}
"""Scenes, and what is taken in them."""


def audited(work: Errand, done: streaming.Rehearsal) -> list[str]:
    """What Coal says of the configurations that were recorded in each motion: "free", or what touches."""
    told = []
    for segment, scene, motion in zip(work.task.segments, work.scenes, done.report.motions, strict=False):
        allowed = [pair for interval in segment.result.exempt for pair in interval.pairs]
        auditor = Auditor("wxai", scene, gripper_width=segment.width, allowed=allowed)
        found = auditor.judge(between(motion.recording.measured, AUDIT_STEP), AUDIT_STEP)
        told.append("free" if found["verdict"] == "free" else f"{found['verdict']}: {found['pair']}")
    return told


def control() -> tuple[ps.Trajectory, streaming.Rehearsal]:
    """The straight joint motion from above the bin to above the tray, through the post, which nobody planned."""
    scene = ps.load_scene("bin").without("blue_block")
    robot = ps.load_robot("wxai")
    service = ps.PlannerService(robot, scene)
    over_bin, over_tray = (
        service.plan(ps.PlanRequest(robot.home, ps.Pose(at, (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)))).unwrap()[0]
        for at in ((0.33, 0.0, 0.13), (0.2, 0.28, 0.13))
    )
    path = ps.JointPath(np.array([over_bin.waypoints[-1], over_tray.waypoints[-1]]))
    if service.checker.edge_is_free(*path.waypoints):
        raise RuntimeError("the control is free: it shows nothing")
    motion = ps.Trapezoidal().time_path(path, robot.limits)
    with streaming.SimulatedArm(robot, scene, path.waypoints[0]) as arm:
        return motion, streaming.rehearse(arm, motion, robot, STREAMING, allow_unproven=True)


class Cut:
    """A driver that fails at some moment, and then holds where the arm is, or to compare where it was told to be."""

    def __init__(self, driver: streaming.Driver, moment: float, *, where_told: bool) -> None:
        self.driver, self.moment, self.where_told = driver, moment, where_told
        self.simulated, self.lag = driver.simulated, driver.lag
        self.began = math.inf
        self.told = self.stood = driver.positions()

    def limits(self) -> streaming.ArmLimits:
        return self.driver.limits()

    def positions(self) -> FloatArray:
        return self.driver.positions()

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        self.began = min(self.began, time.perf_counter())
        if time.perf_counter() - self.began >= self.moment:
            raise OSError("cut")
        self.told = np.array(q)
        self.driver.command(q, qd, qdd)

    def hold(self, q: ArrayLike) -> None:
        self.stood = np.array(q)
        self.driver.hold(self.told if self.where_told else q)

    def gripper_width(self) -> float:
        return self.driver.gripper_width()

    def move_gripper(self, width: float, seconds: float) -> None:
        self.driver.move_gripper(width, seconds)

    def close(self) -> None:
        self.driver.close()


def stop_rows() -> list[Row]:
    """A fast motion cut off at its fastest: how far the tool goes on, and how far off its path, by where it holds."""
    robot = ps.load_robot("wxai")
    service = ps.PlannerService(robot, "empty")
    off = np.array([1.2, 0.0, 0.0, 0.2, 0.8, 0.0])
    plan = service.plan(ps.PlanRequest(robot.home - off, robot.home + off))
    motion = plan.unwrap()[1]
    points = motion.sample(0.004)
    fastest = float(points.t[np.abs(points.qd).max(axis=1).argmax()])
    path = np.array([robot.tool_pose(q)[:3, 3] for q in motion(np.linspace(0.0, motion.duration, 2000))])
    rows = []
    for where_told in (False, True):
        with streaming.SimulatedArm(robot, service.scene, motion(0.0)) as arm, closing(arm.connect()) as driver:
            cut = Cut(driver, fastest, where_told=where_told)
            with suppress(streaming.ExecutionStopped):
                streaming.execute(plan, cut, robot, STREAMING)
            seen = []
            until = time.perf_counter() + 1.0
            while time.perf_counter() < until:
                seen.append(robot.tool_pose(driver.positions())[:3, 3])
                time.sleep(0.002)
        begun = robot.tool_pose(cut.stood)[:3, 3]
        on = [math.dist(begun, at) for at in seen]
        aside = [np.sqrt(((path - at) ** 2).sum(axis=1)).min() for at in seen]
        row: Row = {"holds": "where it was told to be" if where_told else "where it is"}
        row |= {"speed": float(np.abs(motion(fastest, 1)).max()), "on_mm": 1000.0 * max(on)}
        rows.append(row | {"rest_mm": 1000.0 * on[-1], "off_mm": 1000.0 * float(max(aside))})
    return rows


def run() -> Report:
    """All of it, about a minute and a half of real time."""
    rows: list[Row] = []
    for name, (scene, taken) in ERRANDS.items():
        with streaming.SimulatedArm(ps.load_robot("wxai"), scene, loose=(taken,)) as arm:
            work = errand(name, arm)
            done = streaming.rehearse(arm, work.task, ps.load_robot("wxai"), STREAMING)
        verdicts = audited(work, done)
        placed = math.dist(done.loose[taken].position, work.end.position)
        for motion, verdict in zip(done.report.motions, verdicts, strict=True):
            rows.append({"scene": name, "coal": verdict, "placed": placed, **motion.document()})
        rows[-1]["contacts"] = [str(contact) for contact in done.contacts]
        rows[-1]["stopped"] = done.report.stopped
    _, hit = control()
    against = [str(contact) for contact in hit.contacts]
    stops = stop_rows()
    tables = (_leg_table(rows), _stop_table(stops))
    return Report("execute", (*rows, {"control": against}, *stops), tables, promises(rows, against))


def promises(rows: Sequence[Row], control_contacts: Sequence[str]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    contacts = [text for row in rows for text in row.get("contacts", ())]
    stops = [row["stopped"] for row in rows if row.get("stopped")]
    final = max(max(row["final_error"]) for row in rows)
    colliding = [f"{row['scene']} {row['name']}: {row['coal']}" for row in rows if row["coal"] != "free"]
    placed = max(row["placed"] for row in rows)
    ended = len(rows) >= 8 and not stops and all(row["completed"] for row in rows)
    legs = "at least 8 pick-and-place legs over bin and shelf are executed to their ends"
    contact = "no contact between arm and scene that was not meant, in the simulator's stream"
    post = "the straight motion through the post does report one"
    carried = f"what was carried lies within {NEAR * 1e3:g} mm of its place"
    return (
        Promise(legs, f"{len(rows)}; {'; '.join(stops) or 'none stopped'}", ended),
        Promise(contact, "; ".join(contacts) or "0", not contacts),
        Promise(post, f"{len(control_contacts)}", bool(control_contacts)),
        Promise(f"final error after settling below {FINAL * 1e3:g} mrad", f"{final * 1e3:.2f} mrad", final < FINAL),
        Promise("Coal: the recorded joint paths are free", "; ".join(colliding) or "all", not colliding),
        Promise(carried, f"{placed * 1e3:.2f} mm", placed < NEAR),
    )


def _leg_table(rows: Sequence[Row]) -> Table:
    columns = ("leg", "s", "max mrad", "rms mrad", "final mrad", "lag mm", "off path mm", "late", "latest ms", "Coal")
    cells = [
        [
            f"{row['scene']}: {row['name']}",
            f"{row['seconds']:.2f}",
            *(f"{max(row[key]) * 1e3:.1f}" for key in ("error_max", "error_rms", "final_error")),
            f"{row['tool_lag_mm']:.1f}",
            f"{row['tool_off_path_mm']:.1f}",
            f"{row['late_ticks']} of {row['ticks']}",
            f"{row['latest_tick'] * 1e3:.0f}",
            row["coal"],
        ]
        for row in rows
    ]
    caption = (
        "At the planned speed, 250 commands a second, each ahead by the joints' lag. Max and rms: measured minus "
        "planned positions at the same time, the worst joint. Lag: of the tool, at the same time; off path: from the "
        "planned path, whenever. Late: ticks that came more than a tick late or were left out. Coal: of the path as "
        "recorded."
    )
    return table("Legs on the simulated arm", columns, cells, caption=caption)


def _stop_table(rows: Sequence[Row]) -> Table:
    columns = ("told to hold", "rad/s", "goes on mm", "rests mm", "off path mm")
    cells = [
        [row["holds"], f"{row['speed']:.2f}", *(f"{row[key]:.1f}" for key in ("on_mm", "rest_mm", "off_mm"))]
        for row in rows
    ]
    caption = (
        "A stream that fails at the fastest moment of a motion: how far the tool goes on from where it was, how far "
        "from there it comes to rest, and how far it is off its planned path on the way, at most."
    )
    return table("Stops", columns, cells, caption=caption)

"""What ``planner-service robot check`` says of robots that nobody here drew: it ends well, and what it finds is there.

Pinocchio and Coal, which read the files themselves, judge what can be judged by numbers: a home in collision, almost
nothing being free, hulls that touch what meshes do not, fingers that pass through each other, and rates that are not
stated. Their meshes are triangles.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np
from rich.table import Table

from benchmarks.harness.environment import ROOT
from benchmarks.harness.fresh_process import told_by
from benchmarks.harness.report import Promise, Report, Row, table, table_of
from benchmarks.worlds.foreign import READINGS, ForeignRobot
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

AT_MOST, JUDGED_IN = 900.0, 900.0
"""Seconds for a check, and for its judges."""
STATES = 1000
LEAST_FREE = 0.03
"""Share of states that is free to the judge, where the check, of other ones, finds less than 2 %."""
CONTACT, ALLOWED = 1e-6, 1e-3
"""Metres that Coal's distances are right to, and that convex pieces may be larger than triangles."""
SHOWN = 200
"""Letters of a finding."""

Judge = Callable[[Mapping[str, Any]], str]
"""Why a finding is wrong; empty if it is right."""


def run(robot: str | None = None, *, listed: bool = True) -> Report:
    """Check the robot files of others, or those of the robot of that name; list what is found, too, if so asked."""
    rows = tuple(_row(one) for one in READINGS if robot in (None, one.name))
    return Report("robots", rows, tuple(_tables(rows, listed=listed)), tuple(_promises(rows)))


def _row(one: ForeignRobot) -> Row:
    row: Row = {"robot": one.name, "source": f"{one.distribution}, {one.file}"}
    try:
        source = one.source()
    except InvalidRequest as error:
        return row | {"missing": str(error).splitlines()[0]}
    command = [sys.executable, "-m", "planner_service", "robot", "check", source, "--json"]
    begun = time.perf_counter()
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=AT_MOST)
    except subprocess.TimeoutExpired:
        return row | {"exit": None, "findings": [], "wrong": [], "last": f"not done in {AT_MOST:g} s"}
    row |= {"exit": done.returncode, "s": time.perf_counter() - begun, "findings": [], "wrong": [], "judged": 0}
    if done.returncode not in (0, 1):
        return row | {"last": (done.stderr.strip().splitlines() or ["no word"])[-1][:SHOWN]}
    told = json.loads(done.stdout)
    row["findings"] = [{"kind": each["kind"], "text": each["text"]} for each in told["findings"]]
    if told["ok"] and any(each["kind"] in _JUDGES for each in told["findings"]):
        with TemporaryDirectory() as place:
            document = Path(place, "check.json")
            document.write_text(done.stdout, "utf-8")
            row |= told_by("benchmarks.studies.checks", source, document, seconds=JUDGED_IN)
    return row


def _tables(rows: Sequence[Row], *, listed: bool) -> Iterator[Table]:
    lines = [
        {
            "robot": row["robot"],
            "exit": "none" if row["exit"] is None else row["exit"],
            "s": f"{row['s']:.0f}" if "s" in row else "-",
            "findings": len(row["findings"]),
            "judged": row.get("judged", 0),
            "wrong": len(row["wrong"]),
            "kinds": ", ".join(f"{kind} {n}" for kind, n in Counter(f["kind"] for f in row["findings"]).items()),
        }
        for row in rows
        if "exit" in row
    ]
    caption = (
        "Exit: 0 the robot can be loaded, 1 it cannot. Judged: findings that Pinocchio and Coal can tell by numbers."
    )
    if lines:
        yield table_of("What robot check finds", lines, caption=caption)
    told = [(row["robot"], f["kind"], f["text"][:SHOWN]) for row in rows for f in row.get("findings", ())]
    if told and listed:
        yield table("Findings", ("robot", "kind", "what"), told)
    gone = [(row["robot"], line) for row in rows for line in row.get("wrong", ())]
    gone += [(row["robot"], row[key]) for row in rows for key in ("missing", "last", "error") if key in row]
    if gone:
        yield table("What went wrong", ("robot", "what"), gone)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    ended = [row for row in rows if row.get("exit") in (0, 1)]
    failed = [row["robot"] for row in rows if row not in ended]
    yield Promise("robot check ends with 0 or 1", ", ".join(failed) or f"{len(ended)} files", not failed)
    wrong = [row["robot"] for row in ended if row["wrong"] or "error" in row]
    judged = sum(row.get("judged", 0) for row in ended)
    yield Promise("each finding that can be judged is true", ", ".join(wrong) or f"{judged} findings", not wrong)


class _Judges:
    """The robot of a source as Pinocchio and Coal read it."""

    def __init__(self, source: str, told: Mapping[str, Any], place: Path) -> None:
        from benchmarks.worlds.foreign import described_file
        from planner_service import load_robot

        self.source, self.told, self.place = source, told, place
        self.robot = load_robot(source)
        self.root = ElementTree.parse(described_file(source, place)).getroot()

    def _checker(self, robot: Any, **other: Any) -> Any:
        from auditor.checker import IndependentChecker
        from benchmarks.worlds.foreign import table_of_robot

        return IndependentChecker(table_of_robot(robot, self.source, self.place) | {"surfaces": True} | other, {})

    def _draws(self, robot: Any) -> FloatArray:
        lower, upper = robot.limits.lower, robot.limits.upper
        return np.random.default_rng(1).uniform(lower, upper, (STATES, robot.n))

    def home(self, finding: Mapping[str, Any]) -> str:
        """The first pair touches; pieces of meshes may be a millimetre larger than these."""
        pair = set(re.findall(r"(\S+) x (\S+) \(at most", finding["text"])[0])
        gap = self._gap(
            pair, {**self.told["home"], **self.told["locked_joints"]}, opened=self.robot.gripper is not None
        )
        return "" if gap <= ALLOWED else f"these are {1e3 * gap:.2f} mm apart"

    def _gap(self, pair: set[str], at: Mapping[str, float], *, opened: bool = False) -> float:
        """Metres between two links where joints are so, others at home; fingers are joints, or stand open."""
        from planner_service import load_robot

        robot = self.robot if opened else load_robot(self.source, gripper=(), cut_meshes=False)
        home = dict(zip(robot.joint_names, robot.home.tolist(), strict=True))
        q = np.clip([at.get(name, home[name]) for name in robot.joint_names], *robot.bounds)
        gaps = self._checker(robot, allowed_contacts=[]).gaps(q)
        return min((gap for links, gap in gaps.items() if set(links) == pair), default=np.inf)

    def blocked(self, finding: Mapping[str, Any]) -> str:
        """Almost no configuration is free."""
        checker = self._checker(self.robot)
        share = float(np.mean([checker.free(q) for q in self._draws(self.robot)]))
        return "" if share <= LEAST_FREE else f"{share:.1%} are free"

    def hulls(self, finding: Mapping[str, Any]) -> str:
        """Each of the links is in a pair whose hulls touch and whose triangles do not."""
        from planner_service import CollisionChecker, Scene, load_robot
        from planner_service.robot_setup.self_collision_matrix import draws

        hulls = load_robot(self.source, cut_meshes=False)
        checker, judge = CollisionChecker(hulls, Scene()), self._checker(hulls)
        left = set(finding["links"])
        for q in draws(hulls, STATES):  # rare ones are named, too: in the states in which they were seen
            pairs = [pair for pair in checker.touching(q) if left.intersection(pair)]
            gaps = {frozenset(pair): gap for pair, gap in judge.gaps(q).items()} if pairs else {}
            left -= {link for pair in pairs if gaps.get(frozenset(pair), 0.0) > CONTACT for link in pair}
            if not left:
                return ""
        return f"no such state of {', '.join(sorted(left))} among {STATES}"

    def fingers(self, finding: Mapping[str, Any]) -> str:
        """Those that are said to pass through each other touch where that is said; what stands still is locked."""
        if "pass through" not in finding["text"]:
            said = re.findall(r"([\w/.:-]+)=", finding["text"].split("(")[1].split(")")[0])
            moving = [name for name in said if name in self.robot.joint_names]
            return f"{', '.join(moving)} moves" if moving else ""
        at = {name: float(value) for name, value in re.findall(r"([\w/.:-]+)=([-+.\de]+)", finding["text"])}
        gap = self._gap(set(finding["links"]), at)
        return "" if gap <= ALLOWED else f"these are {1e3 * gap:.2f} mm apart"

    def velocity(self, finding: Mapping[str, Any]) -> str:
        """The limits of the joints say nothing of it, or zero."""
        return self._stated(finding, "velocity")

    def effort(self, finding: Mapping[str, Any]) -> str:
        """As ``velocity``."""
        return self._stated(finding, "effort")

    def _stated(self, finding: Mapping[str, Any], kind: str) -> str:
        limits = {joint.get("name"): joint.find("limit") for joint in self.root.iter("joint")}
        stated = [
            name
            for name in finding["joints"]
            if (limit := limits.get(name)) is not None and float(limit.get(kind, "0")) != 0.0
        ]
        return f"stated of {', '.join(stated)}" if stated else ""


_JUDGES: Mapping[str, str] = {
    "home": "home",
    "almost nothing is free": "blocked",
    "hulls": "hulls",
    "fingers": "fingers",
    "velocity": "velocity",
    "effort": "effort",
}
"""By kind of finding who judges it."""


def main(source: str, document: str) -> None:
    """Print which findings of a check of ``source`` are wrong."""
    told = json.loads(Path(document).read_text("utf-8"))
    with TemporaryDirectory() as place:
        judges = _Judges(source, told, Path(place))
        wrong, judged = [], 0
        for finding in told["findings"]:
            if finding["kind"] in _JUDGES:
                judge: Judge = getattr(judges, _JUDGES[finding["kind"]])
                why, judged = judge(finding), judged + 1
                wrong += [f"{finding['text'][:SHOWN]}: {why}"] if why else []
    print(json.dumps({"judged": judged, "wrong": wrong}))


if __name__ == "__main__":
    main(*sys.argv[1:3])

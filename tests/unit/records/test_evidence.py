"""Evidence in plan files, judged by ``auditor/verify.py``: nothing else of the package, nor any library but numpy."""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess
import sys
import zlib
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.__main__ import main
from auditor.sampling import objections
from auditor.schema import Invalid
from auditor.verify import verify
from planner_service import (
    Attached,
    Box,
    HeightField,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    Scene,
    load_robot,
    load_scene,
)
from planner_service.infeasibility import prove_no_path
from planner_service.path.joint_path import JointPath
from planner_service.planning.request import World
from planner_service.records.evidence import with_evidence
from planner_service.records.exports.no_path_file import no_path_document
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan
from planner_service.tasks.pick_place import plan_pick_place

Document = dict[str, Any]

WALL = Obstacle("wall", Box((0.02, 0.3, 0.3)), Pose((0.35, 0.25, 0.2)))


def planned(scene: Scene, robot: str = "wxai", start: str = "home", goal: str = "ready", **asked: Any) -> SavedPlan:
    arm = load_robot(robot)
    poses = dict(arm.named_poses)
    result = PlannerService(arm, scene).plan(PlanRequest(poses[start], poses[goal], time_limit=None, **asked))
    return SavedPlan.of(result)


def document(plan: SavedPlan | SavedTask) -> Document:
    """What a file of it with evidence holds, as one that only knows JSON sees it."""
    content: Document = json.loads(with_evidence(plan).file_text())
    return content


@pytest.fixture(scope="module")
def plain() -> Document:
    return document(planned(Scene((WALL,))))


@pytest.fixture(scope="module")
def task() -> SavedTask:
    service = PlannerService("wxai", load_scene("bin"))
    home = service.robot.home
    return SavedTask.of(plan_pick_place(service, "blue_block", "tray", PlanRequest(home, home), upright=0.3))


def json_of(document: Document) -> Document:
    """The same as one that only knows JSON sees it."""
    content: Document = json.loads(json.dumps(document))
    return content


def shown(document: Document) -> list[str]:
    return list(verify(document))


def test_things_that_are_carried_together_need_not_be_apart_and_are_named() -> None:
    stack = [Attached(name, Box((0.02, 0.02, 0.02)), Pose((0.05, 0.0, z))) for name, z in (("a", 0.0), ("b", 0.02))]
    assert "  not judged: a x b, held together" in shown(document(planned(Scene((), attached=tuple(stack)))))


def test_the_clearance_that_the_trail_shows_is_at_least_that_of_the_certificate(plain: Document) -> None:
    claimed = plain["result"]["certificate"]["clearance"]
    (line,) = [line for line in shown(plain) if line.startswith("motion:")]
    assert 1e3 * claimed <= float(line.split()[1]) + 2e-4 <= 1.05e3 * claimed  # levers here are a little shorter


@pytest.mark.slow
def test_a_whole_task_is_shown_with_what_it_carries_keeps_and_opens(task: SavedTask) -> None:
    lines = shown(document(task))
    assert sum(line.startswith("gripper before") for line in lines) == 3
    assert sum("2 constraints kept" in line for line in lines) == 3
    assert any("not judged" in line and "blue_block" in line for line in lines)


@pytest.mark.parametrize("solid", ["cloud", "heights"])
def test_clouds_and_height_fields_are_shown_by_boxes_that_hold_them(solid: str) -> None:
    generator = np.random.default_rng(2)
    shape = (
        PointCloud(generator.uniform(-0.1, 0.1, (2_000, 3)), 0.01)
        if solid == "cloud"
        else HeightField(generator.uniform(0.05, 0.15, (20, 20)), 0.02)
    )
    found = document(planned(Scene((Obstacle("thing", shape, Pose((0.4, -0.4, 0.1))),))))
    shown(found)
    boxes = array(found["sections"]["evidence"]["boxes"]["thing"], "<f8", 6)
    found["sections"]["evidence"]["boxes"]["thing"] = packed(boxes[1:], "<f8")
    with pytest.raises(Invalid, match="leave some of it out"):
        shown(found)


def test_a_constraint_of_the_request_is_judged_whether_the_result_lists_it_or_not(plain: Document) -> None:
    asked = {"kind": "joint range", "joint": "joint_0", "lower": -3.0, "upper": 3.0}
    kept = {**plain, "request": {**plain["request"], "constraints": [asked]}}
    assert any("1 constraints kept" in line for line in shown(kept))
    assert f"  kept: {json.dumps(asked)}" in shown(kept)
    asked["upper"] = -3.0
    with pytest.raises(Invalid, match="joint_0 is not kept"):
        shown(kept)


@pytest.mark.parametrize(("kind", "last"), [("plan", "clearance, "), ("proof", "that its walls collide")])
def test_it_runs_with_numpy_alone(kind: str, last: str, plain: Document, tmp_path: Path) -> None:
    """Whatever else is installed cannot be imported."""
    discs = tuple(Obstacle(f"disc {y}", Box((0.2, 0.2, 0.2)), Pose((0.5, y, 0.0))) for y in (-0.5, 0.5))
    world, ends = World(load_robot("planar2"), Scene(discs)), ([0.0, 0.0], [[3.0, 0.0]])
    proof = prove_no_path(world.robot, world.scene, *ends)
    assert proof is not None
    document = plain if kind == "plan" else no_path_document(proof, world, *ends)
    (tmp_path / "plan.json").write_text(json.dumps(document))
    code = f"""
import runpy, sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        own = name.partition(".")[0]
        if own not in ("numpy", "auditor") and own not in sys.stdlib_module_names:
            raise ImportError(name)
sys.meta_path.insert(0, Refused())
sys.path.insert(0, {str(Path(__file__).parents[3])!r})
sys.argv[1:] = [{str(tmp_path / "plan.json")!r}]
runpy.run_module("auditor", run_name="__main__")
"""
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1].startswith(f"VALID: verified: {last}")


def test_a_plan_that_was_asked_for_with_evidence_is_saved_with_it(tmp_path: Path) -> None:
    plan = planned(Scene((WALL,)), evidence=True)
    plan.result.save(tmp_path / "plan.json")
    found = json.loads((tmp_path / "plan.json").read_text())
    assert shown(found)
    read = load_plan(tmp_path / "plan.json")
    assert read.request is not None
    assert read.request.evidence
    read.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "plan.json").read_bytes()
    with pytest.raises(InvalidRequest, match="evidence"):
        planned(Scene(), evidence=1)


# Forgeries: their author works out every digest anew.


def array(text: str, kind: str, columns: int) -> Any:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), kind).reshape(-1, columns).copy()


def packed(table: Any, kind: str) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(table).astype(kind).tobytes())).decode()


def forged(plain: Document, change: Callable[[Document, Document], None]) -> Document:
    """A copy that is changed, file and proof, with its digests made right."""
    copy = deepcopy(plain)
    section = copy["sections"]["evidence"]
    change(copy, section["proofs"][0])
    for part in ("robot", "scene"):
        text = json.dumps(copy[part], sort_keys=True, separators=(",", ":"))
        section[part] = hashlib.sha256(text.encode()).hexdigest()
    return copy


def rows(proof: Document, change: Callable[[Any], Any]) -> None:
    proof["rows"] = packed(change(array(proof["rows"], "<i4", 9)), "<i4")


def at_wall(copy: Document, proof: Document) -> None:
    copy["scene"]["obstacles"][0]["shape"]["size"] = [0.2, 0.3, 0.8]


def through(copy: Document, proof: Document) -> None:
    copy["result"]["path"]["waypoints"][-1][0] += 0.5


def raised(copy: Document, proof: Document) -> None:
    for claim in (proof, copy["result"]["certificate"]):
        claim["clearance"] += 2e-3


def only_in_the_certificate(copy: Document, proof: Document) -> None:
    copy["result"]["certificate"]["clearance"] += 1e-3


def dropped(copy: Document, proof: Document) -> None:
    rows(proof, lambda table: table[table[:, 0] != table[5, 0]])


def stretched(copy: Document, proof: Document) -> None:
    def whole(table: Any) -> Any:
        last = table[:, 1:3].max()
        table[:, 1], table[:, 2] = 0, last
        return table

    rows(proof, whole)


def only_at_the_start(copy: Document, proof: Document) -> None:
    """Every pair is apart there, and the wall may be anywhere else."""

    def first(table: Any) -> Any:
        table = table[table[:, 1] == 0]
        table[:, 3:6] = np.where(table[:, 3:6].any(axis=1)[:, None], table[:, 3:6], table[:, 6:])
        table[:, 2], table[:, 6:] = 0, table[:, 3:6]
        return table

    rows(proof, first)
    proof["s"] = packed([[0.0], [copy["result"]["path"]["length"]]], "<f8")
    for claim in (proof, copy["result"]["certificate"]):
        claim["clearance"] = 1e-3


def long_directions(copy: Document, proof: Document) -> None:
    def doubled(table: Any) -> Any:
        table[:, 3:] = np.clip(table[:, 3:] * 1.5, -(2**31), 2**31 - 1)
        return table

    rows(proof, doubled)


def beyond_a_limit(copy: Document, proof: Document) -> None:
    copy["robot"]["limits"]["upper"][1] = max(point[1] for point in copy["result"]["path"]["waypoints"]) - 0.01


def hung_elsewhere(copy: Document, proof: Document) -> None:
    copy["robot"]["bodies"][3]["parent"] = -1


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (at_wall, "wall"),
        (through, "s =|not reach"),
        (raised, "claimed"),
        (only_in_the_certificate, "claims something else"),
        (dropped, "nothing is shown|does not reach"),
        (stretched, "are shown"),
        (only_at_the_start, "disorder"),
        (long_directions, "unit vector"),
        (beyond_a_limit, "limits"),
        (hung_elsewhere, "parent"),
    ],
)
def test_a_forgery_is_refused(plain: Document, change: Callable[[Document, Document], None], why: str) -> None:
    with pytest.raises(Invalid, match=why):
        shown(forged(plain, change))


# Bundles: boxes of cells, and runs of small obstacles that share one tree.


@pytest.fixture(scope="module")
def bundled() -> Document:
    chance = np.random.default_rng(3)
    y, z = chance.uniform(-0.4, 0.4, 900), chance.uniform(0.0, 0.6, 900)
    cloud = PointCloud(np.stack([0.01 * np.sin(9.0 * y), y, z], axis=1), 0.02)
    things = [Obstacle("cloud", cloud, Pose.from_rpy((-0.35, 0.1, 0.05), (0.0, 0.0, 0.4)))]
    places = chance.uniform((-0.2, -0.9, 0.0), (0.6, -0.45, 0.7), (80, 3)).tolist()
    things += [Obstacle(f"thing {k}", Box((0.02, 0.03, 0.02)), Pose((x, y, z))) for k, (x, y, z) in enumerate(places)]
    return document(planned(Scene(tuple(things))))


def test_cells_and_small_obstacles_are_shown_in_bundles(bundled: Document) -> None:
    (proof,) = bundled["sections"]["evidence"]["proofs"]
    crowd, runs = array(proof["crowd"], "<i4", 1), array(proof["pairs"], "<i4", 3)
    assert len(crowd) == 80
    assert len(runs) < 80 * len(bundled["robot"]["shapes"])
    for first, last in ((crowd.min() - 40, crowd.min()), (crowd.min(), crowd.max() + 1)):
        inside = (runs[:, 1] >= first) & (runs[:, 1] < last)
        assert runs[inside, 2].max() > 8
    shown(bundled)


def test_samples_among_cells_find_nothing_against_a_proof_by_bundles(bundled: Document) -> None:
    assert objections(bundled, 20) == []


def test_a_cloud_as_older_versions_wrote_it_is_the_same(bundled: Document) -> None:
    def older(copy: Document, proof: Document) -> None:
        (solid,) = (it["shape"] for it in copy["scene"]["obstacles"] if it["name"] == "cloud")
        steps = array(solid.pop("packed"), "<i4", 1).reshape(3, -1)
        solid["cells"] = base64.b64encode(np.cumsum(steps, axis=1, dtype="<i8").T.tobytes()).decode()
        copy["sections"]["evidence"]["version"] = 4

    shown(forged(bundled, older))


def boxes(change: Callable[[Any], Any]) -> Callable[[Document, Document], None]:
    def changed(copy: Document, proof: Document) -> None:
        those = copy["sections"]["evidence"]["boxes"]
        those["cloud"] = packed(change(array(those["cloud"], "<f8", 6)), "<f8")

    return changed


def cells(change: Callable[[Any], Any]) -> Callable[[Document, Document], None]:
    def changed(copy: Document, proof: Document) -> None:
        solid = copy["scene"]["obstacles"][0]["shape"]
        found = np.cumsum(array(solid["packed"], "<i4", 1).reshape(3, -1), axis=1).T
        solid["packed"] = packed(np.diff(change(found), axis=0, prepend=np.zeros((1, 3))).T, "<i4")

    return changed


def crowd(change: Callable[[Any], Any]) -> Callable[[Document, Document], None]:
    def changed(copy: Document, proof: Document) -> None:
        proof["crowd"] = packed(change(array(proof["crowd"], "<i4", 1)), "<i4")

    return changed


def shorter_run(copy: Document, proof: Document) -> None:
    runs = array(proof["pairs"], "<i4", 3)
    runs[runs[:, 2] > 1, 2] -= 1
    proof["pairs"] = packed(runs, "<i4")


def run_of_the_arm(copy: Document, proof: Document) -> None:
    runs = array(proof["pairs"], "<i4", 3)
    runs[0, 1:] = 1, 2
    proof["pairs"] = packed(runs, "<i4")


def cut_off(copy: Document, proof: Document) -> None:
    those = copy["sections"]["evidence"]["boxes"]
    those["cloud"] = base64.b64encode(base64.b64decode(those["cloud"])[:-4]).decode()


def followed(copy: Document, proof: Document) -> None:
    proof["crowd"] = base64.b64encode(base64.b64decode(proof["crowd"]) + b"more").decode()


def without_end(copy: Document, proof: Document) -> None:
    copy["scene"]["obstacles"][0]["shape"]["packed"] = packed(np.zeros((26_000_000, 1)), "<i4")


def swapped(rows: Any) -> Any:
    """The first and the last, which are far apart."""
    rows[[0, -1]] = rows[[-1, 0]]
    return rows


def one_for_another(rows: Any) -> Any:
    rows[0] = rows[1]
    return rows


def moved(rows: Any) -> Any:
    rows[5] += 1
    return rows


def halved(rows: Any) -> Any:
    rows[0, 3] = 0.5 * (rows[0, 0] + rows[0, 3])
    return rows


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (boxes(lambda rows: rows[1:]), "leave some of it out"),
        (boxes(lambda rows: np.concatenate([rows, rows[:1]])), "or hold more"),
        (boxes(one_for_another), "or hold more"),
        (boxes(halved), "not made of its cells"),
        (boxes(lambda rows: rows[:, [3, 4, 5, 0, 1, 2]]), "not made of its cells"),
        (boxes(lambda rows: rows * 1e12), "far away"),
        (boxes(swapped), "shown"),
        (cells(lambda rows: rows[1:]), "or hold more"),
        (cells(moved), "or hold more"),
        (cells(lambda rows: np.concatenate([rows, rows[-1:] + 1])), "leave some of it out"),
        (crowd(swapped), "shown"),
        (crowd(lambda rows: rows[:-1]), "shown"),
        (crowd(one_for_another), "twice"),
        (crowd(lambda rows: rows * 0 + np.arange(len(rows))[:, None]), "does not stand"),
        (shorter_run, "nothing is shown"),
        (run_of_the_arm, "do not stand together"),
        (cut_off, "cut off"),
        (followed, "followed by something"),
        (without_end, "too long"),
    ],
)
def test_a_forgery_of_bundles_is_refused(
    bundled: Document, change: Callable[[Document, Document], None], why: str
) -> None:
    with pytest.raises(Invalid, match=why):
        shown(forged(bundled, change))


def test_an_exemption_that_no_rule_allows_is_refused(plain: Document) -> None:
    def alone(copy: Document, proof: Document) -> None:
        for claim in (proof, copy["result"]["certificate"]):
            claim["exempt"].append({"s_start": 0.0, "s_end": 0.5, "pairs": [["link_5", "wall"]], "reason": "trust me"})

    with pytest.raises(Invalid, match=r"link_5 x wall is not judged .* no rule allows that"):
        shown(forged(plain, alone))


@pytest.mark.parametrize("bound", ["tilt", "turn", "upper"])
def test_a_region_is_shown_to_be_kept_to_a_hair_and_no_farther(plain: Document, bound: str) -> None:
    robot, waypoints = load_robot("wxai"), np.array(plain["result"]["path"]["waypoints"])
    path = JointPath(waypoints, np.array(plain["result"]["path"]["blends"]))
    aside = Pose.from_rpy((0.0, 0.0, 0.0), (0.5, 0.4, 0.0))
    T = np.array([robot.tool_pose(q) for q in path(np.linspace(0.0, path.length, 1_500))]) @ aside.matrix
    first = Pose.from_matrix(T[len(T) // 2])
    R = first.rotation.T @ T[:, :3, :3]
    across, along = R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1]
    most = {"tilt": np.arccos(R[:, 2, 2]), "turn": np.abs(np.arctan2(across, along))}.get(bound, T[:, 0, 3]).max()
    nowhere = {"position": [0.0, 0.0, 0.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    tool, turned = ({**nowhere, "quaternion_wxyz": list(at.quaternion)} for at in (aside, first))
    free: Document = {"lower": [None] * 3, "upper": [None] * 3, "tilt": None, "turn": None, "link": None}
    region = {**free, "kind": "tool region", "name": "region", "relative_to": None, "tool": tool, "frame": turned}

    def kept_to(value: float) -> Document:
        asked = {bound: value} if bound != "upper" else {bound: [value, None, None], "frame": nowhere}
        request = {**plain["request"], "constraints": [{**region, **asked}]}
        return json_of({**plain, "request": request})

    assert any("1 constraints kept" in line for line in shown(kept_to(most + 1e-4)))
    with pytest.raises(Invalid, match="region is not kept"):
        shown(kept_to(most - 1e-4))


def test_a_file_without_evidence_proves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    planned(Scene((WALL,))).save(tmp_path / "plan.json")
    for name in ("plan.json", "none.json"):
        assert main([str(tmp_path / name)]) == 1
        assert capsys.readouterr().out.startswith("INVALID: ")

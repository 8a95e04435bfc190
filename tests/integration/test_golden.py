"""Counts are pinned: equal states, edges and bits for every stored query, whatever came before, in any process."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.harness import stored, stored_roadmaps
from benchmarks.studies.states import STEPS, plan
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query
from planner_service import PlannerService, RRTConnect, Trapezoidal

CHOSEN = 5
"""Stored queries of each scene that the tests plan again; ``python -m benchmarks golden`` plans all."""

ROOT = Path(__file__).parents[2]
JOINT_STEP = "JointStep(0.02)"


def chosen(scene: str) -> tuple[Query, ...]:
    return queries.load(scene)[:CHOSEN]


@pytest.mark.parametrize("scene", queries.SCENES)
@pytest.mark.parametrize("step", STEPS)
def test_planning_a_stored_query_costs_exactly_what_is_stored(step: str, scene: str) -> None:
    changed = stored.differences(stored.load_golden()[step]["queries"], stored.golden_rows(step, scene, chosen(scene)))
    if changed:
        told = "\n  ".join(changed)
        pytest.fail(f"{step}:\n  {told}\nIf that is meant, store it, with a line in CHANGELOG.md: {stored.REGENERATE}")


def test_every_stored_query_has_stored_counts_and_a_plan() -> None:
    names = [query.name for scene in queries.SCENES for query in queries.load(scene)]
    for told in stored.load_golden().values():
        assert list(told["queries"]) == names
        assert {row["outcome"] for row in told["queries"].values()} == {"planned"}


def test_the_stored_percentiles_are_those_of_the_stored_counts() -> None:
    for told in stored.load_golden().values():
        for scene, spread in told["p50_p95"].items():
            rows = {name: row for name, row in told["queries"].items() if name.startswith(f"{scene}-")}
            assert spread == stored.spread_of(rows)


def test_the_stored_text_is_what_writing_it_again_gives() -> None:
    assert stored.text_of(stored.load_golden()) == stored.GOLDEN.read_text("utf-8")


def test_queries_planned_in_another_order_and_by_used_services_cost_the_same() -> None:
    services = {scene: PlannerService(queries.ROBOT, scene, edge_step=STEPS[JOINT_STEP]) for scene in queries.SCENES}
    mixed = [query for scene in queries.SCENES for query in chosen(scene)]
    random.Random(1).shuffle(mixed)
    rows = {}
    for query in mixed:
        service = services[query.scene]
        plan(service, queries.load(query.scene)[-1], seed=99, planner=RRTConnect(range=1.0), timing=Trapezoidal())
        rows[query.name] = stored.fingerprint(plan(service, query, timing=Trapezoidal()))
    assert stored.differences(stored.load_golden()[JOINT_STEP]["queries"], rows) == []


OTHER_CPU = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX,-AVX2,-AVX512F,-FMA,-FMA4",  # other sines and cosines, in their last bit
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX",
    "OPENBLAS_CORETYPE": "Prescott",
}


@pytest.mark.parametrize("cpu", [{}, OTHER_CPU], ids=["this CPU", "an older CPU"])
def test_another_process_plans_the_same_to_the_last_bit(cpu: dict[str, str]) -> None:
    code = (
        "import json; from benchmarks import queries, stored\n"
        f"rows = [stored.golden_rows({JOINT_STEP!r}, s, queries.load(s)[{CHOSEN - 1}::-1])"
        " for s in ('window', 'post', 'bin')]\n"
        "print(json.dumps({name: row for here in rows for name, row in here.items()}))"
    )
    # Another hash seed: an order that comes from a set would show.
    environment = {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "12345", **cpu}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert stored.differences(stored.load_golden()[JOINT_STEP]["queries"], json.loads(done.stdout)) == []


def test_a_change_is_told_stage_by_stage() -> None:
    row = {"outcome": "planned", "stages": {"search": [10, 2, 0]}, "waypoints": 3, "path": "aa"}
    other = row | {"stages": {"search": [9, 2, 0], "shortcut": [1, 1, 0]}, "path": "bb"}
    assert stored.differences({"bin-00": row}, {"bin-00": row}) == []
    assert stored.differences({"bin-00": row}, {"bin-00": other, "bin-01": row}) == [
        "bin-00: search [states, edges, distances] [10, 2, 0] -> [9, 2, 0]",
        "bin-00: shortcut [states, edges, distances] None -> [1, 1, 0]",
        "bin-00: the path's bits changed",
        "bin-01: not stored",
    ]


# --- roadmaps


def pinned_roadmaps() -> dict[str, stored.Row]:
    content: dict[str, stored.Row] = json.loads(stored_roadmaps.GOLDEN.read_text("utf-8"))
    return content


def test_roadmaps_cost_exactly_what_is_stored() -> None:
    pinned, now = pinned_roadmaps(), stored_roadmaps.golden()
    assert list(now) == list(pinned)
    changed = stored_roadmaps.changes(pinned, now)
    if changed:
        told = "\n  ".join(changed)
        pytest.fail(
            f"roadmaps:\n  {told}\nIf that is meant, store it, with a line in CHANGELOG.md: {stored.REGENERATE}"
        )


@pytest.mark.parametrize("cpu", [{}, OTHER_CPU], ids=["this CPU", "an older CPU"])
def test_another_process_has_the_same_roadmaps_to_the_last_bit(cpu: dict[str, str]) -> None:
    code = "import json; from benchmarks import stored_roadmaps; print(json.dumps(stored_roadmaps.golden(['bin'])))"
    environment = {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "12345", **cpu}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert stored_roadmaps.changes(pinned_roadmaps(), json.loads(done.stdout)) == []


def test_the_stored_text_of_roadmaps_is_what_writing_it_again_gives() -> None:
    assert stored_roadmaps.text_of(pinned_roadmaps()) == stored_roadmaps.GOLDEN.read_text("utf-8")


def test_a_change_of_a_roadmap_is_told_by_where_it_is() -> None:
    row = {"bin": {"build": {"free": 9}, "queries": {"bin-00": {"path": "aa"}}}}
    other = {"bin": {"build": {"free": 8}, "queries": {"bin-00": {"path": "aa"}, "bin-01": {"path": "bb"}}}}
    assert stored_roadmaps.changes(row, row) == []
    assert stored_roadmaps.changes(row, other) == [
        "bin build free: 9 -> 8",
        "bin queries bin-01: None -> {'path': 'bb'}",
    ]

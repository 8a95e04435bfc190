"""Counts are pinned: equal states, edges and bits for every stored query, whatever came before, in any process."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.harness import pinned_queries, pinned_roadmaps
from benchmarks.harness.pins import FOLDER, Pins, fingerprint, load_pins
from benchmarks.studies.states import STEPS, plan
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query
from planner_service import PlannerService, RRTConnect, Trapezoidal
from planner_service.certify import certifier
from planner_service.collision import native_kernel
from tests.support.pinned import require_pinned

CHOSEN = 5
"""Stored queries of each scene that the tests plan again; ``python -m benchmarks check`` plans all."""

ROOT = Path(__file__).parents[2]
JOINT_STEP = "JointStep(0.02)"


def chosen(scene: str) -> tuple[Query, ...]:
    return queries.load(scene)[:CHOSEN]


@pytest.mark.parametrize("scene", queries.SCENES)
@pytest.mark.parametrize("step", STEPS)
def test_planning_a_stored_query_costs_exactly_what_is_pinned(step: str, scene: str) -> None:
    require_pinned("queries", pinned_queries.planned(step, scene, chosen(scene)))


def test_roadmaps_cost_exactly_what_is_pinned() -> None:
    require_pinned("roadmaps", pinned_roadmaps.made())


def test_every_stored_query_is_pinned_and_has_a_plan() -> None:
    pinned = load_pins(FOLDER / "queries.json")
    names = [f"{query.name} {step}" for step in STEPS for scene in queries.SCENES for query in queries.load(scene)]
    assert list(pinned) == names
    assert {row["outcome"] for row in pinned.values()} == {"planned"}


def test_queries_planned_in_another_order_and_by_used_services_cost_the_same() -> None:
    services = {scene: PlannerService(queries.ROBOT, scene, edge_step=STEPS[JOINT_STEP]) for scene in queries.SCENES}
    mixed = [query for scene in queries.SCENES for query in chosen(scene)]
    random.Random(1).shuffle(mixed)
    rows = {}
    for query in mixed:
        service = services[query.scene]
        plan(service, queries.load(query.scene)[-1], seed=99, planner=RRTConnect(range=1.0), timing=Trapezoidal())
        rows[f"{query.name} {JOINT_STEP}"] = fingerprint(plan(service, query, timing=Trapezoidal()))
    require_pinned("queries", rows)


@pytest.mark.parametrize("instructions", native_kernel.instruction_sets())
def test_whole_plans_are_the_same_to_the_last_bit_with_every_instruction_set(
    instructions: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    proofs = certifier.instruction_sets()
    monkeypatch.setattr(native_kernel.build_kernel, "__defaults__", (instructions,))
    fitting = instructions if instructions in proofs else proofs[-1]
    monkeypatch.setattr(certifier.Prover.__init__, "__defaults__", (fitting,))
    service = PlannerService(queries.ROBOT, "clutter", edge_step=STEPS[JOINT_STEP])
    assert service.checker.instruction_set == instructions
    rows = {f"{q.name} {JOINT_STEP}": fingerprint(plan(service, q, timing=Trapezoidal())) for q in chosen("clutter")}
    require_pinned("queries", rows)


OTHER_CPU = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX,-AVX2,-AVX512F,-FMA,-FMA4",  # other sines and cosines, in their last bit
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX",
    "OPENBLAS_CORETYPE": "Prescott",
}


def printed(code: str, cpu: dict[str, str]) -> Pins:
    """What a process prints as JSON that hashes in another order (what comes from a set would show), on another CPU."""
    environment = {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "12345", **cpu}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows: Pins = json.loads(done.stdout)
    return rows


@pytest.mark.parametrize("cpu", [{}, OTHER_CPU], ids=["this CPU", "an older CPU"])
def test_another_process_plans_the_same_to_the_last_bit(cpu: dict[str, str]) -> None:
    code = (
        "import json; from benchmarks.harness import pinned_queries; from benchmarks.worlds import queries\n"
        f"rows = [pinned_queries.planned({JOINT_STEP!r}, s, queries.load(s)[{CHOSEN - 1}::-1])"
        " for s in ('window', 'post', 'bin')]\n"
        "print(json.dumps({name: row for scene in rows for name, row in scene.items()}))"
    )
    require_pinned("queries", printed(code, cpu))


def test_another_process_on_an_older_cpu_has_the_same_roadmaps_to_the_last_bit() -> None:
    code = "import json; from benchmarks.harness import pinned_roadmaps as p; print(json.dumps(p.made(['bin'])))"
    require_pinned("roadmaps", printed(code, OTHER_CPU))

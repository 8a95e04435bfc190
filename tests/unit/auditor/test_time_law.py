"""Time runs along the curve as a motion may, or the file is refused."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from auditor.__main__ import judged
from auditor.schema import Invalid
from auditor.time_law import BERNSTEIN, PLACES, exceeded, in_time
from auditor.trails import Curve
from planner_service import PlannerService, PlanRequest, SCurve, ToppRa, Trapezoidal, load_robot
from planner_service.records.evidence import with_evidence
from planner_service.records.plan_file import SavedPlan

Document = dict[str, Any]


def test_every_number_of_s_of_t_matters(plan: Document) -> None:
    law = plan["result"]["trajectory"]
    rows = [(law["durations"], k) for k in range(len(law["durations"]))]
    rows += [(row, k) for row, k in product(law["coefficients"], range(4))]
    for holder, key in [*rows, (law, "duration"), (plan["result"]["motion"], "duration")]:
        right = holder[key]
        for off in (0.05, 1e-4):
            holder[key] = right + off
            with pytest.raises(Invalid):
                list(judged(plan))
        holder[key] = right


def test_a_motion_that_is_too_fast_is_refused(plan: Document) -> None:
    law = plan["result"]["trajectory"]
    law["durations"] = [h * 0.999 for h in law["durations"]]
    law["coefficients"] = [[c / 0.999**k for k, c in enumerate(row)] for row in law["coefficients"]]
    law["duration"] *= 0.999
    plan["result"]["motion"]["duration"] *= 0.999
    with pytest.raises(Invalid, match=r"exceeds its (velocity|acceleration)"):
        list(judged(plan))


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "timing"), [("wxai", ToppRa()), ("panda", Trapezoidal()), ("scara", SCurve())])
def test_right_motions_of_every_law_are_shown(robot: str, timing: Any) -> None:
    import json

    arm = load_robot(robot)
    service, chance = PlannerService(arm, "empty"), np.random.default_rng(3)
    done = 0
    while done < 3:
        q = chance.uniform(arm.limits.lower, arm.limits.upper, (2, arm.n))
        asked = PlanRequest(
            q[0], q[1], timing=timing, velocity_scale=0.5, seed=done, time_limit=None, max_checks=20_000
        )
        found = service.plan(asked)
        if found.ok:
            done += 1
            lines = list(judged(json.loads(with_evidence(SavedPlan.of(found)).file_text())))
            assert any("s(t)" in line and "50% and 100%" in line for line in lines)


def cornered(blend: float) -> tuple[Document, Any]:
    """A right angle of two joints with a blend, which may be too narrow to be driven round, and who checks s(t)."""
    curve = Curve(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), [0.0, blend, 0.0])
    limits = {"velocity": [1.0, 1.0], "acceleration": [10.0, 10.0]}
    law = {"durations": [], "coefficients": [], "duration": 0.0, "part": None, "dilation": 1.0}
    result = {"trajectory": law, "path": {"length": 2.0}, "motion": {"duration": 0.0}}
    return result, lambda: in_time({"limits": limits}, result, None, curve)


def pieces(result: Document, rows: list[tuple[float, list[float]]]) -> None:
    law = result["trajectory"]
    law["durations"], law["coefficients"] = [h for h, _ in rows], [c for _, c in rows]
    law["duration"] = result["motion"]["duration"] = sum(law["durations"])


def test_a_corner_that_is_hardly_rounded_is_a_stop() -> None:
    result, check = cornered(4e-9)
    ramp = [(1.0, [0.0, 0.0, 0.5, 0.0]), (0.5, [0.5, 1.0, 0.0, 0.0]), (0.5, [1.0, 1.0, 0.0, 0.0])]
    pieces(result, [*ramp, (1.0, [1.5, 1.0, -0.5, 0.0])])
    with pytest.raises(Invalid, match="does not rest at the corner at s = 1"):
        check()


def test_a_blend_that_is_crossed_unevenly_is_bounded_where_it_is_fastest() -> None:
    """One cubic from 0.7 to 1.3 with slopes 4 and 1 has control points beyond the blend."""
    result, _ = cornered(0.3)
    first, last, h = 0.7, 1.3, 1.0
    a, b = 2.4, 0.6  # ds/dt at both ends
    across = [first, a, 3 * (last - first) - 2 * a - b, a + b - 2 * (last - first)]
    up = [(2 * first / a, [0.0, 0.0, a * a / (4 * first), 0.0])]
    down = [(2 * (2.0 - last) / b, [last, b, -b * b / (4 * (2.0 - last)), 0.0])]
    t = np.linspace(0, h, 20_001)
    s = np.polynomial.Polynomial(across)(t)
    y = (s - 1.0) / 0.3
    f, slope = 0.5 + (5 * y - y**5) / 8, 5 / 8 * (1 - y**4) / 0.3
    ds, dds = np.polynomial.Polynomial(across).deriv(1)(t), np.polynomial.Polynomial(across).deriv(2)(t)
    most = max(np.abs((1 - f) * dds - slope * ds**2).max(), np.abs(f * dds + slope * ds**2).max())
    pieces(result, [*up, (h, across), *down])
    for share, passes in ((1.01, True), (0.99, False)):
        limits = {"velocity": [9.0, 9.0], "acceleration": [most * share] * 2}
        curve = Curve(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), [0.0, 0.3, 0.0])
        if passes:
            assert "within the limits" in in_time({"limits": limits}, result, None, curve)[0]
        else:
            with pytest.raises(Invalid, match="exceeds its acceleration"):
                in_time({"limits": limits}, result, None, curve)


def test_a_limit_is_exceeded_where_the_polynomial_is_beyond_it_and_nowhere_else() -> None:
    chance, t = np.random.default_rng(1), np.linspace(0, 1, 20_001)
    for _ in range(300):
        p = np.polynomial.Polynomial(chance.normal(size=int(chance.integers(2, 19))))
        coefficients, most = BERNSTEIN @ p(PLACES), np.abs(p(t)).max()
        assert exceeded(coefficients[None, :, None], np.array([most * 1.001])) is None
        assert exceeded(coefficients[None, :, None], np.array([most * 0.999])) == 0

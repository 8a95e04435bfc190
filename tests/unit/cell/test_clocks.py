"""What is proven of two clocks is free wherever they can be, by samples; and little that is free is not proven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner_service import InvalidRequest, PlannerService, PlanRequest, load_robot
from planner_service.cell.clocks import Between, Clock, Turned, best_start, between_arms, tolerated
from planner_service.geometry.arrays import BoolArray, FloatArray

DUAL = load_robot("wxai_dual")
LEFT, RIGHT = list(range(6)), list(range(6, 12))
SAMPLES = 120


def there(left: float, right: float) -> FloatArray:
    """Both arms reach out, turned by so much."""
    return np.array([left, 1.4, 1.2, -0.8, 0.0, 0.0, right, 1.4, 1.2, -0.8, 0.0, 0.0])


class Diagram:
    """Two motions, and whether the arms are apart at (t_1, t_2), by FCL at samples.

    Args:
        left: From where to where the left arm turns; ``right`` likewise.
    """

    def __init__(self, left: tuple[float, float], right: tuple[float, float], scale: float) -> None:
        self.clocks, curves = list[Clock](), list[FloatArray]()
        for columns, (start, goal), slow in ((LEFT, left, scale), (RIGHT, right, 1.0)):
            still = RIGHT if columns is LEFT else LEFT
            arm = PlannerService(DUAL.locked({DUAL.joint_names[k]: float(DUAL.home[k]) for k in still}), "empty")
            begin, end = (there(turn, turn)[columns] for turn in (start, goal))
            trajectory = arm.plan(PlanRequest(begin, end, velocity_scale=slow)).unwrap()[1]
            self.clocks.append(Clock.of(trajectory, columns))
            curves.append(trajectory(np.linspace(0.0, trajectory.duration, SAMPLES)))
        one, two = (frozenset(s.link for s in DUAL.shapes if s.link.startswith(side)) for side in ("left", "right"))
        self.certifier = certifier = between_arms(DUAL, one, two, still=())
        self.between = Between(certifier, self.clocks[0], self.clocks[1], DUAL.home)
        checker = PlannerService(DUAL, "empty").checker
        rows = [np.concatenate([a, b]) for a in curves[0] for b in curves[1]]
        self.free = np.array([checker.state_is_free(q) for q in rows]).reshape(SAMPLES, SAMPLES)
        self.times = [np.linspace(0.0, clock.duration, SAMPLES) for clock in self.clocks]

    def met(self, lead: float, delay: float) -> BoolArray:
        """The samples that arms pass that start with this lead and are late by 0 or ``delay``, or anything between."""
        on = np.zeros((SAMPLES, SAMPLES), dtype=bool)
        t = np.linspace(min(0.0, lead), sum(times[-1] for times in self.times) + abs(lead) + delay, 4000)
        for first, second in ((0.0, 0.0), (delay, 0.0), (0.0, delay), (delay, delay), (0.5 * delay, 0.0)):
            at = t - first - max(0.0, -lead), t - second - max(0.0, lead)
            i, j = (
                np.rint(np.clip(own, 0.0, times[-1]) / times[1]).astype(int)
                for own, times in zip(at, self.times, strict=True)
            )
            on[i, j] = True
        return on


@pytest.fixture(
    scope="module",
    params=[
        ((-0.6, 0.5), (-0.5, 0.6)),
        ((0.5, -0.9), (0.9, -0.5)),
        ((-0.7, -0.5), (-0.5, 0.6)),
        ((0.2, -1.2), (-0.2, 1.2)),
        ((0.5, -2.9), (0.9, -0.5)),
        ((-0.9, 0.5), (-0.5, 2.9)),
        ((0.5, -0.9), (2.9, -0.5)),
        ((-2.9, 0.5), (-0.5, 0.9)),
    ],
    ids=[
        *("leaves and comes", "comes and leaves", "stays in the way", "both end in the way"),
        *("sweeps a start", "its start is swept", "its end is swept", "sweeps an end"),
    ],
)
def diagram(request: pytest.FixtureRequest) -> Diagram:
    left, right = request.param
    return Diagram(left, right, scale=0.1)


def test_what_is_proven_is_free_at_samples(diagram: Diagram) -> None:
    rng, proven, refused = np.random.default_rng(4), 0, 0
    longest = sum(clock.duration for clock in diagram.clocks)
    assert not diagram.free.all()
    for _ in range(250):
        lead, delay = rng.uniform(-longest, longest), rng.choice([0.0, 0.05, 0.3])
        free = not len(diagram.between.in_the_way(lead, delay))
        touched = bool((diagram.met(lead, delay) & ~diagram.free).any())
        assert not (free and touched), f"lead {lead}, delay {delay}"
        proven, refused = proven + free, refused + (not free)
    assert refused


def test_a_rectangle_that_is_proven_is_free_at_all_its_samples(diagram: Diagram) -> None:
    for level in (4, 7):
        proven = diagram.between.proven(level)
        at = np.linspace(0.0, 1 << level, SAMPLES)
        within = [np.minimum(at.astype(int), (1 << level) - 1), np.maximum(np.ceil(at).astype(int) - 1, 0)]
        for rows in within:  # a sample on a line is on both sides of it
            for columns in within:
                assert diagram.free[proven[np.ix_(rows, columns)]].all()
        assert proven.mean() > (0.3 if level == 4 else 0.9) * diagram.free.mean()


def test_a_diagram_seen_from_the_other_arm_is_the_same(diagram: Diagram) -> None:
    longest, turned = sum(clock.duration for clock in diagram.clocks), Turned(diagram.between)
    for lead in np.linspace(-longest, longest, 60):
        forth, back = diagram.between.in_the_way(lead, 0.05), turned.in_the_way(-lead, 0.05)
        assert np.array_equal(forth, -back[:, ::-1])


def test_what_is_no_pair_of_motions_is_refused(diagram: Diagram) -> None:
    certifier, (first, second) = diagram.certifier, diagram.clocks
    with pytest.raises(InvalidRequest, match="second"):
        certifier.diagram(first, first, DUAL.home)
    with pytest.raises(InvalidRequest, match="still"):
        certifier.diagram(first, second, DUAL.home[:3])
    with pytest.raises(InvalidRequest, match="first"):
        certifier.diagram(replace(first, q=first.q + 10.0), second, DUAL.home)
    with pytest.raises(InvalidRequest, match="padding"):
        certifier.diagram(first, second, DUAL.home, padding=-1.0)


def test_a_start_is_the_first_that_is_free(diagram: Diagram) -> None:
    longest = sum(clock.duration for clock in diagram.clocks)
    wait = best_start([(diagram.between, 0.0)], 0.0, longest)
    leads = np.linspace(0.0, longest, 400)
    free = [lead for lead in leads if not (diagram.met(lead, 0.0) & ~diagram.free).any()]
    if wait is None:
        assert not free
        return
    assert not len(diagram.between.in_the_way(wait, 0.0))
    step = sum(times[1] for times in diagram.times) + leads[1]
    assert free
    assert free[0] - step <= wait <= free[0] + 0.1 * longest


def test_what_is_tolerated_is_proven_and_not_much_less_than_what_is_free(diagram: Diagram) -> None:
    longest = sum(clock.duration for clock in diagram.clocks)
    wait = best_start([(diagram.between, 0.0)], 0.05, longest)
    if wait is None:
        return
    late = tolerated(diagram.between, wait + 0.2, 0.0)
    assert late >= 0.2 + 0.05 - 0.002
    assert not len(diagram.between.in_the_way(wait + 0.2, late))

"""What a gate lets pass is free wherever the arm can be, with a stop behind it; what it refuses, it names."""

from __future__ import annotations

import gc
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import PlannerService
from planner_service.certify.certifier import TubeProof
from planner_service.collision import CollisionChecker, JointStep
from planner_service.constraints import KeepUpright
from planner_service.errors import InvalidRequest
from planner_service.gate import ActionGate, Kind, Setpoint, Tracking, Verdict
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose, Sphere
from planner_service.scene.scene import Attached, Obstacle, Scene
from tests.unit.certify.test_certifier import BALL, PLANAR, ball_beyond

TRACKING = Tracking(goal_time=0.1, error=0.002, jitter=0.004)
RATE = 30.0
START = np.array([-0.5, 0.0])
STEP = np.array([0.01, 0.0])


def gate_of(scene: Scene, tracking: Tracking = TRACKING, **options: Any) -> ActionGate:
    return ActionGate(PlannerService(PLANAR, scene), rate=RATE, tracking=tracking, **options)


def ramp(count: int, start: FloatArray = START, step: FloatArray = STEP) -> FloatArray:
    """Targets that get faster, up to ``step`` each period."""
    speeds = np.minimum(np.arange(1, count + 1) / 10.0, 1.0)
    return np.asarray(start + np.cumsum(speeds)[:, None] * step)


def colliding(gate: ActionGate, start: FloatArray, rows: FloatArray, draws: int, seed: int) -> int:
    """At how many of the configurations that a simulated arm passes something touches; each run draws its latencies.

    Its joints are as far off as they may be.
    """
    checker = CollisionChecker(gate.robot, gate.service.scene, edge_step=JointStep(0.002))
    rng, tracking, n = np.random.default_rng(seed), gate.tracking, gate.robot.n
    setpoint = start + tracking.of(n) * rng.uniform(-1.0, 1.0, (draws, n))
    touching = 0
    for target in rows:
        for share in (0.3, 1.0):
            wait = 1.0 / RATE + tracking.jitter * rng.uniform(-1.0, 1.0, (draws, 1))
            now = setpoint + np.minimum(share * wait / tracking.goal_time, 1.0) * (target - setpoint)
            arm = now + tracking.of(n) * rng.choice([-1.0, 1.0], now.shape)
            touching += sum(not checker.state_is_free(q) for q in np.clip(arm, *gate.robot.bounds))
        setpoint = now
    return touching


def test_a_free_chunk_passes_as_it_is_with_a_stop_behind_it() -> None:
    gate = gate_of(ball_beyond(0.1))
    chunk = ramp(20)
    verdict = gate.check(START, chunk)
    assert verdict.ok
    assert verdict.proven
    np.testing.assert_array_equal(verdict.targets, chunk)
    assert len(verdict.stop) >= 1
    np.testing.assert_array_equal(verdict.rows, np.concatenate([chunk, verdict.stop]))


@pytest.mark.parametrize("error", [0.0, 0.002, 0.05])
def test_a_chunk_into_an_obstacle_passes_in_part_and_what_passes_touches_nothing(error: float) -> None:
    gate = gate_of(ball_beyond(-0.05), replace(TRACKING, error=error))
    verdict = gate.check(START, ramp(90))
    assert verdict.refused is not None
    assert verdict.refused.kind in (Kind.CONTACT, Kind.STOP)
    assert verdict.refused.pair is not None
    assert set(verdict.refused.pair) == {"forearm", "ball"}
    assert 20 < verdict.accepted < 70
    assert verdict.refused.index == verdict.accepted
    assert verdict.refused.time == pytest.approx(verdict.accepted / RATE)
    assert colliding(gate, START, verdict.rows, draws=20, seed=1) == 0


def touching_angle(scene: Scene) -> float:
    """Of the shoulder of an outstretched arm that comes from below."""
    checker, low, high = CollisionChecker(PLANAR, scene), -0.5, 0.123
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if checker.state_is_free([middle, 0.0]) else (low, middle)
    return low


def test_who_comes_early_may_still_go_where_the_last_target_was() -> None:
    """However close an obstacle is beside that way: it was proven to its end, nothing coming after it.

    The tip goes towards a ball aside of its way. What brakes the arm is not proven from there,
    since it does not go on along the same line.
    """
    early, way = 0.54 / RATE, np.array([-0.024, 0.049])
    middle = np.array([0.2, 1.2])
    start = middle - early / TRACKING.goal_time * way
    tip, then = (PLANAR.tool_pose(middle + share * way)[:2, 3] for share in (0.0, 1e-6))
    going = then - tip
    aside = np.array([going[1], -going[0]]) / np.linalg.norm(going)
    aside = aside if aside @ tip > 0.0 else -aside
    beyond = 0.036 * going / np.linalg.norm(going)
    tracking, low, high = replace(TRACKING, error=0.02), 0.0, 0.5

    def passed(gap: float) -> tuple[ActionGate, bool]:
        ball = Obstacle("ball", Sphere(BALL), Pose((*(tip + beyond + (BALL + gap) * aside).tolist(), 0.0)))
        gate = gate_of(Scene((ball,)), tracking, acceleration_scale=10.0)
        gate.reset(start)
        return gate, gate.check(start, start + way).ok

    for _ in range(40):
        half = 0.5 * (low + high)
        low, high = (low, half) if passed(half)[1] else (half, high)
    gate, ok = passed(high)
    assert ok
    assert 0.001 < high < 0.2
    verdict = gate.check(start + early / TRACKING.goal_time * way, start + 9.0, elapsed=early)
    assert (verdict.accepted, verdict.proven) == (0, True)


def test_an_arm_that_is_measured_at_rest_may_have_been_sent_a_bit_beside_that() -> None:
    """So much may be between what is measured and its setpoint, and as much between that and the arm later."""
    scene, error = ball_beyond(-0.05), 0.05
    near = touching_angle(scene)
    for away, known, passes in ((1.5, False, False), (1.5, True, True), (2.5, False, True), (0.5, True, False)):
        start = np.array([near - away * error, 0.0])
        gate = gate_of(scene, replace(TRACKING, error=np.array([error, 0.0])))
        gate.reset(start if known else None)
        assert gate.check(start, start).ok == passes


def test_an_arm_that_may_be_too_fast_on_its_way_to_where_it_is_measured_is_not_taken() -> None:
    fastest = float(PLANAR.limits.velocity.max()) * TRACKING.goal_time
    assert fastest < 0.5
    gate = gate_of(ball_beyond(0.1), replace(TRACKING, error=1.01 * fastest))
    with pytest.raises(InvalidRequest, match="error"):
        gate.check(START, START)
    gate.reset(START)
    assert gate.check(START, START).ok
    slower = gate_of(ball_beyond(0.1), replace(TRACKING, error=0.99 * fastest))
    assert slower.check(START, START).ok


def test_the_stop_keeps_the_limits_of_speed_and_acceleration_and_ends_at_rest() -> None:
    gate = gate_of(ball_beyond(0.1))
    verdict = gate.check(START, ramp(30, step=np.array([0.01, 0.02])))
    assert verdict.ok
    assert within_limits(verdict.rows, START)


@pytest.mark.parametrize(
    ("chunk", "kind", "index"),
    [
        ([0.5, 0.0], Kind.SPEED, 0),
        ([-0.45, 0.0], Kind.ACCELERATION, 0),
        ([START, [8.5, 0.0]], Kind.LIMIT, 1),
        ([START, START, [np.nan, 0.0]], Kind.NUMBER, 2),
        ([START, [0.0, -np.inf]], Kind.NUMBER, 1),
        ([START, [0.0, 1e308]], Kind.LIMIT, 1),
    ],
)
def test_a_refusal_names_kind_target_and_joint(chunk: Any, kind: Kind, index: int) -> None:
    gate = gate_of(ball_beyond(0.1))
    verdict = gate.check(START, chunk)
    assert verdict.refused is not None
    assert (verdict.refused.kind, verdict.refused.index) == (kind, index)
    assert verdict.refused.joint in PLANAR.joint_names
    assert verdict.accepted == index
    assert gate.counts.refused == {kind.value: 1}


def steps(gate: ActionGate, targets: FloatArray) -> list[Verdict]:
    """Verdicts on targets one by one, with a driver that does as it is assumed to."""
    setpoint, found = START, []
    for target in targets:
        verdict = gate.check(setpoint, target)
        found.append(verdict)
        row = verdict.rows[0]
        setpoint = setpoint + (1.0 / RATE) / TRACKING.goal_time * (row - setpoint)
    return found


def test_one_target_at_a_time_ends_at_rest_before_the_obstacle() -> None:
    gate = gate_of(ball_beyond(-0.05))
    found = steps(gate, ramp(90))
    assert found[0].ok
    assert not found[-1].ok
    assert all(each.proven for each in found)
    last = found[-1].rows[-1]
    assert START[0] < last[0] < 0.123
    assert CollisionChecker(PLANAR, ball_beyond(-0.05)).state_is_free(last)


def test_an_arm_that_is_not_where_it_can_be_is_stopped_until_reset() -> None:
    gate = gate_of(ball_beyond(0.1))
    assert gate.check(START, ramp(5)).ok
    there = ramp(5)[-1]
    lost = gate.check(there + 0.1, there)
    assert lost.refused is not None
    assert (lost.refused.kind, lost.proven, lost.accepted) == (Kind.TRACKING, False, 0)
    assert PLANAR.joint_names[0] in lost.refused.detail
    assert gate.check(lost.rows[-1], there).refused is not None
    gate.reset()
    assert gate.check(there, there).ok


def test_a_measurement_that_is_no_number_counts_as_lost() -> None:
    gate = gate_of(ball_beyond(0.1))
    assert gate.check(START, ramp(5)).ok
    verdict = gate.check([np.nan, 0.0], ramp(5))
    assert verdict.refused is not None
    assert verdict.refused.kind is Kind.TRACKING


def test_a_changed_scene_cuts_what_is_left_to_send() -> None:
    gate = gate_of(ball_beyond(0.1))
    chunk = ramp(90)
    assert gate.check(START, chunk).ok
    verdict = gate.update(ball_beyond(-0.05), sent=10)
    assert 0 < verdict.accepted < 70
    assert verdict.proven
    np.testing.assert_array_equal(verdict.targets, chunk[10 : 10 + verdict.accepted])
    assert colliding(gate, START, np.concatenate([chunk[:10], verdict.rows]), draws=20, seed=2) == 0


def test_a_scene_that_leaves_no_stop_stops_the_arm_now_and_says_that_this_is_not_proven() -> None:
    gate = gate_of(ball_beyond(0.1))
    assert gate.check(START, ramp(90)).ok
    verdict = gate.update(ball_beyond(-0.05, angle=START[0]), sent=0, elapsed=0.0)
    assert (verdict.accepted, verdict.proven) == (0, False)
    np.testing.assert_allclose(verdict.rows, START[None], atol=1e-9)


def test_what_is_proven_in_a_changed_scene_is_free_in_it_wherever_the_change_is() -> None:
    """A ball comes somewhere ahead of an arm that moves, also between where it is and its last target."""
    proven = []
    for angle in np.linspace(-0.4, 0.6, 60).tolist():
        gate, setpoint = gate_of(ball_beyond(0.1, angle=2.0), replace(TRACKING, error=0.0)), START
        for row in gate.check(START, ramp(60, step=2.0 * STEP)).rows[:30]:
            setpoint = setpoint + (1.0 / RATE) / TRACKING.goal_time * (row - setpoint)
        scene = ball_beyond(-0.01, angle=angle)
        verdict = gate.update(scene, sent=30)
        proven.append(verdict.proven)
        if verdict.proven:
            checker = CollisionChecker(PLANAR, scene, edge_step=JointStep(0.002))
            assert checker.edge_is_free(setpoint, verdict.rows[0])
            assert colliding(gate, setpoint, verdict.rows, draws=5, seed=4) == 0
    assert 10 < sum(proven) < 55


def within_limits(rows: FloatArray, start: FloatArray) -> bool:
    """Whether a driver that gets rows in time keeps the limits of speed and acceleration, and ends at rest."""
    places, share = [start], (1.0 / RATE) / TRACKING.goal_time
    for row in rows:
        places.append(places[-1] + share * (row - places[-1]))
    still = np.zeros((1, 2))
    speeds = np.concatenate([still, (rows - np.array(places[:-1])) / TRACKING.goal_time, still])
    fast = np.abs(speeds) <= PLANAR.limits.velocity
    hard = np.abs(np.diff(speeds, axis=0)) * RATE <= PLANAR.limits.acceleration * (1.0 + 1e-6)
    return bool(fast.all() and hard.all())


def test_too_fast_a_chunk_is_followed_more_slowly_along_its_line_where_that_is_wanted() -> None:
    gate = gate_of(ball_beyond(0.1), slow=True)
    chunk = START + np.linspace(0.0, 1.0, 31)[1:, None] * [1.5, -0.7]
    verdict = gate.check(START, chunk)
    assert verdict.refused is None
    assert 0.3 < verdict.speed < 1.0
    assert not verdict.ok
    assert gate.counts.slowed == 1
    assert within_limits(verdict.rows, START)
    done = (verdict.targets - START)[:, 0] / 1.5
    np.testing.assert_allclose(verdict.targets, START + done[:, None] * [1.5, -0.7], atol=1e-12)
    assert np.all(np.diff(done) > 0.0)
    assert done[-1] == pytest.approx(verdict.speed)


def test_a_jump_is_refused_and_not_slowed_down() -> None:
    gate = gate_of(ball_beyond(0.1), slow=True)
    verdict = gate.check(START, [2.5, 0.0])
    assert verdict.refused is not None
    assert (verdict.refused.kind, verdict.accepted, gate.counts.slowed) == (Kind.SPEED, 0, 0)


@pytest.mark.parametrize("name", ["jerk", "torque"])
def test_jerks_and_torques_are_judged_where_that_is_wanted(name: str) -> None:
    """At a thousandth of what the arm may take, its own weight, or a first small step, is too much."""
    service = PlannerService("wxai", Scene())
    start = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    for scale, kind in ((None, None), (1.0, None), (0.001, name)):
        scales: dict[str, Any] = {f"{name}_scale": scale}
        gate = ActionGate(service, rate=RATE, tracking=TRACKING, **scales)
        gate.reset(start)
        verdict = gate.check(start, start + 1e-4)
        assert (verdict.refused.kind.value if verdict.refused else None) == kind


def test_torques_are_judged_with_what_a_changed_scene_has_in_the_gripper() -> None:
    """Nothing is left for a load of 100 kg, and all is well again without it; a wrong call changes nothing."""
    service, start = PlannerService("wxai", Scene()), np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    heavy = Scene(attached=(Attached("load", Box((0.01, 0.01, 0.01)), Pose((0.06, 0.0, 0.0)), mass=100.0),))
    gate = ActionGate(service, rate=RATE, tracking=TRACKING, torque_scale=1.0)
    gate.update(heavy)  # before the first check
    verdict = gate.check(start, start)
    assert verdict.refused is not None
    assert verdict.refused.kind is Kind.TORQUE
    gate.reset(start)
    gate.update(Scene())
    assert gate.check(start, start).ok
    with pytest.raises(InvalidRequest, match="sent"):
        gate.update(heavy, sent=100)
    assert gate.check(start, start).ok
    gate.update(heavy)
    verdict = gate.check(start, start)
    assert verdict.refused is not None
    assert verdict.refused.kind is Kind.TORQUE


def test_a_stop_takes_no_more_torque_than_targets_may() -> None:
    """Where braking as hard as the acceleration allows would, fewer targets pass, as none that goes fast can stop."""
    service, start = PlannerService("wxai", Scene()), np.array([0.0, 0.5, 0.9, 0.0, 0.0, 0.0])
    rows = ramp(20, start, np.array([0.0, 0.03, 0.0, 0.0, 0.0, 0.0]))

    def passed(scale: float) -> tuple[int, float, float]:
        """How many targets, and the largest share of the efforts that they take, and that the stop takes."""
        gate = ActionGate(service, rate=RATE, tracking=TRACKING, torque_scale=scale)
        gate.reset(start)
        verdict, torques = gate.check(start, rows), gate.limits.torques
        assert verdict.proven
        assert torques is not None
        place, before, taken = start, np.zeros(6), [0.0]
        for target in verdict.rows:
            speed = (target - place) / TRACKING.goal_time
            found = torques.torques(place[None], speed[None], (speed - before)[None] * RATE)[0]
            taken.append(float(np.abs(scale * found / torques.limit).max()))
            place, before = place + speed / RATE, speed
        k = verdict.accepted
        return k, max(taken[: k + 1]), max(taken[k + 1 :], default=0.0)

    many, of_targets, of_stop = passed(1.0)
    assert many == len(rows)
    assert of_targets < of_stop
    scale = 0.5 * (of_targets + of_stop)
    few, _, least = passed(scale)
    assert few < many
    assert least <= scale


def test_what_is_carried_with_constraints_is_refused_since_they_would_not_be_kept() -> None:
    cup = Attached("cup", Sphere(0.01), Pose((0.1, 0.0, 0.0)), constraints=(KeepUpright((0.0, 0.0, 1.0), 0.1),))
    upright, free = Scene((), (cup,)), Scene((), (replace(cup, constraints=()),))
    with pytest.raises(InvalidRequest, match="cup"):
        gate_of(upright)
    gate = gate_of(ball_beyond(0.1))
    assert gate.check(START, ramp(20)).ok
    with pytest.raises(InvalidRequest, match="cup"):
        gate.update(upright, sent=1)
    assert gate.check(START, ramp(20), sent=0).ok  # as if it had not been called
    assert gate.update(free).proven


def test_a_stop_that_would_take_thousands_of_targets_is_none() -> None:
    limits, start = gate_of(ball_beyond(0.1)).limits, Setpoint.at_rest(START, np.zeros(2))
    assert limits.braking(replace(start, speed=np.array([1e9, 0.0]))) is None
    rows = limits.braking(replace(start, speed=np.array([1.0, 0.0])))
    assert rows is not None
    assert len(rows) == 1.0 * RATE / PLANAR.limits.acceleration[0]


@pytest.mark.parametrize("on", [True, False])
def test_no_garbage_is_collected_within_a_check_and_as_before_after_it(
    on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, within = gate_of(ball_beyond(0.1)), list[bool]()
    prove = gate.certifier.certify_tubes

    def seen(*arguments: Any, **options: Any) -> TubeProof:
        within.append(gc.isenabled())
        return prove(*arguments, **options)

    monkeypatch.setattr(gate.certifier, "certify_tubes", seen)
    try:
        (gc.enable if on else gc.disable)()
        assert gate.check(START, ramp(50)).ok
        assert gc.isenabled() == on
        with pytest.raises(InvalidRequest):
            gate.check(START, "x")
        assert gc.isenabled() == on
    finally:
        gc.enable()
    assert within == [False, False]


LAGGING = Tracking(goal_time=0.1, error=0.002, jitter=0.004, lag=0.15)


@pytest.mark.parametrize(("late", "lost"), [(0, False), (2, False), (4, False), (9, True)])
def test_an_arm_may_be_as_late_as_its_lag(late: int, lost: bool) -> None:
    gate = ActionGate(PlannerService(PLANAR, ball_beyond(0.1)), rate=RATE, tracking=LAGGING)
    places, share = [START], (1.0 / RATE) / TRACKING.goal_time
    for target in ramp(30):
        verdict = gate.check(places[max(len(places) - 1 - late, 0)], target)
        if not verdict.ok:
            break
        places.append(places[-1] + share * (verdict.rows[0] - places[-1]))
    assert (verdict.refused is not None and verdict.refused.kind is Kind.TRACKING) == lost


def test_a_scene_that_changes_where_a_late_arm_may_still_be_stops_it() -> None:
    """A ball comes where the setpoint has been: an arm without lag has passed it, one with lag may not have."""

    def proven(tracking: Tracking, angle: float) -> bool:
        gate = ActionGate(PlannerService(PLANAR, ball_beyond(0.1, angle=2.0)), rate=RATE, tracking=tracking)
        assert gate.check(START, ramp(90)).ok
        return gate.update(ball_beyond(-0.01, angle=angle), sent=50).proven

    angles = np.linspace(-0.3, 0.2, 26).tolist()
    there, late = [proven(TRACKING, angle) for angle in angles], [proven(LAGGING, angle) for angle in angles]
    assert all(one or not other for one, other in zip(there, late, strict=True))
    assert sum(late) + 3 <= sum(there) < len(angles)


def test_a_chunk_that_is_refused_leaves_what_is_left_of_the_last_as_the_stop_where_no_other_is_free() -> None:
    """So there is always a proven stop, whatever is asked for next."""
    gate = gate_of(ball_beyond(-0.05))
    first = gate.check(START, ramp(90))
    rows = first.rows
    at = START - 0.3
    for sent in range(1, len(rows)):
        fresh = gate_of(ball_beyond(-0.05))
        assert fresh.check(START, ramp(90)).accepted == first.accepted
        setpoint = START
        for row in rows[:sent]:
            setpoint = setpoint + (1.0 / RATE) / TRACKING.goal_time * (row - setpoint)
        verdict = fresh.check(setpoint, at, sent=sent)
        assert verdict.proven
        assert not verdict.accepted


def test_what_is_refused_or_changed_is_in_the_log_and_nothing_else(tmp_path: Path) -> None:
    log = tmp_path / "gate.jsonl"
    gate = gate_of(ball_beyond(-0.05), slow=True, log=log)
    gate.check(START, ramp(3))
    gate.check(START, ramp(90), sent=0)
    gate.check(START, [START], sent=0)
    gate.check(START, np.array([[-0.48, 0.0], [-0.46, 0.0]]), sent=0)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert len(lines) == sum(gate.counts.refused.values()) + gate.counts.slowed
    assert (len(lines), lines[1]["speed"] < 1.0) == (2, True)
    assert lines[0]["kind"] in ("contact", "stop")
    assert set(lines[0]["pair"]) == {"forearm", "ball"}
    assert lines[0]["index"] == lines[0]["accepted"]
    assert gate.counts.unlogged == 0


def test_a_log_that_cannot_be_written_any_more_stops_nobody_and_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = gate_of(ball_beyond(0.1), log=tmp_path / "gate.jsonl")
    monkeypatch.setattr("planner_service.gate.log.MAX_LOG", 10)
    assert gate.check(START, [0.5, 0.0]).refused
    assert (gate.counts.unlogged, (tmp_path / "gate.jsonl").read_bytes()) == (1, b"")
    (tmp_path / "gate.jsonl").unlink()
    (tmp_path / "gate.jsonl").mkdir()
    assert gate.check(START, [0.5, 0.0]).refused
    assert gate.counts.unlogged == 2


def test_a_log_is_appended_to_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InvalidRequest, match="notes"):
        gate_of(ball_beyond(0.1), log=tmp_path / "notes.txt")


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"q": [0.0], "chunk": START}, "q"),
        ({"q": START, "chunk": []}, "chunk"),
        ({"q": START, "chunk": "x"}, "chunk"),
        ({"q": START, "chunk": START, "sent": 1}, "sent"),
        ({"q": START, "chunk": START, "elapsed": -1.0}, "elapsed"),
        ({"q": [np.nan, 0.0], "chunk": START}, "q"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidRequest, match=field):
        gate_of(ball_beyond(0.1)).check(**arguments)

"""What is remembered of motions: a value of bounded size, and hints that depend on nothing else."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.memory import Memory
from planner_service.memory.memory import MAX_GRIPS, MAX_MOTIONS, gripped_near, hints

JOINTS = ("j0", "j1")


def motion(*rows: tuple[float, float]) -> FloatArray:
    return np.array(rows)


BEND = motion((0.0, 0.0), (1.0, 0.5), (2.0, 0.0))


def knowing(*motions: FloatArray) -> Memory:
    memory = Memory()
    for each in motions:
        memory = memory.with_motion(each, JOINTS)
    return memory


def test_a_motion_is_a_hint_between_nearby_ends_forwards_and_backwards() -> None:
    memory = knowing(BEND)
    (forwards,) = hints(memory, np.array([0.1, 0.0]), [np.array([9.0, 9.0]), np.array([2.0, 0.1])])
    assert forwards.inner.tolist() == [[1.0, 0.5]]
    assert forwards.goal == 1
    (backwards,) = hints(knowing(motion((0.0, 0.0), (1.0, 0.5), (1.5, 0.5), (2.0, 0.0))), BEND[-1], [BEND[0]])
    assert backwards.inner.tolist() == [[1.5, 0.5], [1.0, 0.5]]
    assert hints(memory, np.array([0.0, 0.0]), [np.array([3.0, 0.0])]) == []
    assert hints(Memory(), BEND[0], [BEND[-1]]) == []


def test_the_nearest_motions_come_first_and_of_equal_ones_the_newest() -> None:
    def bent(x: float, y: float) -> FloatArray:
        return motion((x, 0.0), (1.0, y), (2.0, 0.0))

    near, nearer, newer = bent(0.2, 1.0), bent(0.1, 2.0), bent(-0.1, 3.0)
    known = hints(knowing(near, nearer, newer), BEND[0], [BEND[-1]])
    assert [hint.inner[0, 1] for hint in known] == [3.0, 2.0, 1.0]


def test_a_motion_between_the_same_ends_takes_the_place_of_the_one_before() -> None:
    memory = knowing(BEND, BEND + np.array([5.0, 0.0]), motion((0.01, 0.0), (1.0, 0.7), (2.0, 0.01)))
    assert [each[1, 1] for each in memory.motions] == [0.5, 0.7]


def test_a_memory_forgets_what_was_unused_longest() -> None:
    memory = Memory(JOINTS, tuple(motion((k, 0.0), (k + 0.5, 0.0)) for k in range(MAX_MOTIONS)))
    memory = memory.with_motion(motion((0.0, 0.0), (0.5, 0.0)), JOINTS)  # used again
    memory = memory.with_motion(motion((-9.0, 0.0), (-9.5, 0.0)), JOINTS)
    assert len(memory.motions) == MAX_MOTIONS
    assert [each[0, 0] for each in memory.motions[:1]] == [2.0]
    assert [each[0, 0] for each in memory.motions[-2:]] == [0.0, -9.0]


def test_a_grip_is_known_near_where_it_was_and_with_the_same_openings() -> None:
    memory = Memory().with_grip([1.0, 0.5, 0.06, 0.03], JOINTS)
    assert gripped_near(memory, np.array([1.1, 0.4]), 0.06, 0.03)
    assert not gripped_near(memory, np.array([1.1, 0.4]), 0.05, 0.03)
    assert not gripped_near(memory, np.array([1.1, 0.4]), 0.06, 0.06)
    assert not gripped_near(memory, np.array([1.4, 0.5]), 0.06, 0.03)
    again = memory.with_grip([1.0, 0.52, 0.06, 0.03], JOINTS).with_grip([1.0, 0.5, 0.05, 0.03], JOINTS)
    assert [grip[1:3].tolist() for grip in again.grips] == [[0.52, 0.06], [0.5, 0.05]]
    full = Memory(JOINTS, (), tuple(np.array([k, 0.0, 0.06, 0.03]) for k in range(MAX_GRIPS)))
    assert [grip[0] for grip in full.with_grip([-5.0, 0.0, 0.06, 0.03], JOINTS).grips[:: MAX_GRIPS - 1]] == [1.0, -5.0]
    assert memory.with_motion(BEND, JOINTS).grips is memory.grips


def test_what_leads_nowhere_or_has_too_many_waypoints_is_not_remembered() -> None:
    memory = knowing(BEND)
    assert memory.with_motion(motion((1.0, 1.0), (1.0, 1.0)), JOINTS) is memory
    assert memory.with_motion(np.cumsum(np.ones((101, 2)), axis=0), JOINTS) is memory


def test_a_memory_is_a_value() -> None:
    given = BEND.copy()
    memory = knowing(given).with_grip([1.0, 0.5, 0.06, 0.03], JOINTS)
    before = memory.hash
    assert before != knowing(given).hash
    given[1] = 7.0
    assert memory.motions[0].tolist() == BEND.tolist()
    assert memory.with_motion(BEND + 9.0, JOINTS).hash != before
    assert memory.hash == before
    sent = pickle.loads(pickle.dumps(memory))
    assert sent.hash == before
    assert not sent.motions[0].flags.writeable


@pytest.mark.parametrize(
    ("names", "motions", "field"),
    [
        (JOINTS, [[[0.0, 1.0]]], r"motions\[0\]"),
        (JOINTS, [BEND, [[0.0], [1.0]]], r"motions\[1\]"),
        (JOINTS, [[[0.0, float("nan")], [1.0, 1.0]]], r"motions\[0\]"),
        (JOINTS, [np.zeros((101, 2))], r"motions\[0\]"),
        (JOINTS, [BEND] * 1001, "motions"),
        ((), [BEND], r"motions\[0\]"),
        (("",), [], r"joint_names\[0\]"),
        ("ab", [], "joint_names"),
    ],
)
def test_what_is_no_memory_is_refused_by_name(names: object, motions: object, field: str) -> None:
    with pytest.raises(InvalidRequest, match=rf"^{field}: got"):
        Memory(names, motions)  # type: ignore[arg-type]


@pytest.mark.parametrize("grip", [[0.0, 0.0, 0.1], [0.0, 0.0, -0.1, 0.1], [0.0, float("inf"), 0.1, 0.1], "ab", None])
def test_what_is_no_grip_is_refused(grip: object) -> None:
    with pytest.raises(InvalidRequest, match=r"^grips\[0\]: got"):
        Memory(JOINTS, (), (grip,))  # type: ignore[arg-type]


def test_a_memory_of_other_joints_is_refused() -> None:
    with pytest.raises(InvalidRequest, match=r"memory: got 'motions of j0, j1'; expected of a, b"):
        knowing(BEND).with_motion(BEND, ("a", "b"))

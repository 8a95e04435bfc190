"""Tasks refuse steps that have no meaning where they stand, and name them."""

from __future__ import annotations

import re

import pytest

from planner_service import InvalidRequest, Pose
from planner_service.tasks import Alternatives, Approach, Connect, Grasp, MoveTo, Release, Repeat, Retreat, Task


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ((), "steps: got (); expected at least one step"),
        ((MoveTo(), 3), "steps[1]: got 3"),
        ((Connect("a"),), "steps: 1 Connect a: expected an Approach or a Follow after it"),
        ((Connect("a"), MoveTo()), "steps: 1 Connect a: expected an Approach or a Follow after it"),
        ((MoveTo(), Approach("b"), Grasp("x")), "steps: 2 Approach b: expected a Connect before it"),
        ((Connect("a"), Approach("b"), MoveTo()), "steps: 2 Approach b: expected a Grasp or a Release after it"),
        ((MoveTo(), Retreat("c")), "steps: 2 Retreat c: expected a Grasp or a Release before it"),
        ((Connect(), Approach(), Release("x")), "steps: 3 Release x: poses"),
        ((Release("x", [Pose()]),), "steps: 1 Release x: expected an Approach before it"),
        ((Alternatives((MoveTo(), Retreat("c"))),), "steps: 1.2.1 Retreat c: expected a Grasp"),
        ((Repeat((MoveTo(),), 1000), MoveTo()), "at most 1,000 steps"),
    ],
)
def test_a_step_that_has_no_meaning_where_it_stands_is_named(steps: tuple[object, ...], message: str) -> None:
    with pytest.raises(InvalidRequest, match=re.escape(message)):
        Task(steps)


def test_sequences_of_steps_are_one_with_the_others() -> None:
    a, b, c = MoveTo("a"), MoveTo("b"), MoveTo("c")
    assert Task([a, [b, (c,)]]) == Task((a, b, c))


def test_equal_tasks_are_equal_and_have_one_hash() -> None:
    one, two = (Task((MoveTo([0.1, 0.2]), Connect(), Approach(), Grasp("x", [Pose()]))) for _ in range(2))
    assert one == two
    assert hash(one) == hash(two)

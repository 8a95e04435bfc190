"""What a server refuses raises what the library raises for the same mistake."""

from __future__ import annotations

import json

import pytest

from planner_service import InvalidRequest, NotProven, PlannerServiceError, UnknownName
from planner_service.client.problems import ServerRefused, ServerUnavailable, StaleVersion, error_of
from planner_service.collision.budget import Cancelled
from planner_service.serve.problems import Problem, problem_of


def sent(problem: Problem) -> PlannerServiceError:
    """The error on the other side."""
    return error_of(json.loads(problem.content), "http://server")


@pytest.mark.parametrize(
    "error",
    [
        InvalidRequest("start", 7, "6 joint values"),
        InvalidRequest("goal[1]", None, "a pose", message="goal[1] is no pose"),
        UnknownName("obstacle", "tabel", ["table", "tray"]),
        NotProven("motion: too fast", "it collides"),
    ],
)
def test_an_error_of_the_library_comes_back_as_it_was(error: InvalidRequest) -> None:
    back = sent(problem_of(error))
    assert type(back) is type(error)
    assert str(back) == str(error)
    assert {name: value for name, value in vars(back).items() if name != "available"} == {
        name: value for name, value in vars(error).items() if name != "available"
    }


def test_other_problems_have_errors_of_their_own() -> None:
    for kind, expected in (
        ("changed", StaleVersion),
        ("cancelled", Cancelled),
        ("queue-full", ServerUnavailable),
        ("not-found", ServerRefused),
    ):
        back = sent(Problem(kind, "\x1b[2J"))
        assert type(back) is expected
        assert "\\x1b" in str(back)  # what cannot be printed is shown by its escape

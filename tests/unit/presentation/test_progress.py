"""A long job tells how far it is: by a bar in a terminal, by lines in a log, and not at all if it is not asked."""

from __future__ import annotations

import pytest

from planner_service.presentation import progress
from planner_service.presentation.progress import INTERVAL, bar


class Clock:
    """Seconds of fake time, moved on by the test."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(progress, "time", made)
    return made


def test_a_log_has_a_line_in_ten_seconds(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with bar("episodes", True) as tell:
        assert tell is not None
        for done in range(0, 1001, 10):  # 100 a second, and 5 s for the first ten
            tell(done, 2000)
            clock.now += 0.25 if done else INTERVAL
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "episodes: 10 of 2,000 in 10 s, about 1990 s left"
    assert lines[1] == "episodes: 410 of 2,000 in 20 s, about 78 s left"
    assert len(lines) == 3
    assert not any("\x1b" in line for line in lines)


def test_what_an_earlier_run_had_done_says_nothing_about_the_pace(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    with bar("episodes", True) as tell:
        assert tell is not None
        tell(900, 1000)
        clock.now += INTERVAL
        tell(950, 1000)
    assert capsys.readouterr().err == "episodes: 950 of 1,000 in 10 s, about 10 s left\n"


def test_a_short_job_and_one_that_is_not_asked_say_nothing(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with bar("plans", True) as tell:
        assert tell is not None
        for done in range(100):
            tell(done, 100)
            clock.now += 0.05
    for shown in (None, False):
        with bar("plans", shown) as silent:
            assert silent is None
    assert capsys.readouterr().err == ""

"""The study of joint stops finds clocks that stop too late, and nothing in those that drive arms."""

from __future__ import annotations

from benchmarks.studies import two_arms


def test_joint_stops_are_kept_and_planted_faults_are_found() -> None:
    report = two_arms.run(part="stops", queries=20, seed=2)
    assert [promise.text for promise in report.promises if not promise.kept] == []
    assert len(report.promises) == 5
    own = [row for row in report.rows if row["clocks"] == "as they are"]
    assert len(own) == 20
    assert any(row["stopped"] for row in own)

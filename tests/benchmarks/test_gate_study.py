"""The study of the gate lets sound verdicts pass, and finds gates that prove less than they should."""

from __future__ import annotations

import pytest

from benchmarks.studies.gate import chunks
from benchmarks.studies.gate.chunks import ChunkWork

ATTACK = (1, 5, 9, 13)
"""Sessions that attack; see ``chunks.SOURCES``."""


def _touched(fault: str, sessions: int) -> int:
    work = ChunkWork("", 0, ("wxai",), seed=0, fault=fault)
    return sum(len(work(item)[2].touched) for item in range(sessions))


def test_no_target_that_passes_touches() -> None:
    for item in ATTACK:
        _, _, tally = ChunkWork("", 0, ("wxai",), seed=0)(item)
        assert tally.passed > 0
        assert not tally.touched


@pytest.mark.parametrize("fault", chunks.FAULTY[:2])
def test_a_gate_that_proves_less_is_found(fault: str) -> None:
    assert _touched(fault, 6) > 0

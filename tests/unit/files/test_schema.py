"""A record has the fields of the class that it makes, read as strictly as if each were declared."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from pydantic import Field

from planner_service.errors import InvalidFile
from planner_service.files.schema import Reading, Record, read_record


@dataclass(frozen=True)
class Peg:
    name: str
    turns: int
    axis: tuple[float, float, float]
    depth: float | None
    holes: tuple[str, ...]


class PegRecord(Record, makes=Peg):
    """A ``Peg``."""

    depth: float | None = Field(alias="depth_m")


PEG = Peg("a", 2, (0.0, 0.0, 1.0), None, ("b", "c"))
DOCUMENT = {"name": "a", "turns": 2, "axis": [0.0, 0.0, 1.0], "depth_m": None, "holes": ["b", "c"]}


def test_a_record_writes_and_reads_the_fields_of_its_class_in_their_order() -> None:
    assert list(PegRecord.of(PEG).document().items()) == list(DOCUMENT.items())
    assert read_record(PegRecord, DOCUMENT, Path("peg.json"), Reading()).value == PEG


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ({"turns": -1}, "turns: got -1; expected at least 0"),
        ({"turns": 2.0}, "turns: got 2.0"),
        ({"axis": [0.0, 1.0]}, "axis: got .*; expected 3 finite numbers"),
        ({"depth": 0.1}, "unknown key 'depth'; did you mean 'depth_m'?"),
        ({"holes": ["b"] * 1_001}, "holes: .*at most 1,000 entries"),
    ],
)
def test_a_field_that_the_class_alone_declares_is_read_strictly(wrong: dict[str, object], problem: str) -> None:
    with pytest.raises(InvalidFile, match=problem.replace("?", r"\?")):
        read_record(PegRecord, DOCUMENT | wrong, Path("peg.json"), Reading())


def test_a_class_has_one_record() -> None:
    with pytest.raises(TypeError, match="two records of Peg"):

        class _Other(Record, makes=Peg):
            pass

"""The generated parts of a Markdown text."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.harness.markdown import write_part
from benchmarks.harness.report import Promise, Report, table_of
from planner_service.errors import InvalidFile

REPORT = Report(
    "some", (), (table_of("T", [{"a": "x|y", "b": "[1, 2] <"}], caption="p50."),), (Promise("p", "1", True),)
)
TEXT = "before\n<!-- generated: some -->\nold\n<!-- end of some -->\nafter\n"


def test_a_part_is_made_anew_and_the_rest_of_the_text_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text(TEXT, "utf-8")
    write_part(REPORT, tmp_path / "a.md")
    inside = "| a | b |\n| --- | ---: |\n| x\\|y | \\[1, 2] &lt; |\n\np50.\n\n- kept: p: 1\n"
    told = f"before\n<!-- generated: some -->\n\n{inside}\n<!-- end of some -->\nafter\n"
    assert (tmp_path / "a.md").read_text("utf-8") == told


@pytest.mark.parametrize("lost", ["<!-- generated: some -->", "<!-- end of some -->"])
def test_a_text_without_the_part_is_refused(tmp_path: Path, lost: str) -> None:
    (tmp_path / "a.md").write_text(TEXT.replace(lost, ""), "utf-8")
    with pytest.raises(InvalidFile, match=f"{lost} is missing"):
        write_part(REPORT, tmp_path / "a.md")

"""The mutation study: which faults it plants, and that it notices whether tests do."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

from rich.console import Console

from benchmarks.studies.mutants import EQUIVALENT, MAX_LIST, Package, show, study
from benchmarks.studies.mutation import lines, sites
from planner_service.files.toml_reader import read_tables

ROOT = Path(__file__).parents[2]


def mutants_of(source: str) -> list[str]:
    """The mutated lines of a source."""
    return [lines(source, edit)[2] for site in sites(source) for edit in site]


def test_each_kind_of_fault_is_planted() -> None:
    assert mutants_of("a < b") == ["a >= b", "a <= b"]
    assert mutants_of("a is not None") == ["a is None"]
    assert mutants_of("(a) not in (b)") == ["(a) in (b)"]
    assert mutants_of("a and b and c") == ["a or b and c", "a and b or c"]
    assert mutants_of("a - (b)") == ["a + (b)"]
    assert mutants_of("a += b") == ["a -= b"]
    assert mutants_of("a[1.5]") == ["a[2.5]", "a[0.5]"]
    assert mutants_of("f(True)") == ["f(False)"]
    assert mutants_of("f(-a, not b)") == ["f(a, not b)", "f(-a, b)"]
    assert mutants_of("if f(a): pass") == ["if (not (f(a))): pass"]


def test_a_study_tells_the_faults_that_tests_notice_from_those_they_do_not(tmp_path: Path) -> None:
    module, test = tmp_path / "planner_service/tiny/sums.py", tmp_path / "tests/test_sums.py"
    for file, content in (
        (tmp_path / "planner_service/__init__.py", ""),
        (tmp_path / "planner_service/tiny/__init__.py", ""),
        (module, "def add(a, b):\n    return a + b\n\n\ndef untested(a, b):\n    return a * b\n"),
        (test, "from planner_service.tiny.sums import add\n\n\ndef test_add():\n    assert add(1, 2) == 3\n"),
    ):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content, "utf-8")
    package = Package("tiny", ("planner_service/tiny/sums.py",), ("tests/test_sums.py",))
    out, text = tmp_path / "out.json", StringIO()
    console = Console(file=text, width=120)

    rows = study(package, tmp_path, 40, 0, out, console)

    assert {row["after"]: row["by"] for row in rows} == {
        "return a - b": "tests/test_sums.py::test_add",
        "return a / b": "",
    }
    assert module.read_text("utf-8").count("a + b") == 1
    show(rows, console)
    assert "sums.py:6: operator changed\n- return a * b\n+ return a / b" in text.getvalue()
    test.write_text("def test_nothing_new_is_run():\n    raise AssertionError\n", "utf-8")
    assert study(package, tmp_path, 40, 0, out, console) == rows


def test_every_line_of_the_list_of_equivalent_mutants_is_still_there() -> None:
    for entry in read_tables(EQUIVALENT, MAX_LIST)["mutant"]:
        assert entry["before"] in map(str.strip, (ROOT / entry["file"]).read_text("utf-8").split("\n")), entry

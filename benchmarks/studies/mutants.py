"""``mutants``: do a package's own tests notice a small fault in it?

A mutant is a copy of the package with one small fault: a comparison negated, a boundary moved (``<`` to ``<=``), a
number one up or down, another operator, a sign or a ``not`` dropped, ``and`` for ``or``. It is killed if a test of the
package fails, or if a test file takes four times as long as it should. A mutant that survives shows what no test
promises, unless it is equivalent: no input makes the program answer differently, or the answer is as good.
Equivalent mutants are listed with the reason in equivalent_mutants.toml and do not count.

Mutants are drawn at random from all places of a package; compiled code is not mutated. The tests run in a throw-away
copy of the checkout, one mutant after the other. Every outcome is written to the file of ``--out`` at once, and a study
that was interrupted goes on from there.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

from benchmarks.harness.arguments import whole
from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import table
from benchmarks.studies.mutation import apply, lines, sites
from planner_service.errors import BrokenInvariant
from planner_service.files.toml_reader import read_tables
from planner_service.files.writing import require_writable, write_whole

__all__ = ["EQUIVALENT", "Mutant", "Package", "draw", "main", "study"]

EQUIVALENT = Path(__file__).parent / "equivalent_mutants.toml"
PACKAGES: dict[str, tuple[str, ...]] = {
    "collision": tuple(
        f"laws/test_{name}.py"
        for name in (
            "collision_laws",
            "crowd_laws",
            "mesh_laws",
            "name_laws",
            "sweep_laws",
            "mesh_gaps",
            "small_solids",
        )
    ),
    "certify": tuple(
        f"laws/test_{name}.py" for name in ("certify_laws", "proof_laws", "planted_faults", "mesh_gaps", "mesh_proofs")
    ),
    **dict.fromkeys(("planning", "smoothing", "timing", "roadmap", "replanning"), ()),
    "execute": ("integration/test_simulation.py",),
}
"""The packages; a package's own tests are those in its folder of tests/unit and these."""

PATIENCE, GRACE = 4.0, 10.0
"""A mutant is killed if a test file takes this many times as long as without it, and these seconds."""

COMPILED = ("planner_service.native._core", "planner_service.certify.native._proof")
HIDE_CHECKOUT = """import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__]
"""
"""A sitecustomize.py beside the copy's packages: these are imported, not those of the checkout that is installed."""

NO_SHRINKING = """from hypothesis import Phase, settings
settings.register_profile("mutants", phases=[Phase.explicit, Phase.generate], database=None)
settings.load_profile("mutants")
"""
"""A plugin of pytest: a property that fails has killed the mutant, and no simpler example is looked for."""

OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no_shrinking", "-m", "not ray and not browser")
ALONE = 2
"""Test files that run by themselves, the others together: those that are fast, and have killed most mutants so far."""

NO_TESTS = 5
"""pytest's exit code when all tests of a file are deselected."""

MAX_LIST = 1_000_000
"""Bytes of the list of equivalent mutants."""

FIRST_FAILURE = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


@dataclass(frozen=True)
class Package:
    """A package under test: its modules and its test files, relative to the checkout."""

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Mutant:
    """One fault: the line where it is, before and after, and the whole mutated source."""

    package: str
    file: str
    line: int
    kind: str
    before: str
    after: str
    source: str

    def description(self) -> dict[str, Any]:
        """What is stored of it: all but the source."""
        return {key: value for key, value in asdict(self).items() if key != "source"}


def package_of(name: str, root: Path = ROOT) -> Package:
    """The package of this name with its own tests."""
    modules = sorted((root / "planner_service" / name).rglob("*.py"))
    more = [root / "tests" / name for name in PACKAGES[name]]
    tests = [*sorted((root / "tests/unit" / name).rglob("test_*.py")), *more]
    return Package(name, *(tuple(str(file.relative_to(root)) for file in files) for files in (modules, tests)))


def draw(package: Package, root: Path, count: int, seed: int) -> list[Mutant]:
    """``count`` mutants at different places of the package, in an order that only the seed and the source decide."""
    rng = random.Random(f"{package.name} {seed}")
    sources = {file: (root / file).read_text("utf-8") for file in package.modules}
    places = [(file, site) for file, source in sources.items() for site in sites(source)]
    rng.shuffle(places)  # more mutants are the same ones and others
    drawn = []
    for file, site in places[:count]:
        edit = rng.choice(site)
        line, before, after = lines(sources[file], edit)
        drawn.append(Mutant(package.name, file, line, edit.kind, before, after, apply(sources[file], edit)))
    return drawn


class Sandbox:
    """A copy of the checkout in which tests run on mutated modules."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.folder = folder / "checkout"
        self._cache, self._warm = folder / "cache", folder / "warm"
        self._kills: Counter[str] = Counter()
        tracked = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True).stdout
        for name in tracked.rstrip("\0").split("\0"):
            if (root / name).is_file():
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(root / name, self.folder / name)
        for name in COMPILED:
            spec = importlib.util.find_spec(name)
            if spec is not None and spec.origin is not None:
                (self.folder.joinpath(*name.split(".")[:-1])).mkdir(parents=True, exist_ok=True)
                shutil.copy(spec.origin, self.folder.joinpath(*name.split(".")[:-1]))
        (self.folder / "sitecustomize.py").write_text(HIDE_CHECKOUT, "utf-8")
        (self.folder / "no_shrinking.py").write_text(NO_SHRINKING, "utf-8")
        self._environment = {
            **os.environ,
            "PYTHONPATH": str(self.folder),
            "PLANNER_SERVICE_CACHE": str(self._cache),
        }

    def warm_up(self, tests: Sequence[str]) -> dict[str, float]:
        """Seconds that each test file takes on the unchanged package."""
        seconds = {}
        for test in tests:
            start = time.monotonic()
            code, output = self._pytest([test], None)
            if code not in (0, NO_TESTS):
                raise BrokenInvariant(f"{test} fails without a mutant:\n{output[-2000:]}")
            if code == 0:
                seconds[test] = time.monotonic() - start
        self._cache.mkdir(exist_ok=True)
        shutil.copytree(self._cache, self._warm)
        return seconds

    def outcome(self, mutant: Mutant, seconds: Mapping[str, float]) -> dict[str, Any]:
        """Whether the tests kill a mutant, which was the first to do so, and the seconds that took."""
        file = self.folder / mutant.file
        original = file.read_text("utf-8")
        shutil.rmtree(self._cache, ignore_errors=True)
        shutil.copytree(self._warm, self._cache)
        file.write_text(mutant.source, "utf-8")
        Path(importlib.util.cache_from_source(str(file))).unlink(missing_ok=True)
        start, by = time.monotonic(), ""
        ordered = sorted(seconds, key=lambda test: seconds[test] / (1 + self._kills[test]))
        try:
            for tests in (*([test] for test in ordered[:ALONE]), ordered[ALONE:]):
                by = by or self._failure(tests, PATIENCE * sum(seconds[test] for test in tests) + GRACE)
        finally:
            file.write_text(original, "utf-8")
        self._kills[by.split("::")[0]] += 1
        return {"killed": bool(by), "by": by, "seconds": round(time.monotonic() - start, 1)}

    def _failure(self, tests: Sequence[str], limit: float) -> str:
        """What fails first in test files, empty if nothing does."""
        code, output = self._pytest(tests, limit, PYTHONDONTWRITEBYTECODE="1") if tests else (0, "")
        while code == -signal.SIGTERM:  # somebody else ended it, which says nothing of the mutant
            code, output = self._pytest(tests, limit, PYTHONDONTWRITEBYTECODE="1")
        if code in (0, NO_TESTS):
            return ""
        failure = FIRST_FAILURE.search(output)
        return (
            f"{tests[0]}: out of time" if code is None else failure[1] if failure else f"{tests[0]}: exit code {code}"
        )

    def _pytest(self, tests: Sequence[str], limit: float | None, **environment: str) -> tuple[int | None, str]:
        """The exit code, None if the time was up, and what was printed."""
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *OPTIONS, *tests],
            cwd=self.folder,
            env={**self._environment, **environment},
            start_new_session=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        try:
            output, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # with the workers that a mutant may have left behind
            process.wait()
        return process.returncode, output


def study(package: Package, root: Path, count: int, seed: int, out: Path, console: Console) -> list[dict[str, Any]]:
    """The outcomes of ``count`` mutants of a package; those already in ``out`` are taken from there."""
    known = json.loads(out.read_text("utf-8")) if out.exists() else []
    mutants = draw(package, root, count, seed)
    descriptions = [mutant.description() for mutant in mutants]
    outcomes = {_key(row): row for row in known}
    open_ = [mutant for mutant in mutants if _key(mutant.description()) not in outcomes]
    if open_:
        with TemporaryDirectory() as folder:
            sandbox = Sandbox(root, Path(folder))
            seconds = sandbox.warm_up(package.tests)
            console.print(f"{package.name}: {sum(seconds.values()):.0f} s of tests, {len(open_)} mutants")
            for mutant in open_:
                row = {**mutant.description(), **sandbox.outcome(mutant, seconds)}
                known.append(row)
                outcomes[_key(row)] = row
                write_whole(out, json.dumps(known, indent=1) + "\n")
    return [outcomes[_key(description)] for description in descriptions]


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("file", "line", "kind", "before", "after"))


def is_equivalent(row: Mapping[str, Any]) -> bool:
    """Whether a mutant is listed as equivalent: by its line before and after, or by the line before alone."""
    listed = read_tables(EQUIVALENT, MAX_LIST)["mutant"]
    return any(
        (entry["file"], entry["before"], entry.get("after", row["after"])) == (row["file"], row["before"], row["after"])
        for entry in listed
    )


def show(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print a line for each package, and the mutants that tests should have killed."""
    missed = [row for row in rows if not row["killed"] and not is_equivalent(row)]
    names = list(dict.fromkeys(row["package"] for row in rows))
    cells = []
    for title, members in [*((name, [name]) for name in names), ("all", names)]:
        parts = (rows, [row for row in rows if row["killed"]], missed)
        drawn, killed, survived = (sum(row["package"] in members for row in part) for part in parts)
        share = f"{100.0 * killed / (killed + survived):.0f} %" if killed + survived else "-"
        cells.append((title, str(drawn), str(killed), str(drawn - killed - survived), str(survived), share))
    columns = ("package", "mutants", "killed", "equivalent", "survived", "killed of those not equivalent")
    console.print(table("Mutation study", columns, cells))
    for row in missed:
        console.print(f"\n{row['file']}:{row['line']}: {row['kind']}", markup=False, highlight=False)
        console.print(f"- {row['before']}\n+ {row['after']}", markup=False, highlight=False)


def _package_name(text: str) -> str:
    if text not in PACKAGES:
        raise argparse.ArgumentTypeError(f"unknown package {text!r}; expected one of {', '.join(PACKAGES)}")
    return text


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks mutants", description=__doc__)
    parser.add_argument(
        "packages", nargs="*", type=_package_name, metavar="PACKAGE", help=f"{', '.join(PACKAGES)} (all)"
    )
    parser.add_argument("--count", type=whole(1), default=40, metavar="N", help="mutants of each package (40)")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="S", help="of the draw (0)")
    parser.add_argument(
        "--out", type=Path, default=Path("mutants.json"), metavar="FILE", help="outcomes (mutants.json)"
    )
    options = parser.parse_args(arguments)
    require_writable(options.out)
    rows = []
    for name in options.packages or PACKAGES:
        rows += study(package_of(name), ROOT, options.count, options.seed, options.out, console)
    show(rows, console)
    return 0

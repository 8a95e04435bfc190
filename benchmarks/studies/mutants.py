"""``mutants``: do a package's own tests notice a small fault in it?

A mutant is a copy of the package with one small fault: a comparison negated, a boundary moved (``<`` to ``<=``), a
number one up or down, another operator, a sign or a ``not`` dropped, ``and`` for ``or``. It is killed if a test of the
package fails, or takes four times as long as it should. A mutant that survives shows what no test
promises, unless it is equivalent: no input makes the program answer differently, or the answer is as good.
Equivalent mutants are listed with the reason in equivalent_mutants.toml and do not count.

Mutants are drawn at random from all places of a package; compiled code is not mutated. The tests run in a throw-away
copy of the checkout, one mutant after the other, and those that reach the mutated line first. Every outcome is written
to the file of ``--out`` at once, and a study that was interrupted goes on from there.
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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from coverage import CoverageData
from rich.console import Console

from benchmarks.harness.arguments import whole
from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import table
from benchmarks.studies.mutation import apply, lines, sites
from planner_service.errors import BrokenInvariant
from planner_service.files.toml_reader import read_tables
from planner_service.files.writing import require_writable, write_whole

__all__ = ["EQUIVALENT", "Mutant", "Package", "draw", "main", "study"]

EQUIVALENT, PLUGIN = (Path(__file__).with_name(name) for name in ("equivalent_mutants.toml", "mutant_plugin.py"))
PACKAGES: dict[str, tuple[str, ...]] = {
    "collision": ("collision_laws", "crowd_laws", "mesh_laws", "name_laws", "sweep_laws", "mesh_gaps", "small_solids"),
    "certify": ("certify_laws", "proof_laws", "planted_faults", "mesh_gaps", "mesh_proofs"),
    "planning": ("service",),
    **dict.fromkeys(("smoothing", "timing", "roadmap", "replanning"), ()),
    "execute": ("simulation",),
}
"""The packages; a package's own tests are those in its folder of tests/unit and these from other folders."""

PATIENCE, GRACE = 4.0, 30.0
"""A test may take this many times as long as without a mutant, and these seconds; it may build what others share."""

COMPILED = ("planner_service.native._core", "planner_service.certify.native._proof")
HIDE_CHECKOUT = """import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__]
"""
"""A sitecustomize.py beside the copy's packages: these are imported, not those of the checkout that is installed."""

OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-p", "mutant_plugin", "-m", "not ray and not browser")
MAX_LIST = 1_000_000
"""Bytes of the list of equivalent mutants."""

PINS = re.compile(r"/test_(pinned|reference)_")
"""Tests that compare counts and results with stored ones: they notice changes, but not whether these are faults."""

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
    others = [next((root / "tests").rglob(f"test_{other}.py")) for other in PACKAGES[name]]
    tests = [*sorted((root / "tests/unit" / name).rglob("test_*.py")), *others]
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

    def __init__(self, root: Path, folder: Path, package: Package) -> None:
        self.folder, self._package = folder / "checkout", package
        self._cache, self._warm, self._job = folder / "cache", folder / "warm", folder / "job.json"
        shutil.copytree(root, self.folder, ignore=shutil.ignore_patterns(".*", "__pycache__", "build", "results"))
        for name in COMPILED:
            spec, target = importlib.util.find_spec(name), self.folder.joinpath(*name.split(".")[:-1])
            if spec is not None and spec.origin is not None and target.is_dir():
                shutil.copy(spec.origin, target)
        (self.folder / "sitecustomize.py").write_text(HIDE_CHECKOUT, "utf-8")
        shutil.copy(PLUGIN, self.folder)
        self._environment = {
            **os.environ,
            "PYTHONPATH": str(self.folder),
            "PLANNER_SERVICE_CACHE": str(self._cache),
            "MUTANT_JOB": str(self._job),
        }

    def warm_up(self) -> float:
        """Run the tests without a mutant, for what they reach and the seconds they take; the sum of these."""
        code, output = self._pytest({})
        if code:
            raise BrokenInvariant(f"the tests of {self._package.name} fail without a mutant:\n{output[-2000:]}")
        self._cache.mkdir(exist_ok=True)
        shutil.copytree(self._cache, self._warm)
        self._environment["PYTHONDONTWRITEBYTECODE"] = "1"
        self._seconds = json.loads(self._job.with_name("seconds.json").read_text("utf-8"))
        self._reached = CoverageData(str(self._job.with_name("coverage")))
        self._reached.read()
        return float(sum(self._seconds.values()))

    def outcome(self, mutant: Mutant) -> dict[str, Any]:
        """Whether the tests kill a mutant, which was the first to do so, and the seconds that took."""
        file = self.folder / mutant.file
        original = file.read_text("utf-8")
        shutil.rmtree(self._cache, ignore_errors=True)
        shutil.copytree(self._warm, self._cache)
        file.write_text(mutant.source, "utf-8")
        Path(importlib.util.cache_from_source(str(file))).unlink(missing_ok=True)
        start, limits = time.monotonic(), self._limits(file, mutant.line)
        try:
            for _ in range(2):  # somebody else may have ended it once, which says nothing of the mutant
                code, output = self._pytest(limits)
                if code not in (-signal.SIGTERM, -signal.SIGKILL):
                    break
        finally:
            file.write_text(original, "utf-8")
        failure = FIRST_FAILURE.search(output)
        by = "out of time" if code == -signal.SIGALRM else failure[1] if failure else f"exit code {code}"
        return {"killed": bool(code), "by": by if code else "", "seconds": round(time.monotonic() - start, 1)}

    def _limits(self, file: Path, line: int) -> dict[str, float]:
        """How long each test may take, in order: the fastest that reach the line, then the others; pins come last."""
        tests = self._reached.contexts_by_lineno(str(file))
        at = max((reached for reached in tests if reached <= line), default=line)  # an expression may start further up
        first = sorted(filter(None, tests.get(at, ())), key=self._seconds.__getitem__)
        order = sorted((*first, *self._seconds), key=lambda test: bool(PINS.search(test)))
        return {test: GRACE + PATIENCE * self._seconds[test] for test in order}

    def _pytest(self, limits: Mapping[str, float]) -> tuple[int, str]:
        """The exit code, and what was printed."""
        self._job.write_text(json.dumps({"modules": self._package.modules, "limits": limits}), "utf-8")
        with TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", "pytest", *OPTIONS, *self._package.tests],
                cwd=self.folder,
                env=self._environment,
                start_new_session=True,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
            try:
                process.wait()
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)  # with the workers that a mutant may have left behind
            output.seek(0)
            return process.returncode, output.read()


def study(package: Package, root: Path, count: int, seed: int, out: Path, console: Console) -> list[dict[str, Any]]:
    """The outcomes of ``count`` mutants of a package; those already in ``out`` are taken from there."""
    known = json.loads(out.read_text("utf-8")) if out.exists() else []
    mutants = {_key(mutant.description()): mutant for mutant in draw(package, root, count, seed)}
    outcomes = {_key(row): row for row in known}
    open_ = [mutant for key, mutant in mutants.items() if key not in outcomes]
    if open_:
        with TemporaryDirectory() as folder:
            sandbox = Sandbox(root, Path(folder), package)
            console.print(f"{package.name}: {sandbox.warm_up():.0f} s of tests, {len(open_)} mutants")
            for mutant in open_:
                row = {**mutant.description(), **sandbox.outcome(mutant)}
                known.append(row)
                outcomes[_key(row)] = row
                write_whole(out, json.dumps(known, indent=1) + "\n")
    return [outcomes[key] for key in mutants]


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
        dead = [row for row in rows if row["killed"]]
        parts = (rows, dead, [row for row in dead if PINS.search(row["by"])], missed)
        drawn, killed, pinned, survived = (sum(row["package"] in members for row in part) for part in parts)
        share = f"{100.0 * killed / (killed + survived):.0f} %" if killed + survived else "-"
        cells.append((title, *map(str, (drawn, killed, pinned, drawn - killed - survived, survived)), share))
    columns = ("package", "mutants", "killed", "by pins alone", "equivalent", "survived", "killed, without equivalent")
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

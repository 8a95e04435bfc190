"""Suites: which problems, by which planners, with which seeds. TOML files in ``suites/``, or your own.

::

    about = "one sentence"
    planners = ["rrtconnect", "prm:milestones=200"]      # when a run names none: settings after a colon
    seeds = "0:5"                                        # when a run names none: 0, 1, 2, 3, 4
    max_checks = 50000                                   # optional: states a plan may judge
    ceilings = { rrtconnect = 8000 }                     # optional: p95 of a planner's states that the gate allows

    [[queries]]                                          # the stored queries of the WidowX AI
    scenes = ["bin", "shelf"]
    numbers = [0, 1]                                     # optional: all 20 if not given

    [[problems]]                                         # a JSON problem set beside this package
    file = "mbm_panda.json"
    robot = "panda_mbm"
    ids = ["cage/0057"]                                  # optional: all if not given

    [[drawn]]                                            # free ends that no straight line joins
    robots = ["planar:2", "planar:4", "wxai_dual"]       # planar:N is an arm of N joints in a plane
    scene = "discs"
    count = 3
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from benchmarks.harness.sources import Motion, Sources
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.schema import Reading, Text, at_most, read_record
from planner_service.files.toml_reader import read_tables
from planner_service.planners import PLANNERS
from planner_service.scene.toml_reader import MAX_BYTES
from planner_service.search.problem import Planner

__all__ = ["MAX_CHECKS", "SUITES", "Suite", "load_suite", "planner_of", "seeds_of", "suite_names"]

SUITES = Path(__file__).parents[1] / "suites"
MAX_SEEDS = 10_000

MAX_CHECKS = 50_000
"""States a plan may judge where a suite says nothing: the budget of a default request."""


@dataclass(frozen=True, eq=False)
class Suite:
    """Problems, and by which planners and with which seeds they are planned when nobody says otherwise.

    Attributes:
        max_checks: States a plan may judge.
        ceilings: By planner, the most that p95 of its states may be.
    """

    name: str
    about: str
    problems: tuple[Motion, ...]
    planners: tuple[str, ...]
    seeds: range
    max_checks: int
    ceilings: Mapping[str, int]


def suite_names() -> tuple[str, ...]:
    """The suites that come with the benchmarks."""
    return tuple(sorted(path.stem for path in SUITES.glob("*.toml")))


def load_suite(name_or_path: str) -> Suite:
    """A suite by name, or by the path of its TOML file, with its problems drawn.

    Raises:
        UnknownName: no such suite.
        InvalidFile: with all problems found.
    """
    path = Path(name_or_path)
    if not name_or_path.endswith(".toml"):
        if name_or_path not in suite_names():
            raise UnknownName("suite", name_or_path, suite_names())
        path = SUITES / f"{name_or_path}.toml"
    file = read_record(_SuiteFile, read_tables(path, MAX_BYTES), path, Reading())
    problems = tuple(problem for make in file.makers for problem in make())
    twice = [id for id, count in Counter(problem.id for problem in problems).items() if count > 1]
    if twice:
        raise InvalidFile(path, [f"problem {id!r} is there twice" for id in twice])
    planners, seeds = tuple(file.planners), seeds_of(file.seeds)
    return Suite(path.stem, file.about, problems, planners, seeds, file.max_checks, file.ceilings)


def planner_of(text: str) -> Planner:
    """The planner that ``name`` or ``name:setting=value,setting=value`` says.

    Raises:
        UnknownName: no such planner.
        InvalidRequest: it has no such setting, or the value is none.
    """
    name, _, rest = text.partition(":")
    if name not in PLANNERS:
        raise UnknownName("planner", name, PLANNERS)
    known = {item.name for item in fields(PLANNERS[name])}
    settings: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in known or not re.fullmatch(r"\d{1,12}(\.\d{1,12})?", value):
            raise InvalidRequest("planner", text, f"{name}:setting=number, settings being {', '.join(sorted(known))}")
        settings[key] = float(value) if "." in value else int(value)
    planner: Planner = PLANNERS[name](**settings)
    return planner


def seeds_of(text: str) -> range:
    """``A:B`` is A to B - 1, ``N`` is one seed.

    Raises:
        InvalidRequest: neither, or more than ``MAX_SEEDS``.
    """
    match = re.fullmatch(r"(\d{1,9})(?::(\d{1,9}))?", text)
    if match:
        first, end = int(match[1]), int(match[2]) if match[2] else int(match[1]) + 1
        if first < end <= first + MAX_SEEDS:
            return range(first, end)
    raise InvalidRequest("seeds", text, f"N, or A:B for A to B - 1, at most {MAX_SEEDS:,} of them")


# The file, declared.


def _known_planner(text: str) -> str:
    planner_of(text)
    return text


def _known_seeds(text: str) -> str:
    seeds_of(text)
    return text


Limit = Annotated[int, Field(ge=1, le=10**9)]


class _SuiteFile(Sources):
    about: Text
    planners: Annotated[list[Annotated[Text, AfterValidator(_known_planner)]], Field(min_length=1), at_most(1000)]
    seeds: Annotated[Text, AfterValidator(_known_seeds)]
    max_checks: Limit = MAX_CHECKS
    ceilings: dict[Text, Limit] = Field({}, description="a table of planners of this suite")

    @cached_property
    def value(self) -> None:
        """Nothing; it refuses a suite without problems."""
        if not set(self.ceilings) <= set(self.planners):
            raise InvalidRequest("ceilings", self.ceilings, f"planners of this suite: {', '.join(self.planners)}")
        if not self.makers:
            expected = f"at least one of {', '.join(f'[[{kind}]]' for kind in Sources.model_fields)}"
            raise InvalidRequest("problems", None, expected, message=f"no problems; expected {expected}")

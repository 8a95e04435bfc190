"""Public callables with hostile arguments: refused by name, or answered as the laws say; never anything else."""

from __future__ import annotations

import math
import pickle
import tempfile
import weakref
from collections.abc import Callable, Mapping
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.attack import callables
from benchmarks.attack.callables import Call
from benchmarks.attack.harness import Case, Part, Wrong
from planner_service.certify import certify
from planner_service.records import save_plan

__all__ = ["HOSTILE", "Attack"]


class _OwnError(Exception):
    """What the caller's own object raises: it may come out as it is."""


class _Hater:
    """Whatever is called fails."""

    def _fail(self, *_: object) -> Any:
        raise _OwnError

    __getattr__ = __len__ = __float__ = __eq__ = __repr__ = _fail
    __hash__ = None  # type: ignore[assignment]


HOSTILE: Mapping[str, Callable[[], Any]] = {
    **callables.HOSTILE,
    **callables.of_values(0, 5, 0.5, -math.inf, 5e-324, 2**63, Decimal("0.1"), Decimal("sNaN"), Fraction(1, 3), "0.1"),
    **callables.of_values(np.float16(0.1), np.longdouble("1e4000"), np.datetime64("2020-01-01"), "\x1b[2J\r\n\t\x07"),
    **callables.of_values("a\0b", "\ud800", "x" * 100_000, "link_1", "tray", "universe", (0.1, 0.1, 0.1), math),
    **callables.of_values(
        Path("/nonexistent/file"), Path("/"), "/dev/zero", b"abcdef", ps.Box((0.1, 0.1, 0.1)), ps.Pose()
    ),
    "texts": lambda: ["a", "b"],
    "nans": lambda: [math.nan] * 6,
    "infs": lambda: np.full(6, np.inf),
    "zeros": lambda: [0.0] * 6,
    "seven": lambda: [0.0] * 7,
    "bools": lambda: np.zeros(6, dtype=bool),
    "complexes": lambda: np.zeros(6) + 1j,
    "scalar array": lambda: np.array(0.1),
    "no rows": lambda: np.zeros((0, 6)),
    "cube": lambda: np.zeros((2, 2, 2)),
    "generator": lambda: (0.0 for _ in range(6)),
    "hater": _Hater,
    "weak": lambda: weakref.WeakSet(),
    "scene": ps.Scene,
    "request": lambda: ps.PlanRequest([0.0] * 6, [0.1] * 6),
    "error": lambda: ValueError("a value"),
}
"""Values that no argument, or hardly any, is meant to take."""

RARE = {"no end", "range(0, 1000000000000)", "deep list"}
"""Asked one time in two hundred: to refuse them may take long."""


def _calls(folder: Path) -> dict[str, Call]:
    """Every public callable, with arguments that are right."""
    service = ps.PlannerService("planar2", "discs")
    result = service.plan(ps.PlanRequest([0.0, 0.5], [0.5, 0.5], time_limit=None))
    proof = {"robot": service.robot, "scene": service.scene, "path": result.path, "padding": 0.0}
    return {
        **callables.calls(folder),
        "save_plan": Call(save_plan, {"plan": result, "path": folder / "plan.json"}),
        "certify": Call(certify, proof),
    }


DEAR = {"Ray": 0.02, "draw_check": 0.01, "pick": 0.1, "plan_pick_place": 0.02, "import_robot": 0.2}
"""How often calls that take long are drawn; the others 1."""


class Attack(Part):
    name = "api"
    what = "public callables with one or two arguments replaced, whole or in part, by hostile values"

    @cached_property
    def _known(self) -> dict[str, Call]:
        return _calls(Path(tempfile.mkdtemp()))

    def draw(self, rng: np.random.Generator) -> Case:
        weights = np.array([DEAR.get(name, 1.0) for name in self._known])
        name = str(rng.choice(list(self._known), p=weights / weights.sum()))
        valid = self._known[name].arguments
        keys = list(valid)
        hostile, rare = [key for key in HOSTILE if key not in RARE], sorted(RARE)
        swaps: list[list[Any]] = []
        for key in rng.permutation(keys)[: int(rng.choice((1, 1, 1, 2)))].tolist():
            value = str(rng.choice(rare if rng.random() < 0.005 else hostile))
            inside = valid[key]
            deep = isinstance(inside, (tuple, list, np.ndarray)) and len(inside) and rng.random() < 0.4
            swaps.append([key, int(rng.integers(len(inside))) if deep else None, value])
        if rng.random() < 0.03:
            swaps = []
        return {"call": name, "swaps": swaps}

    def run(self, case: Case) -> None:
        name = case["call"]
        call, valid = self._known[name].function, self._known[name].arguments
        given, buffers = dict(valid), []
        for key, value in valid.items():  # the caller's own, which change afterwards
            numbers = isinstance(value, list) and _numeric(value)
            if isinstance(value, np.ndarray) or numbers:
                given[key] = np.array(value)
                buffers.append(given[key])
        for key, at, label in case["swaps"]:
            value = HOSTILE[label]()
            if at is not None:
                inside = list(valid[key])
                inside[at] = value
                value = tuple(inside) if isinstance(valid[key], tuple) else inside
            given[key] = value
        try:
            answer = call(**given)
        except _OwnError:
            return
        self.counted["answered although hostile"] += bool(case["swaps"])
        _require_kept(name, answer, buffers)
        _require_sane(name, answer)


def _numeric(value: Any) -> bool:
    """Whether a list is of numbers, or of equally long lists of these."""
    try:
        return np.array(value).dtype == np.float64
    except ValueError:
        return False


def _require_kept(name: str, answer: Any, buffers: list[Any]) -> None:
    """What was made of the caller's arrays does not change when these do."""
    if not buffers or not hasattr(answer, "__dataclass_fields__"):
        return
    try:
        pickle.dumps(answer)  # the first makes what a service makes when it is asked for
        before = pickle.dumps(answer)
    except (AttributeError, TypeError, RecursionError, pickle.PicklingError):  # an object of the caller's
        return
    for buffer in buffers:
        buffer[...] = 12345.0 if buffer.dtype.kind == "f" else 1
    if pickle.dumps(answer) != before:
        raise Wrong(f"{name} copies what it is given")


def _require_sane(name: str, answer: Any) -> None:
    """No NaN comes out, and a plan is proven."""
    if isinstance(answer, (float, np.floating, np.ndarray)):
        array = np.asarray(answer)
        if array.dtype.kind == "f" and np.isnan(array).any():
            raise Wrong(f"{name} answers no NaN")
    elif isinstance(answer, ps.PlanResult) and answer.path is not None:
        if answer.certificate is None or not answer.certificate.certified:
            raise Wrong(f"{name}: a plan is proven")
    elif isinstance(answer, (list, tuple)):
        for part in answer:
            if isinstance(part, ps.PlanResult):
                _require_sane(name, part)

"""What samples of counts and times allow to say, and what they do not.

Runs of one problem with several seeds are no independent samples of a planner: wherever there are several problems,
it is problems that are drawn again by the bootstrap and that are the units of a test. All random choices are seeded.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner_service.geometry.arrays import FloatArray

__all__ = ["LEVEL", "Comparison", "Estimate", "compared", "exact_sign", "holm", "quantile", "ratio_of_totals", "wilson"]

LEVEL = 0.95
"""Of every interval; tests are at one minus it."""

DRAWS = 2000
SEED = 2026

FEW = 6
"""Units below which the signed-rank test cannot be significant at 5 % (n = 5: p >= 1/16)."""

Values = Mapping[str, Sequence[float]]
"""By problem, the values of its runs."""


@dataclass(frozen=True)
class Estimate:
    """A value and its interval at ``LEVEL``."""

    value: float
    low: float
    high: float

    def text(self, digits: int = 0, scale: float = 1.0) -> str:
        """``value [low, high]``."""
        value, low, high = (f"{v * scale:,.{digits}f}" for v in (self.value, self.low, self.high))
        return f"{value} [{low}, {high}]"


def quantile(values: Values, share: float) -> Estimate:
    """A quantile of all values, interpolated, with the percentile bootstrap's interval.

    Drawn again are the problems, each with all of its values; the values of the problem if there is only one.
    """
    groups = _units(values)
    return Estimate(float(np.quantile(np.concatenate(groups), share)), *_bootstrap(groups, share))


def _units(values: Values) -> list[FloatArray]:
    groups = [np.asarray(v, dtype=np.float64) for v in values.values() if len(v)]
    return groups if len(groups) > 1 else [row for group in groups for row in group.reshape(-1, 1)]


def _bootstrap(groups: Sequence[FloatArray], share: float) -> tuple[float, float]:
    rng = np.random.default_rng(SEED)
    picks = rng.integers(0, len(groups), (DRAWS, len(groups)))
    if len({len(group) for group in groups}) == 1:  # as many seeds for each problem: all draws at once
        found = np.quantile(np.stack(groups)[picks].reshape(DRAWS, -1), share, axis=1)
    else:
        found = np.array([np.quantile(np.concatenate([groups[k] for k in pick]), share) for pick in picks])
    return _ends(found)


def _ends(found: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(found, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    return float(low), float(high)


def wilson(successes: int, runs: int) -> Estimate:
    """A share with Wilson's score interval (JASA 22, 1927), which is right near 0 and 1 too."""
    if runs == 0:
        return Estimate(math.nan, 0.0, 1.0)
    from scipy.stats import binomtest

    interval = binomtest(successes, runs).proportion_ci(LEVEL, method="wilson")
    return Estimate(successes / runs, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Comparison:
    """One measure of two contenders on the problems both have.

    Attributes:
        ratio: Median of the second's value over the first's.
        units: Problems compared; pairs of runs where there are fewer than ``FEW`` problems.
        p: Of the signed-rank test, two-sided (Wilcoxon, Biometrics Bulletin 1(6), 1945).
        adjusted: p after Holm's correction for all measures tested at once.
    """

    measure: str
    ratio: Estimate
    units: int
    p: float
    adjusted: float = math.nan

    @property
    def significant(self) -> bool:
        """Whether a difference is shown; if not, that does not show that there is none."""
        return self.adjusted < 1.0 - LEVEL

    @property
    def verdict(self) -> str:
        """In words."""
        if self.units < FEW:
            return f"not significant: {self.units} pairs are too few"
        return ("second less" if self.ratio.value < 1.0 else "second more") if self.significant else "not significant"


def compared(measure: str, pairs: Mapping[str, Sequence[tuple[float, float]]]) -> Comparison | None:
    """The paired log-ratios of positive values, by problem; None if there are none.

    Several seeds of a problem are averaged: geometric mean of their ratios. Zeros are counted as 1: a stage that asked
    nothing.
    """
    logs = {
        problem: [math.log(max(b, _least(b)) / max(a, _least(a))) for a, b in rows]
        for problem, rows in pairs.items()
        if rows
    }
    units = [math.fsum(rows) / len(rows) for rows in logs.values()]
    if len(units) < FEW:
        units = [value for rows in logs.values() for value in rows]
    if not units:
        return None
    low, high = _bootstrap([np.array([value]) for value in units], 0.5)
    ratio = Estimate(*(math.exp(value) for value in (float(np.median(units)), low, high)))
    return Comparison(measure, ratio, len(units), _signed_rank(units))


def _least(value: float) -> float:
    return value if value > 0.0 else 1.0


def _signed_rank(differences: Sequence[float]) -> float:
    from scipy.stats import wilcoxon

    if not any(differences):
        return 1.0
    with warnings.catch_warnings():  # of few or equal differences, where its p is only approximate
        warnings.simplefilter("ignore")
        return float(wilcoxon(differences, zero_method="pratt").pvalue)


def holm(found: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """All comparisons with their p adjusted for being several (Holm, Scandinavian J. of Statistics 6(2), 1979)."""
    order = sorted(range(len(found)), key=lambda k: found[k].p)
    adjusted, least = [math.nan] * len(found), 0.0
    for rank, k in enumerate(order):
        least = max(least, min(1.0, found[k].p * (len(found) - rank)))
        adjusted[k] = least
    return tuple(replace(each, adjusted=value) for each, value in zip(found, adjusted, strict=True))


def exact_sign(first: int, second: int) -> float:
    """McNemar's test, exact: p of so many pairs in which only the first, and only the second, succeeded."""
    from scipy.stats import binomtest

    return 1.0 if first + second == 0 else float(binomtest(first, first + second).pvalue)


def ratio_of_totals(pairs: Mapping[str, Sequence[tuple[float, float]]]) -> Estimate:
    """The second values' sum over the first's, with the bootstrap's interval over problems."""
    sums = np.array([[math.fsum(a for a, _ in rows), math.fsum(b for _, b in rows)] for rows in pairs.values()])
    picks = np.random.default_rng(SEED).integers(0, len(sums), (DRAWS, len(sums)))
    drawn = sums[picks].sum(axis=1)
    first, second = sums.sum(axis=0).tolist()
    return Estimate(second / first, *_ends(drawn[:, 1] / drawn[:, 0]))

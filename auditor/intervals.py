"""Interval arithmetic on arrays: each operation is rounded outwards by a unit in the last place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

__all__ = ["Interval", "cosine_and_sine", "cross", "dot", "exactly", "stacked", "upper_norm"]

Array = Any

LIBRARY = 4e-15  # above the error of numpy's sines and cosines (a few units in the last place) for angles up to 1000


class Interval:
    """All numbers between two arrays of the same shape, both included."""

    __slots__ = ("high", "low")
    __array_ufunc__ = None  # arrays leave products with intervals to these

    def __init__(self, low: Array, high: Array) -> None:
        self.low, self.high = np.asarray(low, float), np.asarray(high, float)

    def __add__(self, other: Any) -> Interval:
        other = exactly(other)
        return _out(self.low + other.low, self.high + other.high)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Interval:
        other = exactly(other)
        return _out(self.low - other.high, self.high - other.low)

    def __rsub__(self, other: Any) -> Interval:
        return exactly(other) - self

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __mul__(self, other: Any) -> Interval:
        other = exactly(other)
        a, b = self.low * other.low, self.low * other.high
        c, d = self.high * other.low, self.high * other.high
        return _out(np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d)))

    __rmul__ = __mul__

    def __getitem__(self, key: Any) -> Interval:
        return Interval(self.low[key], self.high[key])

    def root(self) -> Interval:
        """Square roots of what is not negative."""
        return _out(np.sqrt(np.maximum(self.low, 0.0)), np.sqrt(np.maximum(self.high, 0.0)))

    def inverse(self) -> Interval:
        """Of positive numbers."""
        return _out(1.0 / self.high, 1.0 / self.low)

    def total(self) -> Interval:
        """The sum along the last axis."""
        parts = [self[..., k] for k in range(self.low.shape[-1])]
        out = parts[0]
        for part in parts[1:]:
            out = out + part
        return out

    @property
    def size(self) -> Array:
        """The largest magnitude."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def widened(self, by: Array) -> Interval:
        return _out(self.low - by, self.high + by)

    def without_zero(self) -> Array:
        """Where no number is 0."""
        return (self.low > 0.0) | (self.high < 0.0)


def _out(low: Array, high: Array) -> Interval:
    return Interval(np.nextafter(low, -np.inf), np.nextafter(high, np.inf))


def exactly(x: Any) -> Interval:
    """An array as it is."""
    return x if isinstance(x, Interval) else Interval(x, x)


def stacked(parts: list[Interval], axis: int = -1) -> Interval:
    """Intervals side by side."""
    return Interval(np.stack([p.low for p in parts], axis), np.stack([p.high for p in parts], axis))


def dot(a: Any, b: Any) -> Interval:
    """Scalar products along the last axis."""
    return (exactly(a) * exactly(b)).total()


def cross(a: Any, b: Any) -> Interval:
    """Vector products along the last axis."""
    a, b = exactly(a), exactly(b)
    return stacked([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))])


def upper_norm(v: Any) -> Array:
    """No vector along the last axis is longer."""
    size = exactly(v).size
    return np.sqrt((size**2).sum(axis=-1)) * (1.0 + 1e-14)


def cosine_and_sine(x: Interval) -> tuple[Interval, Interval]:
    """Cosines and sines of all angles."""
    first = np.ceil(x.low / (0.5 * math.pi) - 1e-9)
    last = np.floor(x.high / (0.5 * math.pi) + 1e-9)
    out = []
    for f, top, bottom in ((np.cos, 0, 2), (np.sin, 1, 3)):
        ends = np.stack([f(x.low), f(x.high)])
        low, high = ends.min(axis=0) - LIBRARY, ends.max(axis=0) + LIBRARY
        low = np.where(first + np.mod(bottom - first, 4.0) <= last, -1.0, np.maximum(low, -1.0))
        high = np.where(first + np.mod(top - first, 4.0) <= last, 1.0, np.minimum(high, 1.0))
        out.append(Interval(low, high))
    return out[0], out[1]

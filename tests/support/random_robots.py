"""Random robots as URDF texts, whose joints turn, slide, turn without end, branch and mimic one another."""

from __future__ import annotations

import numpy as np

from planner_service.geometry.arrays import FloatArray
from tests.support.small_robots import joint, link, solid, urdf

__all__ = ["random_robot"]

KINDS = ("revolute", "continuous", "prismatic")
AXES = ("1 0 0", "0 1 0", "0 0 1", "0 -1 0", "0.6 0 -0.8", "1 2 -3")


def random_robot(rng: np.random.Generator, *, joints: int = 6, mimics: int = 3) -> str:
    """A tree of joints with a shape on each link; the last ``mimics`` joints mimic others, maybe mimics themselves."""
    names, kinds = [f"j{k}" for k in range(joints + mimics)], rng.choice(KINDS, joints + mimics).tolist()
    parts = [link("l0", _shape(rng))]
    for k, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        parent = k if rng.random() < 0.7 else int(rng.integers(k + 1))
        limits = {"revolute": " -2.5 2.8", "prismatic": " -0.3 0.4", "continuous": ""}[kind]
        more = '<limit velocity="2" effort="1"/>' if kind == "continuous" else ""
        more += "" if k < joints else _mimic(rng, names[int(rng.integers(k))])
        parts.append(link(f"l{k + 1}", _shape(rng)))
        where = {
            "xyz": _numbers(rng.choice([-1.0, 1.0], 3) * rng.uniform(0.08, 0.2, 3)),
            "rpy": _numbers(rng.uniform(-3.0, 3.0, 3)),
        }
        parts.append(joint(name, f"{kind} l{parent} l{k + 1}{limits}", axis=str(rng.choice(AXES)), **where, more=more))
    return urdf("random", *parts)


def _mimic(rng: np.random.Generator, leader: str) -> str:
    multiplier = float(rng.choice([1.0, -1.0, 0.5, -1.7, 2.0]))
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{rng.choice([0.0, 0.1, -0.2])}"/>'


def _shape(rng: np.random.Generator) -> str:
    kind = rng.choice(["box", "sphere", "cylinder"])
    a, b, c = rng.uniform(0.02, 0.09, 3).tolist()
    sizes = {"box": f"{a} {b} {c}", "sphere": f'radius="{a / 2}"', "cylinder": f'radius="{a / 3}" length="{b}"'}[kind]
    return solid(str(kind), sizes, _numbers(rng.uniform(-0.05, 0.05, 3)), _numbers(rng.uniform(-3.0, 3.0, 3)))


def _numbers(values: FloatArray) -> str:
    return " ".join(map(repr, values.tolist()))

"""Do points of random arms ever move farther than the verifier's levers allow?"""

from __future__ import annotations

import numpy as np

from auditor.trails import World
from benchmarks.harness.report import Promise, Report, table_of
from benchmarks.worlds.random_trees import draw_points, draw_tree

__all__ = ["run"]

DRAWS = 1_000_000
PER_TREE, PER_PIECES = 500, 100
ROUNDING = 1e-10
"""Metres."""


def run(queries: int | None, seed: int) -> Report:
    """Draw so many points, each on a way of its own."""
    chance, draws = np.random.default_rng([seed, 37]), queries or DRAWS
    excess, used, trees = -np.inf, 0.0, 0
    for _ in range(0, draws, PER_TREE):
        world = World(draw_tree(chance).robot, (), (), (), {}, 0.0)
        trees += 1
        for _ in range(PER_TREE // PER_PIECES):
            more, share = draw_points(world, chance, PER_PIECES)
            excess, used = max(excess, more), max(used, share)
    count = trees * PER_TREE
    row = {
        "points": count,
        "arms": trees,
        "most of the bound used": f"{used:.4%}",
        "farthest beyond, m": f"{excess:.1e}",
    }
    promise = Promise(f"none of {count:,} points moves farther", f"{excess:.1e} m beyond", excess <= ROUNDING)
    caption = "Trees of turning and sliding joints, mimics among them; compounds of boxes, balls, capsules, cylinders."
    return Report("evidence", (row,), (table_of("Levers of random arms", [row], caption=caption),), (promise,))

"""States: verdicts of random robots in random scenes, at random and around contact, next to Coal's."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.attack.harness import Case, Part, Wrong
from benchmarks.attack.worlds import World, draw_world
from benchmarks.worlds.contacts import JITTERS, WITHIN, first_contacts, random_states
from planner_service import CollisionChecker
from planner_service.geometry.arrays import FloatArray

__all__ = ["Attack"]

EACH = 250
"""Configurations of one world, half of them around contact."""


class Attack(Part):
    name = "states"
    what = "verdicts on random and near-contact states of random robots, alone and in a batch, next to Coal's"

    def draw(self, rng: np.random.Generator) -> Case:
        return draw_world(rng) | {"seed": int(rng.integers(2**31))}

    def run(self, case: Case) -> int:
        with tempfile.TemporaryDirectory() as folder:
            world = World(case, Path(folder))
            checker, second = CollisionChecker(world.robot, world.scene), world.independent()
        if "Q" not in case:  # what is found is kept as it stands
            case["Q"] = self._states(checker, np.random.default_rng(case["seed"])).tolist()
        Q = np.array(case["Q"]).reshape(-1, world.robot.n)
        together = checker.states_are_free(Q)
        wrong = []
        for k, q in enumerate(Q):
            ours, theirs = bool(together[k]), second.free(q)
            if k % 4 == 0 and checker.state_is_free(q) != ours:
                case["Q"] = [q.tolist()]
                raise Wrong("a state is judged the same alone and in a batch", f"{not ours} alone at {q.tolist()}")
            if ours != theirs:
                gap = abs(second.exact_gap(q))
                self.counted["verdicts unlike Coal's"] += 1
                self.extreme("most metres from contact where verdicts differ:", gap)
                if gap > WITHIN:
                    wrong.append((q, ours, gap))
        self.counted["free"] += int(together.sum())
        if wrong:
            q, ours, gap = max(wrong, key=lambda found: found[2])
            case["Q"] = [q.tolist()]
            kind = "free" if ours else "colliding"
            raise Wrong(f"a state called {kind} is", f"{gap:.3g} m from contact the other way, at {q.tolist()}")
        del case["Q"]
        return len(Q)

    def _states(self, checker: CollisionChecker, rng: np.random.Generator) -> FloatArray:
        robot = checker.robot
        Q = random_states(robot, EACH // 2, rng)
        good = checker.states_are_free(Q)
        count = min(int(good.sum()), int((~good).sum()), 8)
        if not count:
            return Q
        contacts = first_contacts(checker, Q[good][:count], Q[~good][:count])
        near = np.repeat(contacts, (EACH - len(Q)) // count, axis=0)
        ways = rng.normal(size=near.shape)
        sizes = rng.choice(JITTERS, len(near)) * rng.random(len(near))
        ways *= (sizes / np.maximum((np.abs(ways) * robot.reach()).sum(axis=1), 1e-9))[:, None]
        return np.concatenate([Q, np.clip(near + ways, robot.limits.lower, robot.limits.upper)])

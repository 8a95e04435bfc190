"""SRMP's search for several arms, run by a Python that has SRMP: queries as lines of JSON in, motions as lines out.

It imports nothing of this project. The first line describes the cell.
"""

from __future__ import annotations

import json
import os
import sys
import time
from typing import Any

import numpy as np
import srmp  # type: ignore[import-not-found]

ANSWER = "ANSWER "
"""How lines begin that are no messages of SRMP."""


def main() -> None:
    """Answer until there are no more lines."""
    cell = json.loads(sys.stdin.readline())
    planner = srmp.PlannerInterface()
    for name, arm in cell["arms"].items():
        planner.add_articulation(name, arm["tool"], arm["urdf"], arm["srdf"], [], [], np.zeros(3), True)
        planner.set_base_pose(name, pose(arm["base"]))
    for name, solid in cell["solids"].items():
        if "size" in solid:
            planner.add_box(name, np.array(solid["size"]), pose(solid["pose"]))
        else:
            planner.add_cylinder(name, *solid["cylinder"], pose(solid["pose"]))
    primitives = os.path.join(os.path.dirname(srmp.__file__), "config", "manip_6dof_timed_mprim.yaml")
    context = {"planner_id": cell["planner"]}
    for name in cell["arms"]:
        context |= {f"heuristic_{name}": "joint_euclidean", f"mprim_path_{name}": primitives}
    planner.make_planner(list(cell["arms"]), context)
    say({"ready": True})
    for line in sys.stdin:
        query = json.loads(line)
        goals = {name: srmp.GoalConstraint(srmp.GoalType.JOINTS, [q]) for name, q in query["goal"].items()}
        began = time.process_time()
        try:
            found = planner.plan_multi(query["start"], goals)
        except RuntimeError as error:
            say({"ms": 1e3 * (time.process_time() - began), "why": str(error)})
            continue
        ms = 1e3 * (time.process_time() - began)
        motions = {
            name: {"t": np.asarray(each.times).tolist(), "q": np.asarray(each.positions).tolist()}
            for name, each in found.items()
        }
        empty = any(len(each["q"]) == 0 for each in motions.values())
        say({"ms": ms, "why": "no motion"} if empty else {"ms": ms, "motions": motions})


def pose(values: list[float]) -> Any:
    """Position and quaternion w, x, y, z."""
    out = srmp.Pose()
    out.p, out.q = np.array(values[:3]), np.array(values[3:])
    return out


def say(answer: dict[str, Any]) -> None:
    """A line that is read."""
    print(f"\n{ANSWER}{json.dumps(answer)}", flush=True)


if __name__ == "__main__":
    main()

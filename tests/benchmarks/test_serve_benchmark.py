"""The study of the server: what it sends is drawn by a seed, and answers are compared by all but what a clock says."""

from __future__ import annotations

import json
from typing import Any

from benchmarks.studies.serve import asked

PLAN = {"result": {"path": [0.1, 0.2], "stages": [{"stage": "search", "seconds": 0.1, "states": 7}]}, "seconds": 1.0}


def test_a_digest_is_of_all_but_what_a_clock_says() -> None:
    change: Any
    for change, same in [
        (lambda plan: plan.update(seconds=2.0), True),
        (lambda plan: plan["result"]["stages"][0].update(seconds=2.0), True),
        (lambda plan: plan["result"]["stages"][0].update(states=8), False),
        (lambda plan: plan["result"]["path"].__setitem__(0, 0.1 + 1e-18), True),  # the same double
        (lambda plan: plan["result"]["path"].__setitem__(0, 0.10000000000000002), False),
    ]:
        changed = json.loads(json.dumps(PLAN))
        change(changed)
        assert (asked.digest(changed) == asked.digest(PLAN)) is same

"""What ``Remote`` takes for a call, in a process of its own, so that two versions of it can be asked by turns.

Run by ``load.py`` with the python of a version, the address of a server and a file of requests: for each number of a
request on standard input, the seconds that it took, on the clock and of the processor, go to standard output.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any


def main(url: str, scene: str, requests: str, *named: str) -> None:
    """Answer until there are no more numbers.

    Args:
        named: Arguments of ``Remote`` that are true.
    """
    from planner_service import PlanRequest
    from planner_service.client import Remote

    with Remote(url, scene, **dict.fromkeys(named, True)) as remote:  # type: ignore[arg-type]
        asked: list[Any] = [PlanRequest(**each) for each in json.loads(Path(requests).read_text("utf-8"))]
        for line in sys.stdin:
            cpu, began = time.process_time(), time.perf_counter()
            remote.plan(asked[int(line)])
            print(json.dumps([time.perf_counter() - began, time.process_time() - cpu]), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Forks while another thread plans: the children plan, too."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import os, threading, time
from planner_service import PlannerService, PlanRequest
request = PlanRequest((-2.5, 2.0), (2.2, -2.2), time_limit=None)
counts = PlannerService("planar2", "discs").plan(request).counts
over = False

def busy():
    service = PlannerService("planar2", "discs")
    while not over:
        service.plan(request)

threads = [threading.Thread(target=busy) for _ in range(2)]
for thread in threads:
    thread.start()
bad = 0
for _ in range(15):
    child = os.fork()
    if child == 0:
        import signal
        signal.alarm(10)
        os._exit(PlannerService("planar2", "discs").plan(request).counts != counts)
    bad += os.waitpid(child, 0)[1] != 0
over = True
for thread in threads:
    thread.join()
print(bad)
"""


@pytest.mark.slow
def test_children_of_a_process_that_plans_in_other_threads_plan() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout == "0\n", done.stderr[-2000:]

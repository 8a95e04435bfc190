"""What importing the package does to numpy's threads, and to the process around them."""

from __future__ import annotations

import os
import subprocess
import sys

from planner_service.concurrency.idle_threads import TIMEOUT

PROGRAM = """
import os, sys
before = dict(os.environ)
seen = []
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            seen.append(os.environ.get("OPENBLAS_THREAD_TIMEOUT"))
sys.meta_path.insert(0, Finder())
import planner_service
print(seen, dict(os.environ) == before)
"""


def _told(**variables: str) -> str:
    surroundings = {name: value for name, value in os.environ.items() if name != TIMEOUT} | variables
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=surroundings, capture_output=True, check=True)
    return done.stdout.decode().strip()


def test_numpy_is_loaded_with_threads_that_sleep_and_the_environment_stays_as_it_was() -> None:
    assert _told() == "['4'] True"


def test_a_timeout_that_the_user_chose_is_kept() -> None:
    assert _told(**{TIMEOUT: "20"}) == "['20'] True"

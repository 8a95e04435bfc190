"""A library is imported in a thread of its own, whatever Ctrl-C left behind."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import _imp
from planner_service.concurrency.library_import import loaded
_imp.acquire_lock()  # as Ctrl-C leaves it if it comes between two lines of importlib
def library():
    import colorsys
    return colorsys
print(loaded(library).__name__, _imp.lock_held())
"""


def test_a_library_is_imported_although_ctrl_c_has_left_pythons_import_lock_held() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60)
    assert done.stdout == "colorsys False\n", done.stderr

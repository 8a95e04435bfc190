"""Renews locks after a fork: a lock that another thread of the parent held is never released in the child.

Before Python 3.12 ``functools.cached_property`` has such a lock, one for all objects of a class.
"""

from __future__ import annotations

import sys
import threading
from functools import cached_property

__all__ = ["renew_locks"]


def renew_locks() -> None:
    """Give every cached property of this package a new lock, before Python 3.12."""
    if sys.version_info >= (3, 12):
        return
    for name, module in list(sys.modules.items()):
        if not name.startswith("planner_service"):
            continue
        for kind in list(vars(module).values()):
            if isinstance(kind, type):
                for entry in list(vars(kind).values()):
                    if isinstance(entry, cached_property):
                        vars(entry)["lock"] = threading.RLock()

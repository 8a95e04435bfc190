"""Loading a library when it is first needed, so that Ctrl-C cannot cut the import in half.

Some libraries cannot be imported again after that: Pinocchio, PIQP and what TOPP-RA draws with then stay broken until
the process ends. Ctrl-C comes to the main thread, so another one imports, and goes on if the main one is interrupted.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

__all__ = ["loaded"]

_libraries: dict[Callable[[], Any], Any] = {}

_importing = threading.Lock()
"""Held while a library is imported. A fork waits for that: in its child half an import would be there for good."""

LONGEST = 30.0
"""Seconds that a fork waits at most."""


_forking = False


def _before() -> None:
    global _forking
    _forking = _importing.acquire(timeout=LONGEST)


def _in_parent() -> None:
    if _forking:
        _importing.release()


def _in_child() -> None:
    global _importing
    _importing = threading.Lock()


os.register_at_fork(before=_before, after_in_parent=_in_parent, after_in_child=_in_child)


def loaded(load: Callable[[], Any]) -> Any:
    """The library that ``load`` imports and returns; it is called once, in a thread of its own.

    Raises:
        ImportError: whatever the import raises.
    """
    if load not in _libraries:
        errors = list[BaseException]()

        def work() -> None:
            try:
                with _importing:
                    _libraries[load] = load()
            except BaseException as error:
                errors.append(error)

        thread = threading.Thread(target=work, name=f"planner-service: {load.__name__}")
        thread.start()
        thread.join()
        if errors:
            raise errors[0]
    return _libraries[load]

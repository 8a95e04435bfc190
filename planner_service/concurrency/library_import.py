"""Imports a library when it is first needed, in a way that Ctrl-C cannot interrupt.

Some libraries cannot be imported again after an interrupted import: Pinocchio, PIQP and matplotlib stay broken until
the process ends, and OMPL ends it at once. Where a class is made, Python before 3.12 and pydantic turn Ctrl-C into an
error of their own. Ctrl-C interrupts the main thread, so another thread imports, and continues in that case.
"""

from __future__ import annotations

import _imp
import os
import threading
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["loaded"]

T = TypeVar("T")

_libraries: dict[Callable[[], Any], Any] = {}

_importing = threading.Lock()
"""Held while a library is imported. A fork waits for it: the child would keep a half-done import for ever."""

MAX_WAIT = 30.0
"""The longest that a fork, or Ctrl-C, waits for an import, in seconds."""


_forking = False


def _before() -> None:
    global _forking
    _forking = _importing.acquire(timeout=MAX_WAIT)


def _in_parent() -> None:
    if _forking:
        _importing.release()


def _in_child() -> None:
    global _importing
    _importing = threading.Lock()


os.register_at_fork(before=_before, after_in_parent=_in_parent, after_in_child=_in_child)


def loaded(load: Callable[[], T]) -> T:
    """What ``load`` imports and returns, a library or a part of one. ``load`` is called once, in a thread of its own.

    Raises:
        ImportError: What the import raised.
    """
    if load not in _libraries:
        errors, done = list[BaseException](), threading.Event()

        def work() -> None:
            try:
                with _importing:
                    _libraries[load] = load()
            except BaseException as error:
                errors.append(error)
            finally:
                done.set()

        _release_import_lock()
        thread = threading.Thread(target=work, name=f"planner-service: {load.__name__}")
        try:
            thread.start()
            done.wait()
        except KeyboardInterrupt:
            # The process may end now, and would stop the thread inside the library's own code, which OMPL's takes for
            # a reason to abort. ``join`` would not do: once interrupted, it takes a running thread for a stopped one.
            done.wait(MAX_WAIT)
            raise
        if errors:
            raise errors[0]
    library: T = _libraries[load]
    return library


def _release_import_lock() -> None:
    """Release Python's import lock if this thread holds it, or no other thread could ever import.

    Python holds it for a few lines of each import only. Ctrl-C between its acquisition and the ``try`` that releases it
    leaves it held (``importlib._bootstrap``, at least up to 3.13).
    """
    while _imp.lock_held():
        try:
            _imp.release_lock()
        except RuntimeError:  # it is another thread's
            return

"""The program of a worker process of ``Processes``: takes the work once, then answers item after item over a socket."""

from __future__ import annotations

import fcntl
import os
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from queue import SimpleQueue
from typing import Any

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.parallel.engine import TalkingWork
from planner_service.parallel.pool import Answered, Died, Event, Noted, Raised, outcome, prepare_and_freeze

__all__ = ["main"]


def main(socket: int) -> None:
    """Answer items until the other end is closed."""
    os.set_inheritable(socket, False)  # a process that the work starts must not keep it open
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent, which kills this process
    _die_with_parent()
    connection: Connection[Any, Any] = Connection(socket)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        _serve(connection)


def _die_with_parent() -> None:
    """Have Linux kill this process when standard input closes, as it does when the parent dies.

    This works even while native code computes and no Python runs. On other systems the process ends after its item.
    """
    fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(0, fcntl.F_SETFL, fcntl.fcntl(0, fcntl.F_GETFL) | os.O_ASYNC)


def _serve(connection: Connection[Any, Any]) -> None:
    connection.send_bytes(b"")  # reading from now on: a large work does not block the parent
    prepared = outcome(_prepare, connection.recv_bytes(), lambda note: _send(connection, Noted(note)))
    event = Answered(None) if isinstance(prepared, Answered) else prepared
    _send(connection, event)
    if not isinstance(prepared, Answered):
        return
    work = prepared.value
    items = _Items(connection, work) if isinstance(work, TalkingWork) else iter(connection.recv_bytes, None)
    for sent in items:
        event = outcome(_answer, work, sent)
        _send(connection, event)
        if isinstance(event, Died):
            return


class _Items(Iterator[Any]):
    """The items that come over a connection, while a thread hands the notes between them to the work."""

    def __init__(self, connection: Connection[Any, Any], work: TalkingWork) -> None:
        self._connection, self._work = connection, work
        self._items: SimpleQueue[Any] = SimpleQueue()
        threading.Thread(target=self._listen, name="notes", daemon=True).start()

    def __next__(self) -> Any:
        item = self._items.get()
        if item is None:
            raise EOFError
        return item

    def _listen(self) -> None:
        try:
            while True:
                sent = self._connection.recv_bytes()
                event = outcome(_unpickled, "item", sent)
                if isinstance(event, Answered) and isinstance(event.value, Noted):
                    self._work.told(event.value.value)
                else:
                    self._items.put(event)
        except (EOFError, OSError):
            self._items.put(None)


def _prepare(sent: bytes, send: Callable[[Any], None]) -> Any:
    work = _unpickled("work", sent)
    if isinstance(work, TalkingWork):
        work.connect(send)
    prepare_and_freeze(work)
    return work


def _answer(work: Any, sent: Any) -> Any:
    """The answer to an item, as bytes, or as the outcome of reading them."""
    if isinstance(sent, Raised):
        raise sent.error
    if isinstance(sent, Died):
        raise MemoryError(sent.detail)
    return work(sent.value if isinstance(sent, Answered) else _unpickled("item", sent))


def _unpickled(name: str, sent: bytes) -> Any:
    try:
        return ForkingPickler.loads(sent)
    except (AttributeError, ImportError) as error:
        expected = "one made of classes and functions from modules; a worker does not run the calling script"
        raise InvalidRequest(name, str(error), expected) from error


def _send(connection: Connection[Any, Any], event: Event) -> None:
    try:
        message = ForkingPickler.dumps(event)
        if isinstance(event, Raised):
            ForkingPickler.loads(message)  # many exceptions can be pickled but not unpickled
    except Exception as error:
        origin = event.traceback if isinstance(event, Raised) else traceback.format_exc()
        message = ForkingPickler.dumps(Raised(BrokenInvariant(f"a worker cannot send what it has: {error}"), origin))
    connection.send_bytes(message)

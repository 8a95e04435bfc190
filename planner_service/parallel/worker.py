"""A worker of ``Processes``: it is told its work once, and then item after item over a socket."""

from __future__ import annotations

import fcntl
import os
import signal
import traceback
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.parallel.events import Event, Gone, Raised, Ready, outcome

__all__ = ["main"]


def main(socket: int) -> None:
    """Work until the other end is closed."""
    os.set_inheritable(socket, False)  # what a work starts is not to keep it open when this is no more
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever started this; this is ended from there
    _end_with_the_parent()
    connection: Connection[Any, Any] = Connection(socket)
    try:
        _work(connection)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def _end_with_the_parent() -> None:
    """Have Linux end this process when standard input is closed, as it is when the parent is no more.

    It holds while a library computes and lets no Python run. Elsewhere the process ends when its item is done.
    """
    fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(0, fcntl.F_SETFL, fcntl.fcntl(0, fcntl.F_GETFL) | os.O_ASYNC)


def _work(connection: Connection[Any, Any]) -> None:
    connection.send(Ready())
    sent = connection.recv_bytes()
    try:
        work = _opened("work", sent)
        work.prepare()
    except Exception as error:
        _tell(connection, Raised(error, traceback.format_exc()))
        return
    connection.send(Ready())
    while True:
        sent = connection.recv_bytes()
        try:
            item = _opened("item", sent)
        except Exception as error:
            event: Event = Raised(error, traceback.format_exc())
        else:
            event = outcome(work, item)
        _tell(connection, event)
        if isinstance(event, Gone):
            return


def _opened(name: str, sent: bytes) -> Any:
    try:
        return ForkingPickler.loads(sent)
    except (AttributeError, ImportError) as error:
        expected = "one made of classes and functions from modules; a worker does not run the calling script"
        raise InvalidRequest(name, str(error), expected) from error


def _tell(connection: Connection[Any, Any], event: Event) -> None:
    try:
        message = ForkingPickler.dumps(event)
        if isinstance(event, Raised):
            ForkingPickler.loads(message)  # many an error can be sent and not be made again
    except Exception as error:  # an answer, or an error, that cannot be sent
        told = event.traceback if isinstance(event, Raised) else traceback.format_exc()
        message = ForkingPickler.dumps(Raised(BrokenInvariant(f"a worker cannot send what it has: {error}"), told))
    connection.send_bytes(message)

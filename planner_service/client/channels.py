"""Channels to a server that are kept open: as many as there are threads that ask at the same time."""

from __future__ import annotations

import math
import weakref
from contextlib import suppress
from typing import TYPE_CHECKING

from planner_service.client.answer import Answer, Lost, Work
from planner_service.client.http_connections import ServerAddress
from planner_service.collision import CancelToken
from planner_service.errors import MissingDependency

if TYPE_CHECKING:
    from planner_service.client.channel import Channel

__all__ = ["Channels"]

ENDING = 1.0
"""Seconds for which the answer to what is withdrawn is waited for."""


class Channels:
    """Asks a server for work; several threads may do so at the same time.

    Raises:
        MissingDependency: The extra ``client`` is not installed.
    """

    def __init__(self, address: ServerAddress) -> None:
        try:
            from planner_service.client import channel
        except ImportError as error:
            raise MissingDependency((error.name or "websockets").partition(".")[0], "client") from None
        self._channels, self._address, self._free = channel, address, list["Channel"]()
        weakref.finalize(self, _close, self._free)

    def close(self) -> None:
        """Close those that nobody uses."""
        _close(self._free)

    def ask(self, work: Work, cancel: CancelToken | None, seconds: float = math.inf) -> Answer:
        """The answer to a request for work, once it is there.

        Args:
            cancel: Withdraws it when cancelled from another thread; what is answered then says so.
            seconds: It is taken for lost after so many.

        Raises:
            Lost: The channel was lost, or there is none.
            InvalidRequest: The request has a value that msgpack has not.
            InvalidFile: The answer is no reply of a channel.
        """
        try:
            channel = self._quiet() or self._channels.Channel(self._address)
            try:
                answer = channel.ask(work, cancel, seconds)
            except BaseException:
                channel.close()
                raise
        except self._channels.Refusal as refusal:
            return refusal.answer
        except OSError as error:
            raise Lost(f"{type(error).__name__}: {error}") from error
        self._free.append(channel)
        return answer

    def withdraw(self, work: Work) -> None:
        """Cancel some work; what has ended stays, as long as the server keeps it."""
        cancel = CancelToken()
        cancel.cancel()
        self.ask(work, cancel, ENDING)

    def _quiet(self) -> Channel | None:
        """One that is open and that nobody uses."""
        while self._free:
            with suppress(IndexError):  # another thread has taken the last one
                channel = self._free.pop()
                if channel.is_quiet:
                    return channel
                channel.close()
        return None


def _close(channels: list[Channel]) -> None:
    while channels:
        channels.pop().close()

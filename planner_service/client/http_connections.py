"""HTTP connections that are kept open: as many as there are threads that ask at the same time."""

from __future__ import annotations

import http.client
import re
import select
import socket
import ssl
import weakref
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from urllib.parse import SplitResult, urlsplit

from planner_service.client.answer import CONNECT, SILENCE, WAIT, Answer, Lost, pause
from planner_service.errors import InvalidFile, InvalidRequest

__all__ = ["HttpConnections", "ServerAddress", "is_quiet"]


@dataclass(frozen=True)
class ServerAddress:
    """Where a server is, and what every request to it says.

    Attributes:
        url: Such as ``http://127.0.0.1:8080``.
        headers: Its token, if it wants one.

    Raises:
        InvalidRequest: The address is none of a server.
    """

    url: str
    headers: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        expected = "the address of a server, such as http://127.0.0.1:8080"
        parts = None
        if isinstance(self.url, str) and self.url.isascii() and self.url.isprintable() and " " not in self.url:
            with suppress(ValueError):
                parts = urlsplit(self.url)
                parts.port  # noqa: B018 - ValueError if it is none
        if parts is None or parts.scheme not in ("http", "https") or not parts.hostname:
            raise InvalidRequest("url", self.url, expected)
        if parts.path not in ("", "/") or "@" in parts.netloc or parts.query or parts.fragment:
            raise InvalidRequest("url", self.url, expected)
        object.__setattr__(self, "url", self.url.rstrip("/"))

    @cached_property
    def parts(self) -> SplitResult:
        """The parts of the address."""
        return urlsplit(self.url)

    @cached_property
    def _encryption(self) -> ssl.SSLContext:
        return ssl.create_default_context()

    def connection(self) -> http.client.HTTPConnection:
        """A new connection; no proxy sees the token.

        Raises:
            OSError: There is no server.
        """
        made: http.client.HTTPConnection
        host, port = self.parts.hostname or "", self.parts.port
        if self.parts.scheme == "https":
            made = http.client.HTTPSConnection(host, port, timeout=CONNECT, context=self._encryption)
        else:
            made = http.client.HTTPConnection(host, port, timeout=CONNECT)
        made.connect()
        made.sock.settimeout(WAIT + SILENCE)
        return made


class HttpConnections:
    """Asks a server; several threads may do so at the same time."""

    def __init__(self, address: ServerAddress) -> None:
        self._address, self._free = address, list[http.client.HTTPConnection]()
        weakref.finalize(self, _close, self._free)

    def close(self) -> None:
        """Close those that nobody uses."""
        _close(self._free)

    def ask(self, method: str, path: str, content: bytes | None, headers: Mapping[str, str], most: int) -> Answer:
        """The answer to one request.

        Args:
            most: Bytes that the answer may have.

        Raises:
            Lost: The connection was lost, or there is none.
            InvalidFile: The answer is too large.
        """
        url = f"{self._address.url}{path}"
        typed = {} if content is None else {"Content-Type": "application/json"}
        try:
            connection = self._connection()
            try:
                connection.request(method, path, content, {**self._address.headers, **headers, **typed})
                response = connection.getresponse()
                length = response.length
                data = b"" if length is not None and length > most else response.read(most + 1)
            except BaseException:
                connection.close()
                raise
        except (OSError, http.client.HTTPException) as error:
            raise Lost(f"{type(error).__name__}: {error}") from error
        if response.isclosed() and not response.will_close:
            self._free.append(connection)
        else:
            connection.close()
        if max(len(data), length or 0) > most:
            raise InvalidFile(url, [f"too large: more than {most:,} bytes"])
        if length is not None and len(data) < length:
            raise Lost(f"the last {length - len(data):,} bytes of an answer are missing")
        told, place = response.headers, "location" if response.status == 202 else "content-location"
        after = told.get("retry-after", "")
        return Answer(
            url,
            response.status,
            data,
            told.get("content-type", "").startswith("application/problem+json"),
            pause(int(after) if re.fullmatch("[0-9]{1,9}", after) else 0),
            told.get(place, "").rpartition("/")[2],
        )

    def _connection(self) -> http.client.HTTPConnection:
        """One that is open and that nobody uses, or a new one."""
        while self._free:
            with suppress(IndexError):  # another thread has taken the last one
                connection = self._free.pop()
                if is_quiet(connection.sock):
                    return connection
                connection.close()  # the server has closed it meanwhile
        return self._address.connection()


def is_quiet(connection: socket.socket) -> bool:
    """Whether a connection is open, and nothing has come over it."""
    poll = select.poll()
    poll.register(connection, select.POLLIN)
    return not poll.poll(0)


def _close(connections: list[http.client.HTTPConnection]) -> None:
    while connections:
        connections.pop().close()

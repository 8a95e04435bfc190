"""A channel to a server: a WebSocket with msgpack in its frames, for one request after the other."""

from __future__ import annotations

import socket
import time
from collections import deque
from contextlib import suppress
from typing import Any

from websockets.client import ClientProtocol
from websockets.frames import DATA_OPCODES, Opcode
from websockets.http11 import Response
from websockets.protocol import State
from websockets.uri import parse_uri

from planner_service.client.answer import LOOK, SILENCE, WAIT, Answer, Lost, Work, of_numpy, pause
from planner_service.client.http_connections import ServerAddress, is_quiet
from planner_service.collision import CancelToken
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import MAX_BYTES
from planner_service.records.http.frames import packed, unpacked

__all__ = ["Channel", "Refusal"]

CHUNK = 262_144
"""Bytes that are read at once."""


class Refusal(Exception):
    """A server that lets nobody have a channel; ``answer`` says why."""

    def __init__(self, answer: Answer) -> None:
        super().__init__(answer.url)
        self.answer = answer


class Channel:
    """One channel, for one request after the other."""

    def __init__(self, address: ServerAddress) -> None:
        self._url, self._asked = address.url, 0
        self._messages, self._parts = deque[bytes](), list[bytes]()
        self._connection = address.connection()
        try:
            self._socket: socket.socket = self._connection.sock
            uri = parse_uri(f"ws{address.url.removeprefix('http')}/channel")
            self._protocol = ClientProtocol(uri, max_size=MAX_BYTES)
            request = self._protocol.connect()
            request.headers.update(address.headers)
            self._protocol.send_request(request)
            self._shake_hands()
        except BaseException:
            self.close()
            raise

    @property
    def is_quiet(self) -> bool:
        """Whether it is open, and nothing has come over it."""
        return is_quiet(self._socket)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def ask(self, work: Work, cancel: CancelToken | None, seconds: float) -> Answer:
        """See ``Channels``; OSError, too, if it was lost."""
        self._asked += 1
        asked = {"id": self._asked, "verb": work.kind, "body": work.body, "key": work.key}
        try:
            data = packed(asked | ({"robot": "hash"} if work.by_hash else {}), of_numpy)
        except (ValueError, TypeError) as error:
            raise InvalidRequest("request", str(error), "values that a frame can hold") from None
        self._send(data)
        end, withdrawn = time.monotonic() + seconds, False
        heard, pinged = time.monotonic(), False
        while not self._messages:
            if cancel is not None and cancel.cancelled and not withdrawn:
                self._send(packed({"id": self._asked, "verb": "cancel"}))
                withdrawn = True
            now = time.monotonic()
            if now > end or now > heard + WAIT + SILENCE:
                raise Lost("no answer came over the channel")
            if now > heard + WAIT and not pinged:
                self._protocol.send_ping(b"")
                self._flush()
                pinged = True
            looks = cancel is not None and not withdrawn
            if self._receive(LOOK if looks else min(WAIT, end - now + LOOK)):
                heard, pinged = time.monotonic(), False
        return self._answer(self._messages.popleft(), work)

    def _shake_hands(self) -> None:
        """Begin to be a channel.

        Raises:
            Refusal: The server answered otherwise.
        """
        self._flush()
        end = time.monotonic() + WAIT + SILENCE
        events: list[Any] = []
        while not events and self._protocol.handshake_exc is None:
            if time.monotonic() > end or not self._feed(WAIT):
                raise Lost("the server does not open a channel")
            events = self._protocol.events_received()
        error = self._protocol.handshake_exc
        response = events.pop(0) if events else None
        if error is not None:
            if not isinstance(response, Response) or response.status_code < 400:
                raise Lost(f"the server opens no channel: {error}")
            kind = response.headers.get("content-type", "")
            content = bytes(response.body or b"")
            problem = kind.startswith("application/problem+json")
            raise Refusal(Answer(f"{self._url}/channel", response.status_code, content, problem))
        self._take(events)

    def _receive(self, seconds: float) -> bool:
        """Take what comes; whether anything has within so many seconds."""
        heard = self._feed(seconds)
        self._take(self._protocol.events_received())
        return heard

    def _feed(self, seconds: float) -> bool:
        self._socket.settimeout(seconds)
        try:
            data = self._socket.recv(CHUNK)
        except TimeoutError:
            return False
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        self._flush()
        return True

    def _take(self, frames: list[Any]) -> None:
        for frame in frames:
            if frame.opcode is Opcode.TEXT:
                raise InvalidFile(f"{self._url}/channel", ["a text in place of bytes"])
            if frame.opcode in DATA_OPCODES:
                self._parts.append(bytes(frame.data))
                if frame.fin:
                    self._messages.append(b"".join(self._parts))
                    self._parts.clear()
        if self._protocol.state is not State.OPEN and not self._messages:
            close = self._protocol.close_rcvd
            raise Lost("the server has closed the channel" + ("" if close is None else f": {close.reason}"))

    def _send(self, data: bytes) -> None:
        self._protocol.send_binary(data)
        self._flush()

    def _flush(self) -> None:
        self._socket.settimeout(SILENCE)
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)
            else:
                with suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)

    def _answer(self, message: bytes, work: Work) -> Answer:

        url = f"{self._url}/{work.kind}"
        try:
            reply = unpacked(message)
        except ValueError as error:
            raise InvalidFile(url, [f"the frame is {error}"]) from None
        said = reply if isinstance(reply, dict) else {}
        status, job, after = said.get("status"), said.get("job"), said.get("retry_after", 0)
        mine = not isinstance(said.get("answer", b""), bytes) and said.get("id") in (self._asked, None)
        if not mine or not isinstance(status, int) or not isinstance(job, str) or not isinstance(after, int):
            raise InvalidFile(url, ["expected the reply to a request, with id, status, job and answer"])
        return Answer(url, status, said["answer"], status >= 400, pause(after), job)

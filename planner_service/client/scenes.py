"""Scenes on a server: the stored ones, and a client's own, which are sent once and named by their content."""

from __future__ import annotations

import threading
from collections import OrderedDict
from contextlib import suppress
from typing import Any
from urllib.parse import quote

from planner_service.client.connection import Connection
from planner_service.client.problems import ServerRefused, StaleVersion
from planner_service.errors import PlannerServiceError
from planner_service.records.http.replies import SceneReply, StoredReply
from planner_service.records.scene import SceneRecord
from planner_service.scene.scene import Scene

__all__ = ["ScenesOnServer"]

MAX_KEPT = 32
"""Scenes of its own that a client leaves on a server; the one unused for longest is deleted first."""

PREFIX = "client-"


class ScenesOnServer:
    """What scenes a client uses on its server. Several threads may use it at the same time."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._own: OrderedDict[str, int] = OrderedDict()
        self._lock = threading.Lock()

    def stored(self, name: str) -> tuple[Scene, int]:
        """A stored scene and its version.

        Raises:
            ServerRefused: there is none of that name.
            InvalidFile: what the server sent is no scene.
        """
        answer = self._connection.fetch("GET", _address(name))
        stored = answer.read(SceneReply)
        return stored.value, stored.version

    def put(self, name: str, scene: Scene, *, before: int | None = None) -> int:
        """Store a scene under a name, and the version it then has.

        Args:
            before: The version that it replaces, 0 if there is none yet; None for whichever there is.

        Raises:
            StaleVersion: there is another version.
            InvalidRequest: the server takes no such name, or the scene has no place in a file.
        """
        document = SceneRecord.of(scene).document()
        body = {field: document[field] for field in ("description", "obstacles", "attached")}
        condition = {} if before is None else {"If_Match": f'"{before}"'} if before else {"If_None_Match": "*"}
        try:
            answer = self._connection.fetch("PUT", _address(name), body, **condition)
        except StaleVersion:  # perhaps of a first try, whose answer was lost
            with suppress(ServerRefused):
                stored, latest = self.stored(name)
                same = (stored.hash, stored.description) == (scene.hash, scene.description)
                if same and (before == 0 or latest - 1 == before):
                    return latest
            raise
        return answer.read(StoredReply).version

    def reference(self, scene: Scene, *, again: bool = False) -> dict[str, Any]:
        """How requests name a scene of the client's own, which is sent if the server does not have it.

        Args:
            again: Whether to send it even if it was sent before.
        """
        name = PREFIX + scene.hash[:40]
        with self._lock:
            version = None if again else self._own.get(name)
        if version is None:
            version = self._sent(name, scene)
        with self._lock:
            self._own[name] = version
            self._own.move_to_end(name)
            old = [self._own.popitem(last=False)[0] for _ in range(len(self._own) - MAX_KEPT)]
        self._delete(old)
        return {"name": name, "version": version}

    def forget(self) -> None:
        """Delete the client's own from the server."""
        with self._lock:
            names = list(self._own)
            self._own.clear()
        self._delete(names)

    def _sent(self, name: str, scene: Scene) -> int:
        try:
            return self.put(name, scene, before=0)
        except StaleVersion:
            return self.put(name, scene)

    def _delete(self, names: list[str]) -> None:
        for name in names:
            with suppress(PlannerServiceError):  # another client has deleted it
                self._connection.fetch("DELETE", f"/scenes/{name}")


def _address(name: str) -> str:
    return f"/scenes/{quote(name, safe='')}"

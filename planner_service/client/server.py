"""A server as its clients know it: its robot, their scenes on it, and which motions it has made."""

from __future__ import annotations

import threading
from functools import cached_property
from weakref import WeakKeyDictionary

from planner_service.client.connection import Connection
from planner_service.client.scenes import ScenesOnServer
from planner_service.errors import InvalidRequest
from planner_service.path.trajectory import Trajectory
from planner_service.planning.request import World
from planner_service.records.http.replies import RobotReply

__all__ = ["Server"]


class Server:
    """What all that use one server have in common."""

    def __init__(self, connection: Connection) -> None:
        self.connection, self.scenes = connection, ScenesOnServer(connection)
        self._plans: WeakKeyDictionary[Trajectory, str] = WeakKeyDictionary()
        self._lock = threading.Lock()

    @cached_property
    def world(self) -> World:
        """The server's robot, and how its motions are checked."""
        served: World = self.connection.fetch("GET", "/robot").read(RobotReply).value
        return served

    def remember(self, trajectory: Trajectory | None, job: str) -> None:
        """Remember under which id the server keeps a motion."""
        if trajectory is not None and job:
            with self._lock:
                self._plans[trajectory] = job

    def plan_of(self, trajectory: Trajectory | None) -> str:
        """The id of a motion.

        Raises:
            InvalidRequest: it is none of this server.
        """
        with self._lock:
            job = None if trajectory is None else self._plans.get(trajectory)
        if job is None:
            raise InvalidRequest("previous", "a motion that this server has not made", "one that it has planned")
        return job

"""A page that is open: its address, until when it is there, and its end."""

from __future__ import annotations

import contextlib
import io
import socket
import sys
import threading
import time
from typing import Any

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.geometry.shapes import whole
from planner_service.planning.world import World
from planner_service.presentation.page import Showable
from planner_service.service import PlannerService
from planner_service.view.page import Page
from planner_service.view.state import ViewState

__all__ = ["HOST", "PORT", "Viewer", "interactive", "open_viewer", "show"]

HOST, PORT = "127.0.0.1", 8080

GRACE = 3.0
"""Seconds after the last page was closed in which it may come back: a reload closes it, too."""


class Viewer:
    """A page in the browser, served from this process until its last window is closed.

    Attributes:
        url: Its address.
        page: What it shows.
    """

    def __init__(self, server: Any, page: Page, *, keep: bool) -> None:
        self._server, self.page, self._keep = server, page, keep
        self.url = f"http://{server.get_host()}:{server.get_port()}"
        self._ended, self._lock = threading.Event(), threading.Lock()
        self._seen, self._empty_since = False, time.monotonic()
        server.on_client_connect(self._came)
        threading.Thread(target=self._watch, name="planner-service view: watch", daemon=True).start()

    def _came(self, _: Any) -> None:
        self._seen = True

    def _watch(self) -> None:
        while not self._ended.wait(0.2):
            if self._server.get_clients() or not self._seen:
                self._empty_since = time.monotonic()
            elif not self._keep and time.monotonic() - self._empty_since > GRACE:
                self.close()

    @property
    def open(self) -> bool:
        """Whether it is still served."""
        return not self._ended.is_set()

    def wait(self) -> None:
        """Return when its last window was closed, or it was closed here; Ctrl-C closes it and comes through."""
        try:
            while not self._ended.wait(0.5):
                pass
        finally:
            self.close()

    def close(self) -> None:
        """Stop serving it; nothing of it is left running."""
        with self._lock:
            if self._ended.is_set():
                return
            self.page.close()
            with contextlib.redirect_stdout(io.StringIO()):  # viser prints that it stopped
                self._server.stop()
            self._ended.set()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Viewer at {self.url}, {'open' if self.open else 'closed'}>"

    def _repr_html_(self) -> str:
        """The page inside a notebook."""
        return f'<iframe src="{self.url}" width="100%" height="640" style="border: 0"></iframe>'


def show(
    world: World, shown: Showable | None = None, *, host: str = HOST, port: int = PORT, block: bool | None = None
) -> Viewer:
    """Open a page and print its address; see ``PlannerService.view``."""
    viewer = open_viewer(PlannerService.of(world), shown, host=host, port=port)
    print(f"view: {viewer.url}", flush=True)
    if not interactive() if block is None else block:
        viewer.wait()
    return viewer


def open_viewer(
    service: PlannerService, shown: Showable | None, *, host: str = HOST, port: int = PORT, keep: bool = False
) -> Viewer:
    """A page that shows a service's robot and scene, and a plan or a task.

    Args:
        port: The first to try; if it is taken the next free one. 0 for any.
        keep: Whether to go on serving when the last window was closed.

    Raises:
        InvalidRequest: no such port or host, or nothing that can be shown.
        MissingDependency: viser is not installed.
    """
    state = ViewState.of(service, shown)
    whole("port", port, 0, 65_535)
    if not host:  # to sockets that is every address there is
        raise InvalidRequest("host", host, f"an address of this machine, such as {HOST}")
    try:
        import viser
    except ImportError:
        raise MissingDependency("viser", "view") from None
    try:
        with socket.create_server((host, 0)):
            pass
    except OSError as error:
        raise InvalidRequest("host", host, f"an address of this machine ({error})") from None
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints its addresses
        server = viser.ViserServer(host, port, label="planner-service", verbose=False)
    server.request_share_url = _not_shared  # a page of another site could ask for it
    return Viewer(server, Page(server, state), keep=keep)


def _not_shared(*_: object, **__: object) -> None:
    """In place of viser's way to make a page public: nothing leaves this machine."""


def interactive() -> bool:
    """Whether a person types at this process: a notebook or a prompt."""
    return hasattr(sys, "ps1") or bool(sys.flags.interactive)

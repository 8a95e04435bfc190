"""Opens the page of a gate."""

from __future__ import annotations

from planner_service.gate import ActionGate
from planner_service.geometry.validation import instance
from planner_service.view.gate.page import GatePage
from planner_service.view.serving.viewer import HOST, PORT, ServedPage, served

__all__ = ["GateViewer", "watch"]


class GateViewer(ServedPage):
    """The page of a gate, served from this process until its last window is closed.

    Attributes:
        url: The page's address. It ends with a token, without which nothing is answered.
        page: The page itself.
    """

    page: GatePage


def watch(gate: ActionGate, *, host: str = HOST, port: int = PORT, keep: bool = True) -> GateViewer:
    """Open a page that shows what a gate decides while it does: the arm, its tube, its stop, and what was refused.

    It returns at once; the gate is used as without it, in any thread::

        with watch(gate) as viewer:
            print(viewer.url)
            ...  # check and send

    Args:
        gate: Of this process. Its thread is asked for nothing, but drawing takes some milliseconds of Python's lock
            eight times a second, for which a check may have to wait.
        host: The address to serve it at. Anyone who can reach it can look at it.
        port: The first port to try; if it is taken, the next free one is used. 0 for any.
        keep: Go on serving after the last window was closed.

    Raises:
        InvalidRequest: no gate, or no such host or port.
        MissingDependency: viser is not installed.
    """
    instance("gate", gate, ActionGate, "an ActionGate")
    server = served(host, port)
    return GateViewer(server, GatePage(server.viser, gate), keep=keep)

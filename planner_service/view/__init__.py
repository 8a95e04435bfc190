"""Shows robots, scenes and plans: an interactive page in the browser, and PNG pictures."""

from planner_service.view.gate.watching import GateViewer, watch
from planner_service.view.serving.viewer import HOST, PORT, Viewer, open_viewer, show

__all__ = ["HOST", "PORT", "GateViewer", "Viewer", "open_viewer", "show", "watch"]

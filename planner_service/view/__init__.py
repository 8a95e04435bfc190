"""Shows robots, scenes and plans: an interactive page in the browser, and PNG pictures."""

from planner_service.view.serving.viewer import HOST, PORT, Viewer, open_viewer, show

__all__ = ["HOST", "PORT", "Viewer", "open_viewer", "show"]

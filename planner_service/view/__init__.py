"""Pictures of robots, scenes and plans: their geometry as triangles, and a page in the browser to look at them."""

from planner_service.view.viewer import HOST, PORT, Viewer, open_viewer, show

__all__ = ["HOST", "PORT", "Viewer", "open_viewer", "show"]

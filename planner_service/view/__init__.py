"""Pictures of robots, scenes and plans: their geometry as triangles, and a page in the browser to look at them."""

from planner_service.view.state import Shown
from planner_service.view.viewer import HOST, PORT, Viewer, interactive, open_viewer

__all__ = ["HOST", "PORT", "Shown", "Viewer", "interactive", "open_viewer"]

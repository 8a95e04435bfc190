"""The commands ``planner-service reachability``."""

from planner_service.cli.workspace.commands import maps
from planner_service.cli.workspace.placing import place

__all__ = ["maps", "place"]

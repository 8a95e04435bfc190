"""The commands ``planner-service reachability``."""

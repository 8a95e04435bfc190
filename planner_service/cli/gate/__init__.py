"""The commands ``planner-service gate``."""

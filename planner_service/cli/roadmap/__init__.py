"""The commands ``planner-service roadmap``."""

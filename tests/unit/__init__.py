"""One folder for each package of planner_service."""

"""An independent checker of plans: built on Coal, it imports nothing of planner_service."""

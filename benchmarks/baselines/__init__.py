"""What planner_service is compared with."""

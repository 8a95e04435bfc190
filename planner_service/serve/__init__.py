"""One planner for many programs: ``planner-service serve`` answers over HTTP, with the library's plans and counts."""

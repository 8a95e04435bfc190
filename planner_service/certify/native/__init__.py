"""The compiled proof ``_proof``; it shares nothing with the compiled core in ``planner_service/native``."""

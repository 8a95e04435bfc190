"""Cell decomposition of joint space; its proofs are offered by ``planner_service.infeasibility``."""

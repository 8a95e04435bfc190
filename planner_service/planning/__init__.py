"""The pipeline behind ``PlannerService.plan``: request, stages, result."""

"""Whether an installed wheel has its compiled code, and plans with it; wheels are tried with this."""

from planner_service import PlannerService, PlanRequest
from planner_service.certify import certifier
from planner_service.collision import native_kernel

assert native_kernel.instruction_sets()
assert certifier.instruction_sets()
service = PlannerService("wxai", "bin")
home = service.robot.home
result = service.plan(PlanRequest(home, home + 0.1))
assert result.certificate is not None
assert result.certificate.certified
print(f"planned and proven with {service.checker.instruction_set}")

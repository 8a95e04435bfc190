"""Fill a pallet with 24 boxes from a belt, each motion proven. Run: python examples/14_fill_a_pallet.py"""

from planner_service import Box, Handling, Obstacle, PlannerService, Pose, Scene
from planner_service.tasks import Task, pick_steps, place_steps

BOX, ARRIVES = Box((0.12, 0.1, 0.1)), Pose((0.1, -0.55, -0.099))
FLOOR = Obstacle("floor", Box((2.6, 2.6, 0.1)), Pose((0.0, 0.0, -0.451)))
PALLET = Obstacle("pallet", Box((0.54, 0.35, 0.12)), Pose((0.58, 0.1, -0.34)))
BELT = Obstacle("belt", Box((0.2, 0.3, 0.25)), Pose((0.1, -0.62, -0.275)))
GUARD = Obstacle("guard", Box((0.54, 0.01, 0.35)), Pose((0.58, -0.3, -0.225)))

service = PlannerService("ur5_vacuum", Scene((FLOOR, PALLET, BELT, GUARD), name="pallet"))
q, memory = service.robot.home, None
for n in range(24):
    layer, column, row = n // 12, 3 - n % 12 // 3, 2 - n % 3  # far places before near ones
    place = Pose((0.58 + 0.13 * (column - 1.5), 0.1 + 0.11 * (row - 1), -0.229 + 0.101 * layer))
    service = service.with_scene(service.scene.with_obstacle(Obstacle(f"box_{n}", BOX, ARRIVES)))
    under = Handling(support=f"box_{n - 12}" if layer else "pallet")
    steps = (pick_steps(f"box_{n}", None, Handling(support="belt")), place_steps(f"box_{n}", [place], under))
    done = service.solve(Task(steps), q, memory=memory)
    print(f"box_{n}: {done.failure or f'{done.duration:.1f} s of motion, {done.counts.states:,} states'}")
    service, q, memory = PlannerService.of(done.world), done.q, done.memory

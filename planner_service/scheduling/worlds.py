"""What stands around an arm during a chain of motions: every object wherever it may be meanwhile.

An object of another job is where it was, and where it goes, both at once. Where it was it is left out only if another
chain has it in hand by then for certain. What an arm holds is a part of that arm (``lines``), not of any scene. So
whatever the arms' delays are, an object is at each time in a place that every other arm keeps clear of.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.scene.scene import Obstacle, Scene
from planner_service.scheduling.jobs import PickJob

__all__ = ["after", "before", "require_jobs", "there"]


def there(name: str) -> str:
    """What an object is called where it goes."""
    return f"{name}@place"


def before(scene: Scene, jobs: Sequence[PickJob], job: PickJob | None, gone: Collection[str]) -> Scene:
    """What stands there when a chain starts.

    Args:
        job: Its job; None for an arm that has none.
        gone: Objects that are no longer where they were.
    """
    kept = [each for each in scene.obstacles if each.name not in gone]
    shapes = {each.name: each for each in scene.obstacles}
    new = [
        Obstacle(there(each.object), shapes[each.object].shape, each.place, shapes[each.object].colour)
        for each in jobs
        if job is None or each.object != job.object
    ]
    return Scene((*kept, *new), name=scene.name)


def after(scene: Scene, job: PickJob) -> Scene:
    """What stands there when a chain has ended that began in this scene."""
    taken = scene.obstacle(job.object)
    return scene.without(job.object).with_obstacle(Obstacle(job.object, taken.shape, job.place, taken.colour))


def require_jobs(scene: Scene, arms: Collection[str], jobs: Sequence[PickJob]) -> None:
    """Refuse jobs that are none of these arms, in this scene.

    Raises:
        UnknownName: There is no such obstacle or arm.
        InvalidRequest: An object is in two jobs, is a support of another, or a name is taken.
    """
    objects = [job.object for job in jobs]
    for k, job in enumerate(jobs):
        scene.obstacle(job.object)
        if job.support is not None:
            scene.obstacle(job.support)
            if job.support in objects:
                raise InvalidRequest(f"jobs[{k}].support", job.support, "an obstacle that stays where it is")
        if objects.index(job.object) != k:
            raise InvalidRequest(f"jobs[{k}].object", job.object, "an object that is in no other job")
        for name in job.arms:
            if name not in arms:
                raise UnknownName("arm", name, arms)
        if there(job.object) in scene.names:
            raise InvalidRequest(f"jobs[{k}].object", job.object, f"a scene without {there(job.object)!r}")

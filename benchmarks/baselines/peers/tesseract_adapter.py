"""tesseract: its TrajOpt or Freespace (OMPL, then TrajOpt) pipeline with the profiles it comes with.

A pipeline searches, smooths, checks contacts and times in one call, which is the stage "search" here. It takes no
seed and no time limit; where it hangs, it is ended from outside.
"""

from __future__ import annotations

import re
import textwrap
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

from tesseract_robotics.planning import (
    JointTarget,
    MotionProgram,
    Pose,
    Robot,
    TaskComposer,
    box,
    create_obstacle,
    cylinder,
    profiles,
    sphere,
)

from benchmarks.baselines.peers.adapter_protocol import Answer, Table, serve, xyzw

__all__ = ["Tesseract"]

GROUP = "arm"
MANAGERS = """\
contact_manager_plugins:
  search_libraries: [tesseract_collision_bullet_factories, tesseract_collision_fcl_factories]
  discrete_plugins:
    default: BulletDiscreteBVHManager
    plugins:
      BulletDiscreteBVHManager: {class: BulletDiscreteBVHManagerFactory}
  continuous_plugins:
    default: BulletCastBVHManager
    plugins:
      BulletCastBVHManager: {class: BulletCastBVHManagerFactory}
"""
CHAIN = """\
kinematic_plugins:
  search_libraries: [tesseract_kinematics_kdl_factories]
  fwd_kin_plugins:
    arm:
      default: KDLFwdKinChain
      plugins:
        KDLFwdKinChain: {class: KDLFwdKinChainFactory, config: {base_link: BASE, tip_link: TIP}}
  inv_kin_plugins:
    arm:
      default: KDLInvKinChainLMA
      plugins:
        KDLInvKinChainLMA: {class: KDLInvKinChainLMAFactory, config: {base_link: BASE, tip_link: TIP}}
"""


class Tesseract:
    """An environment for each problem; the pipeline's plugins are loaded once."""

    def __init__(self, job: Table) -> None:
        self._robot, self._settings = job["robot"], job["settings"]
        self._urdf, self._srdf = _rewritten(self._robot)
        self._composer = TaskComposer.from_config(num_threads=1, warmup=[self._settings["pipeline"]])

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """One run of the pipeline to the first goal."""
        with answer.stage("setup"):
            robot = self._placed(problem)
            program = MotionProgram(GROUP, tcp_frame=self._robot["tool_frame"], working_frame=self._base)
            program.set_joint_names(list(self._robot["joints"]))
            program.move_to(JointTarget(problem["start"])).move_to(JointTarget(problem["goals"][0]))
        with answer.stage("search"):
            result = self._composer.plan(robot, program, self._settings["pipeline"], profiles=self._profiles())
        if not result.successful:
            answer.error = result.message or "failed without a message"
            return
        answer.waypoints = [point.positions for point in result.trajectory]
        times = [point.time for point in result.trajectory]
        if all(time is not None for time in times) and times and times[-1] > 0.0:
            answer.times, answer.samples = times, answer.waypoints
            answer.velocities = _rows(point.velocities for point in result.trajectory)
            answer.accelerations = _rows(point.accelerations for point in result.trajectory)

    @property
    def _base(self) -> str:
        return str(self._robot["base_links"][0])

    def _profiles(self) -> Any:
        if self._settings["pipeline"] == "FreespacePipeline":
            limit = self._settings["planning_time"]
            return profiles.create_freespace_pipeline_profiles(num_planners=1, planning_time=limit, optimize=False)
        return None  # its own

    def _placed(self, problem: Table) -> Any:
        robot = Robot.from_files(self._urdf, self._srdf)
        for body in problem["obstacles"]:
            where = Pose.from_xyz_quat(body["position"], xyzw(body))
            create_obstacle(robot, body["name"], _shape(body), where, parent_link=self._base)
            for link in self._robot["base_links"]:
                robot.add_allowed_collision(link, body["name"], "base")
        names = [body["name"] for body in problem["obstacles"]]
        for k, first in enumerate(names):
            for second in names[:k]:
                robot.add_allowed_collision(first, second, "static")
        robot.set_joints(problem["start"], joint_names=list(self._robot["joints"]))
        return robot


def _rows(found: Any) -> Any:
    rows = list(found)
    return None if any(row is None for row in rows) else rows


def _rewritten(robot: Table) -> tuple[Path, Path]:
    """The URDF with hulls asked for and files named by URL, the SRDF with its plugins."""
    urdf, srdf = Path(robot["urdf"]), Path(robot["srdf"])
    tree = ElementTree.parse(urdf)
    for name, most in zip(robot["joints"], robot["acceleration"], strict=True):
        limit = tree.find(f"./joint[@name='{name}']/limit")
        assert limit is not None
        limit.set("acceleration", repr(most))  # its own attribute; half the velocity limit without it
    text = ElementTree.tostring(tree.getroot(), encoding="unicode")
    text = re.sub(r'filename="(?!file:)([^"]+)"', lambda found: f'filename="file://{urdf.parent / found[1]}"', text)
    attributes = 'xmlns:tesseract="https://github.com/tesseract-robotics/tesseract" tesseract:make_convex="true"'
    text = re.sub(r"<robot\b", f"<robot {attributes}", text, count=1)
    urdf = urdf.with_name("tesseract.urdf")
    urdf.write_text(text, "utf-8")
    (urdf.parent / "managers.yaml").write_text(MANAGERS, "utf-8")
    chain = CHAIN.replace("BASE", robot["base_links"][0]).replace("TIP", robot["tool_frame"])
    (urdf.parent / "chain.yaml").write_text(chain, "utf-8")
    plugins = f"""
        <contact_managers_plugin_config filename="file://{urdf.parent / "managers.yaml"}"/>
        <kinematics_plugin_config filename="file://{urdf.parent / "chain.yaml"}"/>
    """
    text = srdf.read_text("utf-8").replace("</robot>", textwrap.dedent(plugins) + "</robot>")
    srdf = srdf.with_name("tesseract.srdf")
    srdf.write_text(text, "utf-8")
    return urdf, srdf


def _shape(body: Table) -> Any:
    kind = body["kind"]
    if kind == "box":
        return box(*body["size"])
    if kind == "sphere":
        return sphere(body["radius"])
    if kind == "cylinder":
        return cylinder(body["radius"], body["length"])
    raise ValueError(f"{body['name']}: no {kind} here")


if __name__ == "__main__":
    serve(("tesseract-robotics-nanobind", "numpy"), Tesseract)

"""Problem sets in the formats in which they are published."""

from __future__ import annotations

import os

from planner_service.errors import InvalidFile
from planner_service.files.json_reader import read_json
from planner_service.files.reading import as_path, read_bytes
from planner_service.files.yaml_reader import parse_yaml
from planner_service.records.problem_set import ProblemSet, own_problems
from planner_service.records.problems.moveit_folder import archived_problems, folder_problems
from planner_service.records.problems.robometrics import robometrics_problems
from planner_service.records.problems.vamp import vamp_problems

__all__ = ["read_problems"]

MAX_BYTES = 50_000_000
"""The largest set of robometrics takes 30 MB."""

KINDS = (
    "a folder of MotionBenchMaker (scene0001.yaml with request0001.yaml, in folders or in a .tar.bz2), "
    "JSON of ours or of VAMP, or YAML of robometrics"
)


def read_problems(path: str | os.PathLike[str]) -> ProblemSet:
    """The problems in a file, an archive or a folder.

    - MotionBenchMaker and robowflex: a folder, or a ``.tar`` of it, compressed or not, in which each
      ``request0001.yaml`` stands beside its ``scene0001.yaml``, at any depth.
    - VAMP: the ``problems.json`` that its script writes. Its pickle is never read: that would run code.
    - robometrics: a ``.yaml`` with lists of problems by name.
    - JSON of our own, as ``planner_service.records.problem_set`` describes it.

    Raises:
        InvalidFile: with all problems found, up to where there are too many of them; an unknown key is one, as it would
            change what is meant.
        MissingDependency: PyYAML is not installed, and the file is YAML.
    """
    path = as_path("path", path)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if os.path.isdir(path):
        return folder_problems(path)
    if ".tar" in suffixes[-2:] or suffixes[-1:] == [".tgz"]:
        return archived_problems(path)
    if suffixes[-1:] in ([".yaml"], [".yml"]):
        return robometrics_problems(path, parse_yaml(path, read_bytes(path, MAX_BYTES)))
    if suffixes[-1:] in ([".pkl"], [".pickle"]):
        message = "a pickle, which runs code when it is read; VAMP's script writes the same problems as problems.json"
        raise InvalidFile(path, [message])
    document = read_json(path)
    problems = document.get("problems") if isinstance(document, dict) else None
    return vamp_problems(path, document) if isinstance(problems, dict) else own_problems(path, document)

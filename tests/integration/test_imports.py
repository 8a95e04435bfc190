"""Who may import whom: the arrows of the architecture, and the libraries each of which has one place.

A new module has to be put in ``LAYERS``; a new arrow is a decision, not a slip.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import planner_service

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "planner_service"
FRONT = "__init__"

LAYERS: dict[str, tuple[set[str], set[str]]] = {
    # layer: (its modules and packages, the layers it may import from besides its own)
    "errors": ({"errors", "forks", "libraries", "polling", "turns"}, set()),
    "many": ({"many"}, {"errors", "shapes"}),
    "shapes": (
        {
            "geometry",
            "mesh",
            "mesh_file",
            "mesh_path",
            "covering",
            "decomposition",
            "coacd_child",
            "disk_cache",
            "composite",
            "grid_file",
            "data",
            "json_file",
            "regular_file",
            "written_file",
            "toml_file",
            "xml_file",
            "dae_file",
        },
        {"errors"},
    ),
    "robot": (
        {
            "robot",
            "robot_file",
            "robot_source",
            "package_files",
            "srdf",
            "assembly",
            "bodies",
            "locking",
            "reach",
            "urdf",
            "urdf_model",
        },
        {"errors", "shapes"},
    ),
    "scene": ({"scene", "scene_file"}, {"errors", "shapes"}),
    "path": ({"path", "blend", "trajectory"}, {"errors", "shapes"}),
    "collision": ({"collision"}, {"errors", "shapes", "robot", "scene", "path"}),
    "kinematics": (
        {"kinematics", "numeric_inverse", "pose_goal", "thinning", "tool_chain", "wxai_inverse"},
        {"errors", "shapes", "robot", "path"},
    ),
    "timing": (
        {"timing", "two_passes", "profiles", "peaks", "splice", "stretch"},
        {"errors", "shapes", "robot", "path"},
    ),
    "certify": ({"certify"}, {"errors", "shapes", "robot", "scene", "path"}),
    "import": (
        {"contact_table", "health", "robot_import"},
        {"errors", "shapes", "robot", "scene", "path", "collision", "certify"},
    ),
    "search": (
        {"search", "trace", "planners", "ompl_bridge", "roadmap", "smoothing", "optimize"},
        {"errors", "shapes", "robot", "scene", "path", "collision"},
    ),
    "service": (
        {
            "service",
            "batch",
            "pipeline",
            "progress",
            "roadmap_work",
            "request",
            "outcome",
            "stagebook",
            "tries",
            "endpoints",
            "remedies",
            "follow",
            "grasps",
            "grasp_guards",
            "pace",
            "oracle",
            "polishing",
            "detour",
            "replan",
            "replanned",
        },
        {"errors", "many", "shapes", "robot", "scene", "path", "collision"}
        | {"kinematics", "timing", "certify", "search"},
    ),
    "primitives": (
        {"primitives", "task"},
        {"errors", "shapes", "robot", "scene", "path", "collision", "kinematics", "timing", "service"} | {"certify"},
    ),
}
ABOVE = {
    *(FRONT, "__main__", "cli", "episodes", "execute", "interchange"),
    *("pick_place", "plan_file", "old_plan_file", "several", "view"),
    *("recertify", "exemptions", "story"),
    *("record", "request_record", "result_record", "robot_record", "scene_record"),
}
"""The public face, the command line and its files: they may import everything, nothing below imports them."""

LATE = {"service.py": {"view"}, "outcome.py": {"view", "plan_file"}, "task.py": {"view", "plan_file"}}
"""Arrows upwards, imported when asked for: what opens a page, and what saves."""

_RECORDS = ("request_record", "result_record", "robot_record", "scene_record")

ONLY_IN = {
    "fcl": {"collision/fcl.py"},
    "coal": {"collision"},
    "hppfcl": {"collision"},
    "coacd": {"coacd_child.py"},
    "ompl": {"planners.py", "planners", "ompl_bridge.py"},
    "toppra": {"two_passes.py"},
    "trossen_arm": {"execute/trossen.py"},
    "trossen_arm_sim": {"execute/simulator_child.py"},
    "mujoco": {"execute/simulator_child.py"},
    "piqp": {"optimize"},
    "PIL": {"view"},
    "ray": {"many/cluster.py"},
    "pyarrow": {"episodes/tables.py"},
    "pandas": set[str](),
    "pydantic": {f"{name}.py" for name in ("record", "plan_file", *_RECORDS)},
    "yourdfpy": {"assembly.py", "robot_source.py"},
    "viser": {"view/viewer.py"},
    "playwright": set[str](),
    "trimesh": set[str](),
    "pickle": set[str](),
    "cPickle": set[str](),
    "dill": set[str](),
    "cloudpickle": set[str](),
    "shelve": set[str](),
    "marshal": set[str](),
    "lxml": set[str](),
    "tests": set[str](),
    "benchmarks": set[str](),
}
"""Where each of these may be imported; nowhere if empty: unpickling runs code, and lxml recovers from broken files."""

SLOW = (
    *("yourdfpy", "toppra", "trimesh", "viser", "scipy.optimize", "scipy.sparse", "piqp"),
    *("matplotlib", "lxml", "rich", "typer", "PIL", "trossen_arm", "trossen_arm_sim", "mujoco", "ray"),
    "pydantic",
)
"""Only imported when first used."""

SOURCES = sorted(PACKAGE.rglob("*.py"))


def relative(source: Path) -> str:
    return source.relative_to(PACKAGE).as_posix()


by_file = pytest.mark.parametrize("source", SOURCES, ids=relative)


def imports(source: Path) -> Iterator[str]:
    """Dotted names that a file imports, wherever in it; of ``from x import y`` both x and x.y."""
    package = source.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(source.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, (above, node.module)))
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def component(source: Path) -> str:
    """The module or subpackage of planner_service a file belongs to."""
    return source.relative_to(PACKAGE).with_suffix("").parts[0]


def siblings(source: Path) -> set[str]:
    """Components of planner_service that a file imports."""
    known = {component(path) for path in SOURCES}
    found = set()
    for name in imports(source):
        parts = name.split(".")
        if parts[0] == "planner_service" and len(parts) > 1:
            found.add(parts[1] if parts[1] in known else FRONT)
    return found - {component(source)}


def layer_of(name: str) -> str:
    found = [layer for layer, (modules, _) in LAYERS.items() if name in modules]
    assert len(found) == 1, f"{name}: a new module? Put it in LAYERS, where it belongs"
    return found[0]


@pytest.mark.parametrize("source", [s for s in SOURCES if component(s) not in ABOVE], ids=relative)
def test_arrows_point_one_way(source: Path) -> None:
    layer = layer_of(component(source))
    allowed = LAYERS[layer][1] | {layer}
    assert siblings(source) & ABOVE == LATE.get(relative(source), set())
    assert {name for name in siblings(source) - ABOVE if layer_of(name) not in allowed} == set()


def test_the_layers_have_no_circle() -> None:
    below: set[str] = set()
    while len(below) < len(LAYERS):
        ready = {layer for layer, (_, uses) in LAYERS.items() if layer not in below and uses <= below}
        assert ready, f"a circle among {set(LAYERS) - below}"
        below |= ready


@by_file
def test_each_library_has_its_place(source: Path) -> None:
    where = {relative(source), component(source)}
    libraries = {name.split(".")[0] for name in imports(source)}
    assert {name for name in libraries if name in ONLY_IN and not where & ONLY_IN[name]} == set()


@by_file
def test_no_import_hides_in_a_call(source: Path) -> None:
    tree = ast.parse(source.read_text("utf-8"))
    names = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
    names |= {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
    assert names & {"__import__", "import_module", "exec", "eval"} == set()


def test_the_places_that_are_named_exist() -> None:
    """A rule about a file that was renamed guards nothing."""
    users = {name: [s for s in SOURCES if name in {i.split(".")[0] for i in imports(s)}] for name in ("fcl", "ompl")}
    assert [path.name for path in users["fcl"]] == ["fcl.py"]
    assert users["ompl"]


def test_the_independent_checker_shares_no_code_with_the_package() -> None:
    source = ROOT / "tests" / "independent.py"
    assert {name.split(".")[0] for name in imports(source)} & {"planner_service", "fcl", "tests", "benchmarks"} == set()


@pytest.mark.parametrize("module", ["planner_service", "planner_service.collision"])
def test_importing_brings_nothing_that_is_slow(module: str) -> None:
    ask = f"import sys, {module}; print(*(name for name in {SLOW!r} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", ask], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr, done.returncode) == ("", "", 0)


def test_modules_are_looked_for_in_the_package_and_nowhere_else() -> None:
    assert {Path(folder).name for folder in planner_service.__path__} == {"planner_service"}

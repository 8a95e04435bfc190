"""What pyproject.toml's import contracts cannot say: how deep imports go, how large folders are, what loads when."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import grimp
import pytest

import planner_service

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "planner_service"

MAX_LEVELS = 16
MAX_FILES = 15
MAX_ROOT_NAMES = 60

NEEDED = {
    *(
        "certify",
        "collision",
        "concurrency",
        "constraints",
        "conveniences",
        "errors",
        "files",
        "geometry",
        "kinematics",
    ),
    *("memory", "native", "optimize", "path", "planners", "planning", "presentation", "provided", "roadmap", "robot"),
    *("robot_setup", "scene", "search", "service", "smoothing", "timing"),
}
"""Of the package, what a plan needs; all else is only imported when it is first used."""

LIBRARIES, SUPPORT = {"coal", "numpy", "pinocchio", "pydantic", "rich", "typer"}, {"pydantic_core", "shellingham"}
"""Of other libraries, what a command needs, to read a robot and to print; and what these bring."""

SLOW = {"multiprocessing", "concurrent.futures", "asyncio", "sqlite3", "ssl", "http.client"}
"""Of Python's own, what no plan needs."""

COMMAND = """
import io, contextlib
from planner_service.cli import main
sys.argv = ["planner-service", "plan", "--start", "home", "--goal", "ready", "--scene", "table"]
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main()
"""

SOURCES = sorted(PACKAGE.rglob("*.py"))


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Who imports whom, in calls and for types, too."""
    return grimp.build_graph("planner_service", cache_dir=None)


def test_a_walk_from_package_to_package_is_short(graph: grimp.ImportGraph) -> None:
    packages = graph.find_children("planner_service") - {"planner_service.__main__"}
    for package in packages:
        graph.squash_module(package)

    @cache
    def longest(package: str) -> tuple[str, ...]:
        below = (longest(other) for other in graph.find_modules_directly_imported_by(package) - {package})
        return (package, *max(below, key=len, default=()))

    walk = max(map(longest, packages), key=len)
    assert len(walk) <= MAX_LEVELS, walk


def test_no_folder_has_too_many_files() -> None:
    counts = {folder: len(list(folder.glob("*.py"))) for folder in {source.parent for source in SOURCES}}
    assert {folder.name: count for folder, count in counts.items() if count > MAX_FILES} == {}


def test_the_root_has_few_names_and_each_is_there() -> None:
    assert len(planner_service.__all__) <= MAX_ROOT_NAMES
    assert [name for name in planner_service.__all__ if not hasattr(planner_service, name)] == []


def test_no_import_hides_in_a_call() -> None:
    hidden = {"__import__", "import_module", "exec", "eval"}
    found = {
        f"{source.relative_to(PACKAGE)}:{node.lineno}"
        for source in SOURCES
        for node in ast.walk(ast.parse(source.read_text("utf-8")))
        if isinstance(node, ast.Name | ast.Attribute)
        if (node.id if isinstance(node, ast.Name) else node.attr) in hidden
    }
    assert found == set()


def loaded_by(code: str) -> set[str]:
    """The modules that code brings beside those of a bare Python."""
    ask = f"import sys\nbare = {{*sys.modules}}\n{code}\nprint(*({{*sys.modules}} - bare), sep='\\n')"
    done = subprocess.run([sys.executable, "-c", ask], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("", 0)
    return set(done.stdout.splitlines())


def other_libraries(modules: set[str]) -> set[str]:
    """The libraries among modules, without what has only types in it or is private."""
    roots = {module.partition(".")[0] for module in modules} - {"planner_service"} - set(sys.stdlib_module_names)
    return {root for root in roots if not root.startswith(("_", "annotated_", "typing_"))}


@pytest.mark.parametrize(
    ("code", "packages", "libraries"),
    [
        ("import planner_service", NEEDED, {"numpy"}),
        ("import planner_service.collision", NEEDED, {"numpy"}),
        (COMMAND, NEEDED | {"cli"}, LIBRARIES | SUPPORT),
    ],
    ids=["package", "subpackage", "command"],
)
def test_what_a_plan_does_not_need_is_not_imported(code: str, packages: set[str], libraries: set[str]) -> None:
    modules = loaded_by(code)
    ours = {module.split(".")[1] for module in modules if module.startswith("planner_service.")}
    assert (ours - packages, other_libraries(modules) - libraries, modules & SLOW) == (set(), set(), set())


def test_names_that_are_imported_late_are_those_of_their_modules() -> None:
    names = ("move_linear", "pick", "place", "top_grasps")
    assert all(getattr(planner_service, name).__name__ == name for name in names)
    assert set(planner_service.__all__) <= set(dir(planner_service))
    with pytest.raises(AttributeError, match="no attribute 'grasp'"):
        _ = planner_service.grasp

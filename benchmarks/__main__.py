"""``python -m benchmarks``: the one door to all benchmarks; without an argument it lists what there is."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from benchmarks.harness.arguments import whole
from benchmarks.harness.report import Report, show, write_json
from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.files.writing import require_writable

MEASURES = (
    *("toy", "states", "solved", "planners", "speed", "tasks", "proven"),
    *("problems", "clouds", "agreement", "kernel", "certificates", "latency", "scaling", "panda"),
    *("roadmaps", "optimise", "replan", "many", "episodes", "view", "execute"),
    *("throughput", "constrained", "torque"),
)

COMMANDS = {
    "run": "harness.runner",
    "compare": "harness.comparison",
    "check": "harness.gate",
    "export": "harness.ompl_log",
    "cold": "studies.cold",
    "peers": "baselines.peers.running",
    "report": "pages.page",
    "attack": "attack.running",
    "lines": "studies.lines",
    "mutants": "studies.mutants",
}
"""Subcommands with options of their own, and the modules whose ``main(arguments, console)`` they are."""

INTERRUPTED = 130
"""The exit code of a program that was ended by Ctrl-C."""

APART = ("robots", "evidence", "serve", "differential", "bits", "law", "smoothing", "starts")
"""Measures that are not among all: what they find changes with the code alone, and they take long."""

STORED = ("queries",)
"""What is compared with what is stored, or stored."""

SETTINGS = {
    "agreement": ("robot", "states"),
    "differential": ("robot", "states", "edges", "seed"),
    "law": ("paths", "seed"),
    "smoothing": ("paths",),
    "roadmaps": ("part",),
    "many": ("part",),
    "episodes": ("seed", "against"),
    "solved": ("queries", "seeds", "seed"),
    "panda": ("seeds", "against"),
    "latency": ("against",),
    "constrained": ("part", "queries", "seed"),
    "robots": ("robot", "queries", "states", "seed"),
    "torque": ("queries", "seed"),
    "starts": ("queries", "seed"),
    "evidence": ("part", "queries", "seed"),
    "serve": ("part", "queries", "seed"),
}
"""Arguments that a measure takes."""

PARTS = {
    "roadmaps": ("warm", "lazy", "moved", "large"),
    "many": ("same", "speed", "growth", "faults"),
    "constrained": ("panda", "wxai", "regions", "others"),
    "evidence": ("trails", "forgeries", "discs", "pockets", "poses", "scara", "known-paths", "explain"),
    "serve": ("load", "memory", "overload", "cancel", "kill", "hostile"),
}
"""What ``--part`` may be for measures that have parts."""

USAGE = """\
run       plan a suite: --suite NAME --planner P --seeds A:B --out FILE; goes on where it was interrupted
compare   two results files, or the planners within one
check     the gate: the counts of the smoke suite, stored queries and roadmaps against their pins; --write stores them
export    a results file in another format: --ompl-log FILE
report    results files as one HTML page: FILE... -o report.html; or into a text: --markdown FILE
attack    hostile inputs of every kind: [PART...] --minutes N --seed S; replay FILE...; table FOLDER...
mutants   do the tests notice small faults in a package: [PACKAGE...] --count N --seed S --out FILE
peers     other planners in environments of their own: install PEER..., list, run --peer PEER --suite NAME --out FILE
lines     lines of code by folder, now and at COMMIT...
cold      from the start of a process to its first plan, then plan after plan

all       all of the measures below
toy       the lesson's two-joint program: seed 7 and the 50 seeds of its exercise
states    states by stage on the stored queries, next to the lesson's program
solved    random queries in random scenes, and the public Panda problems with several seeds, by the default request,
          audited by Coal; --queries N, --seeds M, --seed S
planners  every planner on four scenes, twice
speed     judging states and edges against pair-by-pair FCL, and import time
tasks     pick-and-place on a clear table and out of the bin
proven    the curves themselves: free, within limits, faster than stops, and what a proof costs
problems  the public Panda problems of MotionBenchMaker, audited by Coal, and what they cost
clouds    a UR5 around a mesh and a 50,000-point cloud: cost of a state, plans audited by Coal
agreement verdicts next to Coal's on random and near-contact states; --robot NAME, --states N
kernel    the compiled kernel against numpy, pair-by-pair FCL and Pinocchio's naive manager
latency   whole plans of a service that has planned before, next to 0.1.0's, the first one, and free straight lines;
          --against PYTHON
replan    50 steps at 10 Hz while a post, a goal or a ball moves 1 cm a step
scaling   what 10 to 10,000 boxes cost: building, states, edges, plans
panda     the public Panda problems for speed, audited by Coal: this version next to 0.1.0, which is installed for it,
          and to the peers that are installed, all in turn; --seeds M, --against PYTHON (of another version)
roadmaps  warm queries, single problems, a moved obstacle, 100,000 milestones; --part warm, lazy, moved or large
many      500 plans by every engine, two cores next to one, 10,000 in a stream, workers killed and machines lost;
          --part same, speed, growth or faults
episodes  1,000 episodes of pick-place: written, read back, audited by Coal; what a million would cost; --seed N,
          --against PYTHON (of an environment with LeRobot, which then reads them as well)
optimise  optimised plans next to shortcut ones, what the straight line converges to, and gradients of distances
execute   14 pick-and-place legs on the simulated arm (extra sim): tracking, contacts, stops; needs a quiet machine
constrained  a cup upright, a point on a plane, on a line and in a box, a tray in both hands; next to OMPL's projected
          space and to rejection; --part panda, wxai, regions or others, --queries N (of each set), --seed N
          (queries drawn from it, in place of the stored ones)
torque    200 plans with payload of six arms: torques by Pinocchio every millisecond, and what the limits cost in time;
          --queries N (plans), --seed N
throughput plans per second of two threads with one service, next to two processes; needs a quiet machine
view      the page in the browser: until it is drawn, a step along 1,000 waypoints, what is left when it is closed
robots    26 robots out of packages on PyPI, as a new user meets them: from the file to the first proven plan, random
          queries, judged by Coal; half an hour, not among all; --robot NAME, --queries N, --states N, --seed S
differential  a million states and 20,000 edges of six robots: the kernel is FCL pair by pair; not among all;
          --robot NAME, --states N, --edges N, --seed N (runs with different seeds ask different ones)
evidence  500 trails of proofs, checked by a program that shares no code with them, 10,000 forgeries; 1,000 worlds of
          discs planned or proven impossible, stored pockets and poses, 100 cells of a SCARA arm, 2,000 queries with a
          known path, 50 stored failures explained; not among all; --part trails, forgeries, discs, pockets, poses,
          scara, known-paths or explain, --queries N (of these), --seed N
serve     a server with 32 clients for a minute, 100,000 requests, ten times its capacity, requests withdrawn, and
          100,000 hostile ones: the library's bits, cost of a call, memory, refusals; locust and schemathesis are
          installed for it; not among all; --part load, memory, overload, cancel, kill or hostile, --queries N
          (requests; turns of kill), --seed N
bits      500 plans with every instruction set, without compiled code and from 1 to 8 threads: the same to the last bit;
          not among all
law       2,000 random paths timed: toppra's durations, no limit exceeded, the reference's bits; not among all;
          --paths N, --seed S
smoothing 500 searched Panda paths smoothed: the reference's paths and counts; not among all; --paths N
starts    1,000 starts up to 3 mm deep in a table, a shelf, a bin or the robot itself: a proven plan out of them, depths
          by Coal all along; not among all; --queries N, --seed N
certificates  the compiled proof against the reference: whole plans, straight edges, clearances
queries   the stored queries are what their seed gives; --write stores them
"""


def _arguments(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", epilog=USAGE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    choices = ["all", *MEASURES, *APART, *STORED, *COMMANDS]
    parser.add_argument("what", nargs="?", choices=choices)
    parser.add_argument("--write", action="store_true", help=f"store instead of compare ({', '.join(STORED)})")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write rows and promises to FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write a measure into its part of a text")
    parser.add_argument("--robot", metavar="NAME", help="the only robot to look at; all if not given")
    parser.add_argument("--part", metavar="PART", help="the only part of a measure to take; all if not given")
    for what in ("states", "edges"):
        parser.add_argument(f"--{what}", type=whole(1), metavar="N", help=f"{what} of each robot")
    parser.add_argument("--paths", type=whole(1, 10**6), metavar="N", help="random or searched paths")
    parser.add_argument(
        "--queries", type=whole(0, 10**6), metavar="N", help="random queries, or stored ones of each set"
    )
    parser.add_argument("--seeds", type=whole(0, 1000), metavar="M", help="plans of each public problem")
    parser.add_argument("--against", type=Path, metavar="PYTHON", help="of an environment with what is compared")
    parser.add_argument("--seed", type=whole(0), metavar="N", help="of what is drawn")
    asked = parser.parse_args(arguments)
    for key in sorted({key for keys in SETTINGS.values() for key in keys}):
        if getattr(asked, key) is not None and key not in SETTINGS.get(asked.what, ()):
            takers = " and ".join(name for name, keys in SETTINGS.items() if key in keys)
            parser.error(f"argument --{key}: {asked.what} has none; {takers} take it")
    if asked.part is not None and asked.part not in PARTS[asked.what]:
        parser.error(f"argument --part: {asked.what} has {', '.join(PARTS[asked.what])}")
    if asked.markdown is not None and asked.what not in (*MEASURES, *APART):
        parser.error("argument --markdown: it takes one measure at a time")
    if asked.write and asked.what not in STORED:
        parser.error(f"argument --write: {asked.what} stores nothing; {', '.join(STORED)} do")
    return asked


def main(given: Sequence[str]) -> int:
    """Exit code 0 if every promise was kept, else 1; 2 where the caller made a mistake, 130 when interrupted."""
    console = Console(width=None if sys.stdout.isatty() else 200)
    name = next(iter(given), "")
    try:
        if name in COMMANDS:
            return int(importlib.import_module(f"benchmarks.{COMMANDS[name]}").main(given[1:], console))
        arguments = _arguments(given)
        if arguments.what is None:
            console.print(USAGE, end="", markup=False, highlight=False, soft_wrap=True)
            return 0
        return _measured(arguments, console)
    except (InvalidRequest, MissingDependency) as error:
        console.print(f"{name or 'all'}: {error}", markup=False, highlight=False, soft_wrap=True)
        return 2
    except KeyboardInterrupt:
        console.print("interrupted")
        return INTERRUPTED


def _measured(arguments: argparse.Namespace, console: Console) -> int:
    """Exit code 0 if every promise was kept, else 1."""
    for path in filter(None, (arguments.json, arguments.markdown)):
        require_writable(path)
    if arguments.what == "queries":
        stored = importlib.import_module("benchmarks.harness.stored")
        return int(stored.main(write=arguments.write, console=console))
    reports, left_out = list[Report](), list[str]()
    for name in MEASURES if arguments.what == "all" else [arguments.what]:
        given = {key: getattr(arguments, key) for key in SETTINGS.get(name, ())}
        asked = {key: value for key, value in given.items() if value is not None}
        try:
            report: Report = importlib.import_module(f"benchmarks.studies.{name}").run(**asked)
        except (InvalidRequest, MissingDependency) as error:  # a browser or an extra that is not there
            if arguments.what != "all":
                raise
            left_out.append(f"{name} is not measured: {error}")
            continue
        console.print(*report.tables, sep="\n\n")
        reports.append(report)
        if arguments.json is not None:  # after each: what was measured is not lost when a later one is interrupted
            write_json(reports, arguments.json)
        if arguments.markdown is not None:
            importlib.import_module("benchmarks.pages.page").write_measure(report, arguments.markdown)
    kept = show(reports, console)
    for line in left_out:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return 0 if kept and not left_out else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

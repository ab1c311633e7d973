"""Random goals in the closed loop: are they reached without a contact and without entering keep-out areas?

Simulator, BaseControl, RobotGoto, RobotPathPlanner and the localizer (odometry drifts) run in lock-step in one process.
The plans' people walk. A contact is a tick (10 ms) in which the moving robot's hull touches something; a keep-out entry
is a check (every 50 ms) at which its hull is within such an area. The peer of the driven path is the shortest path on
the map. In the world `tables` the robot has a depth camera: RobotGoto receives its points live, and Mapper3D's code
maps them from the estimated pose, beginning with an empty map, and gives the planner the layer. In this world, moving
over a drop in the floor counts as an entry, and the robot restarts at the plan's start after each missed goal. The real
time factor is simulated seconds per second of total processor time.

    python benchmarks/goals.py --world apartment --base r1 --goals 100 [--seed 1] [--json FILE]
    python benchmarks/goals.py --world tables --base r1 --goals 100 [--laser-alone]
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.closedloop.drive import Drive, Loop
from benchmarks.closedloop.judge import Judge
from benchmarks.closedloop.robot import CAMERA, Robot
from benchmarks.closedloop.stack import Ours
from benchmarks.closedloop.targets import Targets
from benchmarks.closedloop.worlds import WORLDS, world
from benchmarks.rows import Row, add_json_option, report
from sim.simulation import pose

BASES = ("r1", "ikart_v1")
NEEDED_FACTOR = 10.0  # aim for the real time factor
ROWS = 10
"""Number of rows per case."""


def run(
    name: str,
    base: str,
    goals: int,
    seed: int,
    *,
    people: bool,
    localized: bool,
    depth: bool = True,
    keep_out: bool = False,
) -> tuple[list[Drive], list[Row]]:
    """Drive to goals in a world, one after the other; return all drives, and the rows.

    Args:
        name: the world's name.
        base: the robot's name.
        goals: number of goals.
        seed: seed of goals and noise.
        people: whether people walk.
        localized: whether poses come from the localizer; otherwise from the simulator.
        depth: whether the robot has a depth camera in worlds with obstacles that a laser does not see.
        keep_out: whether RobotGoto knows the map's keep-out cells.
    """
    floor_world = world(name, people=people)
    robot = Robot(floor_world.plan, base, seed=seed, camera=CAMERA if depth and floor_world.hides else None)
    judge = Judge(robot, (*floor_world.keep_out, *floor_world.drops))
    ours = Ours(robot, floor_world, localized=localized, seed=seed, keep_out=keep_out)
    loop = Loop(robot, ours, judge)
    targets = Targets(floor_world, robot, seed)
    loop.settle()
    drives: list[Drive] = []
    began, cpu, touched = robot.now, 0.0, 0
    for number, (goal, shortest) in enumerate(itertools.islice(targets, goals), 1):
        contacts, entered, start = judge.contacts, judge.entered, time.process_time()
        drive = loop.drive(goal, shortest)
        cpu += time.process_time() - start
        drives.append(drive)
        touched += judge.contacts > contacts or judge.entered > entered
        bad = not drive.reached or judge.contacts > contacts or judge.entered > entered
        print(_line(number, goal, drive, judge) if bad else f"{number} reached in {drive.seconds:.0f} s", flush=True)
        if floor_world.hides and not drive.reached:  # the robot may be stuck at a board, or in a drop
            robot.simulation.teleport(pose(*robot.simulation.world.floor.start))
            ours.put_elsewhere()
            loop.settle()
    eyes = "" if not floor_world.hides else ", laser and depth" if depth else ", only laser"
    if floor_world.hides:
        print(f"{touched} of {goals} drives touched something or moved over a drop", flush=True)
    limit = robot.simulation.robot.limits.linear
    return drives, _rows(f"{name}, {base}{eyes}", drives, judge, (robot.now - began) / cpu, 1.0 / limit)


def _line(number: int, goal: tuple[float, ...], drive: Drive, judge: Judge) -> str:
    x, y, theta = goal[:3]
    return (
        f"{number} to {x:.2f} {y:.2f} {math.degrees(theta):.0f} deg: {drive.state.value} {drive.reason!r}, "
        f"off by {drive.off:.2f} m, estimate off by {drive.lost:.2f} m, after {drive.seconds:.0f} s; "
        f"contacts {judge.contacts}, entries {judge.entered} {judge.where}"
    )


def _rows(case: str, drives: list[Drive], judge: Judge, factor: float, fastest: float) -> list[Row]:
    """Return the rows; ``fastest`` are the seconds per meter at the robot's top speed."""
    reached = [drive for drive in drives if drive.reached]
    driven, best = sum(drive.driven for drive in reached), sum(drive.optimum for drive in reached)
    return [
        Row(f"{case}: goals reached", len(reached), len(drives), "goals", "more"),
        Row(f"{case}: contacts", judge.contacts, 0.0, "ticks"),
        Row(f"{case}: keep-out entries", judge.entered, 0.0, "checks"),
        Row(f"{case}: driven path, shortest path", driven, best, "m"),
        Row(f"{case}: seconds per shortest meter, at top speed", _pace(reached), fastest, "s/m"),
        Row(
            f"{case}: seconds of standing, of all drives",
            sum(d.stood for d in drives),
            sum(d.seconds for d in drives),
            "s",
        ),
        Row(f"{case}: largest error of the estimate", max(d.lost for d in drives), 0.15, "m"),
        Row(f"{case}: smallest clearance of the hull", judge.room, 0.0, "m", "more"),
        Row(f"{case}: the same while commanded to move", judge.driving_room, 0.0, "m", "more"),
        Row(f"{case}: real time factor, needed", factor, NEEDED_FACTOR, "x", "more"),
    ]


def _pace(drives: list[Drive]) -> float:
    """Return the seconds of drives per meter of their shortest paths; NaN without drives."""
    best = sum(drive.optimum for drive in drives)
    return sum(drive.seconds for drive in drives) / best if best else math.nan


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 1 if a goal was not reached, a contact occurred or a keep-out area was entered."""
    args = _parser().parse_args(arguments)
    rows: list[Row] = []
    for name, base in itertools.product(args.world, args.base):
        print(f"== {name}, {base}")
        _, world_rows = run(
            name,
            base,
            args.goals,
            args.seed,
            people=not args.alone,
            localized=not args.truth,
            depth=not args.laser_alone,
            keep_out=args.keep_out,
        )
        rows += world_rows
    report(rows, args.json)
    reached, contacts, entries = (rows[place::ROWS] for place in range(3))
    return int(any(row.ratio < 1.0 for row in reached) or any(row.ours for row in (*contacts, *entries)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--world", nargs="+", choices=WORLDS, default=list(WORLDS), help="worlds to drive in (default all)"
    )
    parser.add_argument("--base", nargs="+", choices=BASES, default=list(BASES), help="robots to drive (default both)")
    parser.add_argument(
        "--goals", type=int, default=10, metavar="N", help="goals in each world with each base (default 10)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of goals and noise (default 0)")
    parser.add_argument("--alone", action="store_true", help="leave out the people")
    parser.add_argument("--truth", action="store_true", help="take poses from the simulator instead of the localizer")
    parser.add_argument("--laser-alone", action="store_true", help="no depth camera in worlds that need one")
    parser.add_argument("--keep-out", action="store_true", help="RobotGoto knows keep-out cells (keep_out_map)")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())

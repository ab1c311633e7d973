"""Random goals in the closed loop: reached, without a contact and without entering what is to be kept out of?

Simulator, BaseControl, RobotGoto, RobotPathPlanner and the localizer (odometry drifts) in lock-step in one process.
People walk as the plans have them. A contact is a tick (10 ms) in which the moving robot's hull touches something; a
keep-out entry a look (50 ms) at which its hull is within such an area. The peer of the way driven is the shortest way
on the map. In the world `tables` the robot has a depth camera: RobotGoto hears its points live, and Mapper3D's code
maps them from where the robot believes to be, from nothing on, and gives the planner the layer; what comes over a drop
in the floor counts as an entry. After a goal that was not reached there, it begins again at the start. The real time
factor is simulated seconds per second of processor time, all of it counted.

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
NEEDED_FACTOR = 10.0


def run(
    name: str, base: str, goals: int, seed: int, *, people: bool, localized: bool, depth: bool = True
) -> tuple[list[Drive], list[Row]]:
    """Drive to so many goals in a world, one after the other; what came of each, and the rows of all.

    Args:
        name: of the world.
        base: of the robot.
        goals: how many.
        seed: of goals and noise.
        people: whether they walk about.
        localized: whether our localizer tells where the robot is; False: the simulator does.
        depth: whether it has a depth camera where the floor has what a laser does not see.
    """
    floor_world = world(name, people=people)
    robot = Robot(floor_world.plan, base, seed=seed, camera=CAMERA if depth and floor_world.hides else None)
    judge = Judge(robot, (*floor_world.keep_out, *floor_world.drops))
    ours = Ours(robot, floor_world, localized=localized, seed=seed)
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
        if floor_world.hides and not drive.reached:  # it may hang on a board, or lie in a drop
            robot.simulation.teleport(pose(*robot.simulation.world.floor.start))
            ours.put_elsewhere()
            loop.settle()
    eyes = "" if not floor_world.hides else ", laser and depth" if depth else ", laser alone"
    if floor_world.hides:
        print(f"{touched} of {goals} drives touched something or came over a drop", flush=True)
    return drives, _rows(f"{name}, {base}{eyes}", drives, judge, (robot.now - began) / cpu)


def _line(number: int, goal: tuple[float, ...], drive: Drive, judge: Judge) -> str:
    x, y, theta = goal[:3]
    return (
        f"{number} to {x:.2f} {y:.2f} {math.degrees(theta):.0f} deg: {drive.state.value} {drive.reason!r}, "
        f"off by {drive.off:.2f} m, belief off by {drive.lost:.2f} m, after {drive.seconds:.0f} s; "
        f"contacts {judge.contacts}, entries {judge.entered} {judge.where}"
    )


def _rows(case: str, drives: list[Drive], judge: Judge, factor: float) -> list[Row]:
    reached = [drive for drive in drives if drive.reached]
    driven, best = sum(drive.driven for drive in reached), sum(drive.optimum for drive in reached)
    return [
        Row(f"{case}: goals reached", len(reached), len(drives), "goals", "more"),
        Row(f"{case}: contacts", judge.contacts, 0.0, "ticks"),
        Row(f"{case}: keep-out entries", judge.entered, 0.0, "looks"),
        Row(f"{case}: way driven, shortest way", driven, best, "m"),
        Row(f"{case}: belief off the truth, the most", max(d.lost for d in drives), 0.15, "m"),
        Row(f"{case}: room about the hull, the least", judge.room, 0.0, "m", "more"),
        Row(f"{case}: real time factor, needed", factor, NEEDED_FACTOR, "x", "more"),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 1 where a goal was not reached, something was touched or a keep-out area entered."""
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
        )
        rows += world_rows
    report(rows, args.json)
    reached, contacts, entries = (rows[place::7] for place in range(3))
    return int(any(row.ratio < 1.0 for row in reached) or any(row.ours for row in (*contacts, *entries)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", nargs="+", choices=WORLDS, default=list(WORLDS), help="default all")
    parser.add_argument("--base", nargs="+", choices=BASES, default=list(BASES), help="default both")
    parser.add_argument("--goals", type=int, default=10, metavar="N", help="in each world with each base (default 10)")
    parser.add_argument("--seed", type=int, default=0, help="of goals and noise (default 0)")
    parser.add_argument("--alone", action="store_true", help="nobody walks about")
    parser.add_argument("--truth", action="store_true", help="the simulator tells where the robot is, no localizer")
    parser.add_argument("--laser-alone", action="store_true", help="no depth camera, where the world is for one")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""``midspan sim``: run the simulated base without a daemon, list plans and robots, or export maps or a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.cli.arguments import add_config
from bridge.cli.output import CliError, system_error

if TYPE_CHECKING:
    from bridge.config.model import Config


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Runs the simulated base of the configuration's sim section in the foreground, without the daemon; the options"
        " here override the file. It joins the hub, or waits for it."
    )
    add_config(parser)
    parser.add_argument("--plan", metavar="PLAN", help="name of a floor plan, or a file; see --list")
    parser.add_argument("--robot", metavar="ROBOT", help="name of a robot, or a file; see --list")
    parser.add_argument(
        "--speed",
        metavar="SPEED",
        help="1.0: real time; 'max': as fast as possible; 'step': only when a client requests a step",
    )
    parser.add_argument("--list", action="store_true", help="list Midspan's plans and robots, and exit")
    parser.add_argument("--export", type=Path, metavar="FOLDER", help="write the plan's maps and locations, and exit")
    parser.add_argument("--resolution", type=float, metavar="METERS", help="cell size for --export (default 0.05)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the plan and the robot as PNG, and exit")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the simulation until it is stopped, or list, export or draw."""
    if args.list:
        return _list()
    config = _config(args)
    if args.export is not None:
        return _export(config, args)
    if args.picture is not None:
        return _picture(config, args.picture)
    from bridge.cli.daemon.run import run_alone
    from bridge.daemon.workers import worker_kinds

    kind = worker_kinds()["sim"]
    if reason := kind.missing(config):
        raise CliError(reason)
    return run_alone(kind, config, lambda: _config(args))


def _list() -> int:
    from sim.environment import ready

    print("plans: ", ", ".join(ready("plans")))
    print("robots:", ", ".join(ready("robots")))
    return 0


def _config(args: argparse.Namespace) -> Config:
    from bridge.config.digests import digest_of
    from bridge.config.load import load
    from bridge.state_file import with_state
    from sim.section import SimSection

    config = with_state(load(args.config))
    speed = args.speed
    if speed not in (None, "max", "step"):
        try:
            speed = float(speed)
        except ValueError:
            raise CliError(f"--speed {speed} is not a number, 'max' or 'step'") from None
    given = {"plan": args.plan, "robot": args.robot, "speed": speed}
    changed = {name: value for name, value in given.items() if value is not None}
    try:
        section = SimSection.model_validate({**config.section(SimSection).model_dump(), **changed, "enabled": True})
    except ValueError as err:
        raise CliError(str(err)) from None
    section.set_digest(digest_of(section.named_files()))
    return config.model_copy(update={"sim": section})


def _export(config: Config, args: argparse.Namespace) -> int:
    from sim import export
    from sim.plan import load_plan
    from sim.section import SimSection

    resolution = 0.05 if args.resolution is None else args.resolution
    if not 0.001 <= resolution <= 10:
        raise CliError(f"--resolution {resolution} is not from 0.001 to 10 meters")
    section = config.section(SimSection)
    plan = load_plan(section.plan, section.resolution)
    with _writing(f"the maps into {args.export}", "--export takes a folder"):
        files = export.save(plan, args.export, resolution)
    for file in files:
        print(file)
    for name, link in export.links(plan).items():
        print(f"link {name}: {link.first} and {link.second}, cost {link.cost:g}")
    return 0


def _picture(config: Config, file: Path) -> int:
    from sim.export import png
    from sim.section import SimSection
    from sim.simulation import Simulation

    simulation = Simulation(config.section(SimSection))
    with _writing(f"the picture {file}", "--picture takes a file in a folder"):
        png(simulation, file)
    print(file)
    return 0


@contextmanager
def _writing(what: str, takes: str) -> Iterator[None]:
    """Raise `CliError` if something cannot be written."""
    from yarp_compat.dev.mapfile import MapFileError

    try:
        yield
    except (OSError, MapFileError) as err:
        reason = system_error(err) if isinstance(err, OSError) else err
        msg = f"cannot write {what}: {reason}; {takes} that this user may write to, with enough space"
        raise CliError(msg) from None

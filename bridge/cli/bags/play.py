"""``midspan play``: publishes bags on the hub, so that each side receives them in its own wire format."""

from __future__ import annotations

import argparse
import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.arguments import add_exclude, add_hub_arguments, number_in, span
from bridge.cli.client import open_client, warn_of_refusals
from bridge.cli.output import CliError, print_json
from bridge.client.session import Client
from bridge.text import clean, plural
from yarp_compat.interruptible import interruptible

if TYPE_CHECKING:
    from bridge.bags.bag import Bag
    from bridge.bags.play.player import Player
    from bridge.bags.play.source import PlaySource
    from bridge.bags.play.topics import LeftOut, PlayTopic

CLOCK_HZ = 40.0
APPEAR_SECONDS, MATCH_SECONDS = 1.0, 5.0
"""Before playing, the maximum waits until the hub's graph lists subscribers, and until those can receive messages."""
_EPILOG = """\
Keys in a terminal: space pauses and resumes, '.' or 's' plays one message while paused, 'q' ends.
The services /midspan/play/pause (std_srvs/SetBool) and /midspan/play/step (std_srvs/Trigger) also work without one.

examples:
  midspan play run.bag                                   # a ROS 1 bag; ROS 2, YARP and zenoh receive it too
  midspan play run.mcap --clock --rate 2 --loop
  midspan play run_0.mcap run_1.mcap --start 30 --duration 10
  midspan play ros2_folder --topics /scan '/tf*' --remap /scan:=/laser/scan
"""
_LINGER_SECONDS = 0.3
"""Seconds for which the publishers stay after the last message, so that it arrives."""

_POLL_SECONDS = 0.1
_END_SECONDS = 0.5  # to wait for the playing thread at the end
_REMAP = re.compile(r"(?P<old>[^:=\s]+):=(?P<new>[^:=\s]+)")


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Plays bags onto the hub: MCAP, ROS 2's .db3 and folders, ROS 1's .bag. The rules decide to which sides"
        " each topic is bridged. Velocities, goals and cancels are left out without --commands."
    )
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="bags; several are played as one, ordered by time"
    )
    group = parser.add_argument_group("what")
    group.add_argument(
        "--topics", nargs="+", action="extend", metavar="TOPIC", help="names or globs, such as '/camera/**'"
    )
    add_exclude(group)
    group.add_argument(
        "--remap", action="append", default=[], type=remapping, metavar="OLD:=NEW",
        help="another name for a topic; may be repeated",
    )  # fmt: skip
    group.add_argument(
        "--commands", action="store_true",
        help="play velocities, goals and cancels too: THE ROBOT MOVES. Late commands are dropped; a zero velocity is"
        " sent on a pause and at the end",
    )  # fmt: skip
    when = parser.add_argument_group("when")
    when.add_argument("--rate", type=number_in(0.01, 100), default=1.0, metavar="R", help="speed factor (default 1)")
    when.add_argument("--loop", action="store_true", help="start over at the end, until Ctrl-C")
    when.add_argument(
        "--start", type=span, default=0.0, metavar="TIME", help="start this long after the beginning of the bags"
    )
    when.add_argument("--duration", type=span, metavar="TIME", help="stop after this much bag time")
    when.add_argument("--paused", action="store_true", help="start paused")
    when.add_argument(
        "--clock", type=number_in(1, 1000), nargs="?", const=CLOCK_HZ, default=0.0, metavar="HZ",
        help=f"publish the bags' time on /clock at this rate (default {CLOCK_HZ:g}); the time stops during a pause",
    )  # fmt: skip
    when.add_argument(
        "--settle", type=span, default=1.0, metavar="TIME", help="time for subscribers to connect first (default 1s)"
    )
    parser.add_argument("--json", action="store_true", help="print a summary as JSON at the end: messages, drops")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def remapping(text: str) -> tuple[str, str]:
    """Parse a remapping such as ``/scan:=/laser/scan``."""
    from bridge.client.graph import absolute

    match = _REMAP.fullmatch(text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a remapping: write it as /scan:=/laser/scan")
    return absolute(match["old"]), absolute(match["new"])


def run(args: argparse.Namespace) -> int:
    """Play to the end, or until Ctrl-C."""
    from bridge.bags.bag import BagError

    try:
        with ExitStack() as stack:
            bags = _open_bags(args.files, stack)
            with open_client(args) as client, _signals() as ended:
                code = _play(args, client, bags, ended)
                return code or (128 + ended.number if ended.number else 0)
    except BagError as err:
        raise CliError(str(err)) from None


def _open_bags(files: list[Path], stack: ExitStack) -> list[Bag]:
    from bridge.bags.reader import open_bag

    bags = [stack.enter_context(open_bag(file)) for file in files]
    for bag in bags:
        if bag.trouble is not None:
            _print_note(str(bag.trouble))
        for name in bag.left_out:
            _print_note(f"{bag.path}: {name} is left out")
    return bags


class _Ended(threading.Event):
    """The end of the command: by ``number``, if it is SIGTERM or SIGHUP, or else by Ctrl-C or a key."""

    number = 0


@contextmanager
def _signals() -> Iterator[_Ended]:
    """Yield an event that Ctrl-C, SIGTERM and SIGHUP (a closed terminal) set; an ignored SIGHUP stays ignored."""
    ended = _Ended()

    def on_signal(number: int, _frame: object) -> None:
        if number != signal.SIGINT:
            ended.number = ended.number or number
        ended.set()

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield ended
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _play(args: argparse.Namespace, client: Client, bags: list[Bag], ended: threading.Event) -> int:
    from bridge.bags.play.output import HubOutput
    from bridge.bags.play.player import Player
    from bridge.bags.play.services import PlayServices
    from bridge.bags.play.source import PlayPart, PlaySource
    from bridge.bags.play.timeline import Timeline
    from bridge.bags.play.topics import PlayChoice, choose
    from bridge.routing.rules import NameFilter

    registry = client.registry()
    names = NameFilter(args.topics or ["/**"], args.exclude)
    wanted = PlayChoice(names.matches, dict(args.remap), args.commands, bool(args.clock))
    chosen, left = choose(bags, registry, client.config, wanted)
    topics = [topic for of_bag in chosen.values() for topic in of_bag]
    _report_choice(topics, left, args.rate)
    source = PlaySource(chosen, PlayPart(args.start, args.duration))
    client.settle()
    output = HubOutput(client.hub, registry, topics, clock=bool(args.clock))
    timeline = Timeline(args.rate, paused=args.paused, clock_hz=args.clock)
    moving = [(topic.name, topic.type_name, topic.type_hash) for topic in topics if topic.command]
    moves = bool(moving)
    if moves:
        warn_of_refusals(client, moving)
    services = PlayServices(client.hub, registry, timeline, commands=moves)
    player = Player(source, output, timeline, loop=args.loop, report=_print_note)
    if services.taken:
        _print_note(
            "another player is on the hub: a call to /midspan/play/pause or /midspan/play/step reaches only one of them"
        )
    failed: BaseException | None = None
    try:
        _begin(args, output, ended)
        if not ended.is_set():
            failed = _follow(args, player, source, ended)
    finally:
        output.finish()  # first, because the services' loop may take a moment to end
        services.close()
        if player.played:
            threading.Event().wait(_LINGER_SECONDS)
        output.close()
    if args.json:
        print_json(_summary(player, left))
    else:
        _report_end(player)
    if failed is not None:
        raise failed
    return 0


def _report_choice(topics: list[PlayTopic], left: list[LeftOut], rate: float) -> None:
    from bridge.bags.play.topics import names_with_several_types

    for other in left:
        _print_note(f"{other.name} ({other.type_name}) is left out: {other.why}")
    if not topics:
        raise CliError("there is nothing to play: no topic remains" + ("" if left else " after --topics and --exclude"))
    for name in sorted(names_with_several_types(topics)):
        _print_note(f"{name} has several types in the bags, and each subscriber receives only one of them")
    if moving := sorted({topic.name for topic in topics if topic.command}):
        _print_note(f"commands are played, the robot may move: {', '.join(moving)}")
        if rate != 1.0:
            _print_note(
                f"at a rate of {rate:g}, each velocity lasts {1 / rate:.2g} times as long: the robot takes another path"
            )


def _begin(args: argparse.Namespace, output: Any, ended: threading.Event) -> None:
    """Warn of a live robot, and let subscribers connect."""
    for name, nodes in output.others().items():
        _print_note(
            f"{name} has a publisher already, {', '.join(sorted(set(nodes)))}: subscribers receive both (a live robot?)"
        )
    subscribed, unmatched = output.await_listeners(APPEAR_SECONDS, MATCH_SECONDS, ended)
    if unmatched and not ended.is_set():
        _print_note(f"subscribers of {', '.join(unmatched)} are not connected yet: they may miss the first messages")
    if subscribed:
        # the workers have subscribed; programs on their sides still have to connect to the workers' publishers
        interruptible(ended.wait, args.settle)


def _follow(
    args: argparse.Namespace, player: Player, source: PlaySource, ended: threading.Event
) -> BaseException | None:
    """Play on another thread and handle keys, progress and signals here; return the exception that playing raised."""
    from bridge.cli.bags.play_screen import Screen
    from bridge.cli.keyboard import AVAILABLE

    failed: list[BaseException] = []

    def play() -> None:
        try:
            player.run()
        except BaseException as err:
            failed.append(err)

    thread = threading.Thread(target=play, name="midspan-play", daemon=True)
    keys, progress = AVAILABLE and sys.stdin.isatty(), sys.stderr.isatty() and not args.json
    with Screen(player, source, keys=keys, progress=progress) as screen:
        thread.start()
        while thread.is_alive() and not ended.is_set():
            if screen.poll(_POLL_SECONDS, ended):
                break
        player.timeline.stop()
        thread.join(_END_SECONDS)
    return failed[0] if failed else None


def _summary(player: Player, left: list[LeftOut]) -> dict[str, Any]:
    drops = [{"topic": name, "reason": reason, "count": n} for (name, reason), n in sorted(player.dropped.items())]
    return {
        "messages": player.played.total(), "topics": dict(sorted(player.played.items())), "dropped": drops,
        "behind": round(player.timeline.behind, 3), "loops": player.loops,
        "left_out": [{"topic": e.name, "type": e.type_name, "why": e.why, "command": e.command} for e in left],
    }  # fmt: skip


def _report_end(player: Player) -> None:
    drops = "".join(f"; {count} {reason} of {clean(name)}" for (name, reason), count in sorted(player.dropped.items()))
    behind = player.timeline.behind
    late = f"; {behind:.1f} s behind schedule, because playback could not keep up" if behind else ""
    print(f"played {plural(player.played.total(), 'message')}{drops and f', dropped: {drops[2:]}'}{late}")


def _print_note(text: str) -> None:
    over = "\r\x1b[K" if sys.stderr.isatty() else ""  # erases the progress line
    print(f"{over}{clean(text)}", file=sys.stderr, flush=True)

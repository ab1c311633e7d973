"""``midspan tf monitor``: how often each frame is told, how late, and by whom."""

from __future__ import annotations

import argparse
import contextlib
import math
import time
from collections.abc import Iterable, Mapping
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.cli.console import make_console, print_json
from bridge.cli.errors import CliError
from bridge.cli.text import clean, duration, rate
from bridge.cli.tf_feed import Heard, add_tf_arguments, open_heard
from bridge.cli.tf_meter import Meter
from bridge.tf.errors import TransformError
from bridge.tf.transform import FrameInfo

_INTERVAL = 2.0


def register(verbs: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "monitor",
        help="rates, delays, authorities and ages of frames",
        description="Prints for each frame how often it is told, the delay from its stamp until it came here (between"
        " machines as good as their clocks agree; less than zero where it is stamped ahead), who tells it, and the"
        " time since it was told last. Of two frames, only those on the way between them, and how old the newest"
        " transform between them is. Until Ctrl-C, or for --duration.",
    )
    parser.add_argument("frames", nargs="*", metavar="FRAME", help="two frames")
    parser.add_argument(
        "--interval", type=float, default=_INTERVAL, metavar="SECONDS", help=f"how often (default {_INTERVAL:g})"
    )
    parser.add_argument("--duration", type=float, metavar="SECONDS", help="end after so long")
    parser.add_argument("--json", action="store_true", help="one JSON list a line")
    add_tf_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Print tables until Ctrl-C, or for so long."""
    if len(args.frames) not in (0, 2):
        raise CliError("name two frames, or none")
    with open_heard(args) as heard, contextlib.suppress(KeyboardInterrupt):
        heard.wait()
        end = math.inf if args.duration is None else time.monotonic() + args.duration
        while (left := end - time.monotonic()) > 0:
            heard.listen(min(args.interval, left))
            _print(args, heard)
    return 0


def way(frames: Mapping[str, FrameInfo], one: str, other: str) -> list[str]:
    """The frames on the way from one to another, without the last one above both."""
    ups: list[list[str]] = []
    for name in (one, other):
        up: list[str] = []
        while name in frames and name not in up:
            up.append(name)
            name = frames[name].parent
        ups.append(up)
    return [name for name in [*ups[0], *ups[1]] if (name in ups[0]) != (name in ups[1])]


def _print(args: argparse.Namespace, heard: Heard) -> None:
    meters, now = heard.meters(), time.monotonic()
    frames = {info.name: info for info in heard.buffer.frames() if info.name in meters}
    said = ""
    if args.frames:
        one, other = (name.lstrip("/") for name in args.frames)
        said = _age(heard, one, other)
        frames = {name: frames[name] for name in sorted(way(frames, one, other))}
    if args.json:
        print_json([_json(info, meters[info.name], now) for info in frames.values()], lines=True)
        return
    make_console().print(_table(frames.values(), meters, now))
    if said:
        print(said, flush=True)


def _age(heard: Heard, one: str, other: str) -> str:
    try:
        found = heard.buffer.lookup_transform(one, other)
    except TransformError as err:
        return clean(err).strip()
    if not found.stamp:
        return f"{one} to {other}: static"
    return f"{one} to {other}: newest {(heard.clock.now_ns() - found.stamp) / 1e9:.3f} s old"


def _json(info: FrameInfo, meter: Meter, now: float) -> dict[str, Any]:
    return {
        "frame": info.name,
        "parent": info.parent,
        "authorities": sorted({source.authority for source in info.sources}),
        "static": info.static,
        "count": meter.count,
        "rate": meter.rate(now),
        "delay": meter.delay,
        "longest_delay": meter.longest,
        "age": now - meter.arrived,
    }


def _table(frames: Iterable[FrameInfo], meters: Mapping[str, Meter], now: float) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("frame", "parent", "authority"):
        table.add_column(name, overflow="fold")
    for name in ("Hz", "delay", "longest", "age"):
        table.add_column(name, justify="right")
    for info in frames:
        meter = meters[info.name]
        table.add_row(
            Text(clean(info.name), style="bold"),
            Text(clean(", ".join(sorted(info.parents))), style="red" if len(info.parents) > 1 else ""),
            Text(clean(", ".join(sorted({source.authority for source in info.sources})))),
            Text("static" if info.static else rate(meter.rate(now))),
            Text(_seconds(meter.delay)),
            Text(_seconds(meter.longest)),
            Text(duration(now - meter.arrived)),
        )
    return table


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f} s"

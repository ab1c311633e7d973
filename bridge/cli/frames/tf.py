"""``midspan tf``: list, tree, echo and monitor for the frames of all sides."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import time
from collections.abc import Iterable, Mapping
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.cli.arguments import add_verb, add_verbs, number_in, seconds
from bridge.cli.frames.listener import add_tf_arguments, open_listener
from bridge.cli.output import CliError, print_json
from bridge.client.transforms import MOST, QUIET, FrameMeter, TransformListener
from bridge.text import clean, duration, make_console, rate
from bridge.tf import tree
from bridge.tf.errors import InvalidArgumentError, TransformError
from bridge.tf.transform import FrameInfo, Transform, angles_of


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(parser, "Shows the frames on /tf and /tf_static of all sides. It needs no module.")
    _register_list_and_tree(verbs)
    _register_echo(verbs)
    _register_monitor(verbs)


def _register_list_and_tree(verbs: Any) -> None:
    listing = add_verb(verbs, "list", _list, "list all frames", "Lists the frames that are published.", hub=False)
    listing.add_argument("-v", "--verbose", action="store_true", help="add parents, authorities, rates, newest stamps")
    drawing = add_verb(
        verbs, "tree", _tree, "draw the tree of frames, as text or for Graphviz",
        "Draws the tree of the frames that are published. Marks loops, and frames to which several programs give"
        " different parents.",
        example="midspan tf tree --dot | dot -Tpdf > frames.pdf", hub=False,
    )  # fmt: skip
    drawing.add_argument("--dot", action="store_true", help="print the tree in Graphviz's format")
    for parser in (listing, drawing):
        parser.add_argument(
            "--duration", type=seconds, metavar="SECONDS",
            help="how long to listen after the first transform; slow frames need longer (default: until every node of"
            f" the hub has published and {QUIET:g} s passed without a new frame; {MOST:g} s if other publishers exist)",
        )  # fmt: skip
        parser.add_argument("--json", action="store_true", help="print all details of each frame as JSON")
        add_tf_arguments(parser)


def _list(args: argparse.Namespace) -> int:
    with open_listener(args) as listener:
        frames = _frames(args, listener)
    if args.json:
        print_json([frame_json(info) for info in frames])
    elif args.verbose:
        make_console().print(_table(frames))
    else:
        for name in sorted({info.name for info in frames} | {info.parent for info in frames}):
            print(clean(name))
    return 0


def _tree(args: argparse.Namespace) -> int:
    with open_listener(args) as listener:
        frames = _frames(args, listener)
    if args.json:
        print_json([frame_json(info) for info in frames])
    else:
        drawn = tree.as_dot(frames) if args.dot else tree.as_text(frames)
        print("\n".join(line[: len(line) - len(line.lstrip())] + clean(line.lstrip()) for line in drawn.splitlines()))
    return 0


def frame_json(info: FrameInfo) -> dict[str, Any]:
    """Return the details of a frame, for ``--json``."""
    return {
        "frame": info.name,
        "parent": info.parent,
        "authority": info.authority,
        "static": info.static,
        "oldest_ns": info.oldest,
        "newest_ns": info.newest,
        "samples": info.samples,
        "rate": info.rate,
        "sources": [{"parent": s.parent, "authority": s.authority, "newest_ns": s.stamp} for s in info.sources],
    }


def _frames(args: argparse.Namespace, listener: TransformListener) -> list[FrameInfo]:
    listener.wait()
    if args.duration is not None:
        listener.listen(args.duration)
    elif (passed := listener.gather()) < MOST:
        print(f"listened for {passed:.1f} s; for slow frames: --duration SECONDS", file=sys.stderr)
    return listener.buffer.frames()


def _table(frames: Iterable[FrameInfo]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("frame", "parent", "authority"):
        table.add_column(name, overflow="fold")
    for name in ("Hz", "newest"):
        table.add_column(name, justify="right")
    for info in frames:
        several = len(info.parents) > 1
        table.add_row(
            Text(clean(info.name), style="bold"),
            Text(clean(", ".join(sorted(info.parents)) if several else info.parent), style="red" if several else ""),
            Text(clean(", ".join(sorted({source.authority for source in info.sources})))),
            Text("static" if info.static else rate(info.rate)),
            Text("" if info.static else f"{info.newest / 1e9:.3f}"),
        )
    return table


_RATE = 1.0
_POLL_SECONDS = 1.0


def _register_echo(verbs: Any) -> None:
    parser = add_verb(
        verbs, "echo", _echo, "print the pose of one frame in another",
        "Prints the pose of FRAME in REFERENCE, which maps points from FRAME to REFERENCE, until Ctrl-C. The pose is"
        " for the newest time at which all frames between the two have data. While the pose is unknown, the reason is"
        " printed.",
        example="midspan tf echo map base_link", hub=False,
    )  # fmt: skip
    parser.add_argument("reference", metavar="REFERENCE", help="the reference frame, for example map")
    parser.add_argument("frame", metavar="FRAME", help="the frame to locate, for example base_link")
    parser.add_argument(
        "--rate", type=number_in(0, 1000), default=_RATE, metavar="HZ", help=f"poses per second, default {_RATE:g}"
    )
    parser.add_argument("--count", type=int, metavar="N", help="exit after N poses")
    parser.add_argument(
        "--timeout", type=seconds, metavar="SECONDS", help="exit with code 1 after this time without a pose"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per line")
    add_tf_arguments(parser)


def _echo(args: argparse.Namespace) -> int:
    with open_listener(args) as listener, contextlib.suppress(KeyboardInterrupt):
        shown = 0
        while args.count is None or shown < args.count:
            due = time.monotonic() + 1.0 / args.rate
            _print_pose(args, listener, _next(args, listener))
            shown += 1
            if shown != args.count:
                listener.listen(due - time.monotonic())
    return 0


def _next(args: argparse.Namespace, listener: TransformListener) -> Transform:
    """Wait for a transform, and print why it is missing; raises `CliError` after the timeout or for an invalid name."""
    end = math.inf if args.timeout is None else time.monotonic() + args.timeout
    printed = ""
    while True:
        left = max(0.0, end - time.monotonic())
        try:
            return listener.buffer.lookup_transform(args.reference, args.frame, timeout=min(left, _POLL_SECONDS))
        except TransformError as err:
            reason = clean(err).strip()
            if left <= _POLL_SECONDS or isinstance(err, InvalidArgumentError):
                raise CliError(reason) from None
        if reason != printed:
            print(f"waiting: {reason}", file=sys.stderr, flush=True)
            printed = reason
        listener.refresh()


def _print_pose(args: argparse.Namespace, listener: TransformListener, transform: Transform) -> None:
    age = (listener.clock.now_ns() - transform.stamp) / 1e9 if transform.stamp else None
    if args.json:
        print_json(
            {
                "reference": transform.frame_id,
                "frame": transform.child_frame_id,
                "time_ns": transform.stamp,
                "age": age,
                "translation": dict(zip("xyz", transform.translation, strict=True)),
                "rotation": dict(zip("xyzw", transform.rotation, strict=True)),
            },
            lines=True,
        )
        return
    when = "static" if age is None else f"at {transform.stamp / 1e9:.3f} s, {age:.3f} s ago"
    translation = ", ".join(f"{part:.3f}" for part in transform.translation)
    rotation = ", ".join(f"{part:.4f}" for part in transform.rotation)
    angles = ", ".join(f"{math.degrees(part):.2f}" for part in angles_of(transform.rotation))
    print(f"{when}\n  x, y, z:          {translation} m", flush=False)
    print(f"  roll, pitch, yaw: {angles} degrees\n  quaternion:       {rotation}", flush=True)


_INTERVAL = 2.0


def _register_monitor(verbs: Any) -> None:
    parser = add_verb(
        verbs, "monitor", _monitor, "print rates, delays, authorities and ages of frames",
        "Prints each frame's rate, its delay from stamp to arrival (between machines only as accurate as their clocks;"
        " negative if stamped ahead), its publishers, and the time since its last message, until Ctrl-C or for"
        " --duration. With two frames, it prints only the frames between them, and the age of the newest transform.",
        hub=False,
    )  # fmt: skip
    parser.add_argument("frames", nargs="*", metavar="FRAME", help="two frames")
    parser.add_argument(
        "--interval", type=seconds, default=_INTERVAL, metavar="SECONDS", help=f"between tables, default {_INTERVAL:g}"
    )
    parser.add_argument("--duration", type=seconds, metavar="SECONDS", help="exit after this time")
    parser.add_argument("--json", action="store_true", help="one JSON list per line")
    add_tf_arguments(parser)


def _monitor(args: argparse.Namespace) -> int:
    """Print tables until Ctrl-C, or for the given duration."""
    if len(args.frames) not in (0, 2):
        raise CliError("name two frames, or none")
    with open_listener(args) as listener, contextlib.suppress(KeyboardInterrupt):
        listener.wait()
        end = math.inf if args.duration is None else time.monotonic() + args.duration
        while (left := end - time.monotonic()) > 0:
            listener.listen(min(args.interval, left))
            _print_meters(args, listener)
    return 0


def connecting_frames(frames: Mapping[str, FrameInfo], one: str, other: str) -> list[str]:
    """Return the frames on the path from one to the other, without their common ancestors."""
    ups: list[list[str]] = []
    for name in (one, other):
        up: list[str] = []
        while name in frames and name not in up:
            up.append(name)
            name = frames[name].parent
        ups.append(up)
    return [name for name in [*ups[0], *ups[1]] if (name in ups[0]) != (name in ups[1])]


def _print_meters(args: argparse.Namespace, listener: TransformListener) -> None:
    meters, now = listener.meters(), time.monotonic()
    frames = {info.name: info for info in listener.buffer.frames() if info.name in meters}
    age = ""
    if args.frames:
        first, other = (name.lstrip("/") for name in args.frames)
        age = _age_text(listener, first, other)
        frames = {name: frames[name] for name in sorted(connecting_frames(frames, first, other))}
    if args.json:
        print_json([_meter_json(info, meters[info.name], now) for info in frames.values()], lines=True)
        return
    make_console().print(_meter_table(frames.values(), meters, now))
    if age:
        print(age, flush=True)


def _age_text(listener: TransformListener, one: str, other: str) -> str:
    try:
        transform = listener.buffer.lookup_transform(one, other)
    except TransformError as err:
        return clean(err).strip()
    if not transform.stamp:
        return f"{one} to {other}: static"
    return f"{one} to {other}: newest {(listener.clock.now_ns() - transform.stamp) / 1e9:.3f} s old"


def _meter_json(info: FrameInfo, meter: FrameMeter, now: float) -> dict[str, Any]:
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


def _meter_table(frames: Iterable[FrameInfo], meters: Mapping[str, FrameMeter], now: float) -> Table:
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
            Text(_seconds_text(meter.delay)),
            Text(_seconds_text(meter.longest)),
            Text(duration(now - meter.arrived)),
        )
    return table


def _seconds_text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f} s"

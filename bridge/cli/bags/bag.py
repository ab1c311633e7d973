"""``midspan bag``: inspect, convert, cut and repair bags, without a daemon."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.arguments import add_config, add_exclude, add_verb, add_verbs, span
from bridge.cli.output import CliError, print_json
from bridge.text import clean, duration, make_console, plural, rate, size

if TYPE_CHECKING:
    from bridge.bags.bag import Bag, BagTopic
    from bridge.bags.copy import BagSelection, CopyResult, OnProgress

_NS = 1_000_000_000
_UNIX = 1e8
"""A number of seconds from this value on is Unix time; a smaller number is relative to the bag's start."""


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(
        parser,
        "Inspects and copies bags: MCAP (.mcap), ROS 2's SQLite files (.db3, or a folder) and ROS 1 bags (.bag).",
    )
    info = add_verb(
        verbs, "info", _info, "show a bag's topics, types, counts, rates and times",
        example="midspan bag info run.mcap", hub=False,
    )  # fmt: skip
    info.add_argument("bag", type=Path, metavar="BAG", help="a file, or a rosbag2 folder")
    info.add_argument("--json", action="store_true", help="print the result as JSON")
    convert = add_verb(
        verbs, "convert", _convert, "copy a bag into another format",
        "Copies a bag into the format given by OUT's extension; without an extension, OUT is a rosbag2 folder. Messages"
        " and types are converted to those of ROS 1 or ROS 2 as in the bridge. OUT appears once it is complete.",
        example="midspan bag convert old.bag new.mcap", hub=False,
    )  # fmt: skip
    convert.add_argument("--skip-unknown", action="store_true", help="leave out topics that the new format cannot hold")
    convert.add_argument("--skip-bad", action="store_true", help="leave out messages that do not match their type")
    add_config(convert)
    cut = add_verb(
        verbs, "cut", _cut, "copy a part of a bag, in its format",
        "Copies a part of a bag into a new bag of the same format, with unchanged messages.",
        example="midspan bag cut run.mcap crash.mcap --start 30s --end 1m --latched", hub=False,
    )  # fmt: skip
    mend = add_verb(
        verbs, "mend", _mend, "write the readable data of a damaged bag into a complete one",
        "Writes all readable data of a damaged bag, or of one whose writer was killed, into a complete bag of the same"
        " format, and reports what is lost.",
        example="midspan bag mend killed.mcap whole.mcap", hub=False,
    )  # fmt: skip
    for verb in (convert, cut, mend):
        verb.add_argument("bag", type=Path, metavar="IN", help="a file, or a rosbag2 folder")
        verb.add_argument("out", type=Path, metavar="OUT", help="must not exist yet")
        verb.add_argument("--compression", choices=["zstd", "lz4", "bz2", "none"], help="default: the format's own")
        verb.add_argument("--json", action="store_true", help="print the result as JSON")
    for verb in (convert, cut):
        verb.add_argument(
            "--topics", nargs="+", action="extend", metavar="TOPIC", help="names or globs, such as '/camera/**'"
        )
        add_exclude(verb)
        verb.add_argument(
            "--start",
            type=_moment,
            metavar="TIME",
            help="begin at this time: 30s or 2m into the bag, Unix seconds, or a date and time",
        )
        verb.add_argument("--end", type=_moment, metavar="TIME", help="end before this time")
        verb.add_argument(
            "--latched", action="store_true", help="begin with the last latched messages from before --start"
        )


def _moment(text: str) -> tuple[bool, int]:
    """Parse a time; return whether it is absolute, and its nanoseconds since 1970 or since the bag's start."""
    with suppress(argparse.ArgumentTypeError):
        return (value := span(text)) >= _UNIX, round(value * _NS)
    try:
        return True, round(datetime.fromisoformat(text).timestamp() * _NS)
    except ValueError:
        msg = f"{text!r} is not a time: write it as 30s, 2m, 1700000000.5 or 2026-05-04T10:30:00"
        raise argparse.ArgumentTypeError(msg) from None


_signals: list[int] = []
"""The received signals; stored because Python loses an exception that is raised inside some of its callbacks, as during
an import."""


def _on_signal(number: int, _frame: object) -> None:
    _signals.append(number)
    if len(_signals) == 1:  # the exception of a second signal would interrupt the cleanup of the first
        # not a KeyboardInterrupt: inside an `eval`, as during an import, it would change the exit code
        raise SystemExit(128 + number)


@contextmanager
def _open(path: Path) -> Iterator[Bag]:
    """Open a bag, and report its errors as `CliError`. SIGTERM and Ctrl-C exit after removing half-written files.

    Ignored signals stay ignored, because Ctrl-C in a shell script must not end a background command.
    """
    from bridge.bags.reader import BagError, open_bag

    _signals.clear()
    handled = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is not signal.SIG_IGN]
    before = {number: signal.signal(number, _on_signal) for number in handled}
    try:
        with open_bag(path) as bag:
            yield bag
    except BagError as err:
        raise CliError(clean(err)) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _selection(args: argparse.Namespace, bag: Bag) -> BagSelection:
    from bridge.bags.copy import BagSelection
    from bridge.routing.rules import NameFilter

    start, end = (
        None if moment is None else moment[1] + (0 if moment[0] else bag.start_ns) for moment in (args.start, args.end)
    )
    if start is not None and end is not None and end <= start:
        raise CliError("--end is not after --start")
    names = NameFilter(args.topics or ["/**"], args.exclude) if args.topics or args.exclude else None
    return BagSelection(names, start, end, args.latched)


def _info(args: argparse.Namespace) -> int:
    with _open(args.bag) as bag:
        info = describe(bag)
    if args.json:
        print_json(info)
    else:
        _print_info(info)
    return 0


def describe(bag: Bag) -> dict[str, Any]:
    """Return the output of ``midspan bag info``."""
    seconds = (bag.end_ns - bag.start_ns) / _NS
    return {
        "file": str(bag.path),
        "format": bag.kind,
        "bytes": bag.size,
        "compression": bag.compression,
        "start": bag.start_ns / _NS,
        "end": bag.end_ns / _NS,
        "seconds": seconds,
        "messages": sum(topic.count for topic in bag.topics),
        "unfinished": bag.unfinished,
        "trouble": None if bag.trouble is None else str(bag.trouble),
        "not_read": list(bag.left_out),
        "about": {name: dict(values) for name, values in bag.about.items()},
        "topics": [_describe_topic(topic, seconds) for topic in sorted(bag.topics, key=lambda topic: topic.name)],
    }


def _describe_topic(topic: BagTopic, seconds: float) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "world": topic.world.value,
        "type_hash": topic.type_hash,
        "defined": bool(topic.definition),
        "messages": topic.count,
        "rate": round((topic.count - 1) / seconds, 3) if seconds > 0 and topic.count > 1 else 0.0,
        "latched": topic.qos.latched,
        "reliability": topic.qos.reliability.name.lower(),
        "metadata": dict(topic.metadata),
    }


def _print_info(info: dict[str, Any]) -> None:
    from rich.table import Table

    when = [datetime.fromtimestamp(info[name]).isoformat(" ", "milliseconds") for name in ("start", "end")]
    print(f"{clean(info['file'])}: {info['format']}, {size(info['bytes'])}, compression {clean(info['compression'])}")
    if info["messages"]:
        print(f"{when[0]} to {when[1]}, {duration(info['seconds'])}, {plural(info['messages'], 'message')}")
    else:
        print("no messages")
    if info["unfinished"]:
        print("unfinished: the writer never closed the bag, or the bag's end is lost")
    if info["trouble"]:
        print(clean(info["trouble"]))
    for name, values in info["about"].items():
        print(clean(f"{name}: " + ", ".join(f"{key} {value}" for key, value in values.items())))
    for name in info["not_read"]:
        print(f"not read: {clean(name)}")
    table = Table(box=None, pad_edge=False)
    for name in ("topic", "type", "messages", "msg/s", "side", ""):
        table.add_column(name, justify="right" if name in ("messages", "msg/s") else "left")
    for topic in info["topics"]:
        more = topic["metadata"]
        # in recordings, messages published on the hub itself have the side "zenoh" and no origin
        side = "hub" if more.get("side") == "zenoh" and not more.get("origin") else more.get("side")
        origin = " of ".join(clean(name) for name in (side, more.get("daemon")) if name) or topic["world"]
        notes = [*(["latched"] if topic["latched"] else []), *([] if topic["defined"] else ["no definition"])]
        table.add_row(
            clean(topic["name"]), clean(topic["type"]), str(topic["messages"]), rate(topic["rate"]), origin,
            ", ".join(notes),
        )  # fmt: skip
    make_console().print(table)


def _convert(args: argparse.Namespace) -> int:
    from bridge.bags.copy import convert
    from bridge.bags.writers import kind_of
    from bridge.config.load import load
    from bridge.messages.registry import Registry

    registry = Registry.of(load(args.config).types)
    with _open(args.bag) as bag:
        kind = kind_of(args.out)
        choice = _selection(args, bag)
        started = time.monotonic()
        with _progress(bag) as on_progress:
            done = convert(
                bag, args.out, kind, registry, choice, args.compression or "",
                skip_unknown=args.skip_unknown, skip_bad=args.skip_bad, on_progress=on_progress,
            )  # fmt: skip
        if bag.trouble is not None:
            done.damage.append(bag.trouble)
    _report(args, done, time.monotonic() - started)
    return 0


def _cut(args: argparse.Namespace) -> int:
    return _cut_or_mend(args, mend=False)


def _mend(args: argparse.Namespace) -> int:
    return _cut_or_mend(args, mend=True)


def _cut_or_mend(args: argparse.Namespace, *, mend: bool) -> int:
    from bridge.bags.copy import BagSelection, cut
    from bridge.bags.writers import kind_of

    with _open(args.bag) as bag:
        if kind_of(args.out) != bag.kind:
            extension = f"{args.out} has the extension of another format"
            raise CliError(f"{args.bag} is {bag.kind}, but {extension}; use 'midspan bag convert'")
        choice = BagSelection() if mend else _selection(args, bag)
        started = time.monotonic()
        with _progress(bag) as on_progress:
            done = cut(bag, args.out, choice, args.compression or "", mend=mend, on_progress=on_progress)
        if bag.trouble is not None and not mend:
            done.damage.append(bag.trouble)
    _report(args, done, time.monotonic() - started)
    return 0


@contextmanager
def _progress(bag: Bag) -> Iterator[OnProgress]:
    """Show a progress bar on standard error, if that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    total = sum(topic.count for topic in bag.topics)
    console = Console(stderr=True)
    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[speed]}"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=total, speed="")
        started = time.monotonic()

        def on_progress(messages: int, data: int) -> None:
            if _signals:
                raise SystemExit(128 + _signals[0])
            speed = f"{size(data)}, {size(data / max(time.monotonic() - started, 1e-3))}/s"
            bar.update(task, completed=messages, speed=speed)

        yield on_progress


def _report(args: argparse.Namespace, done: CopyResult, seconds: float) -> None:
    document = {
        "file": str(args.out),
        "messages": done.messages,
        "bytes": done.data,
        "seconds": round(seconds, 3),
        "unknown": done.unknown,
        "bad": done.refused,
        "renamed": done.renamed,
        "undefined": {name: asdict(topic) for name, topic in done.undefined.items()},
        "fields_lost": {name: list(fields) for name, fields in done.lost.items()},
        "damage": [str(err) for err in done.damage],
        "not_read": list(done.left_out),
    }
    if args.json:
        print_json(document)
        return
    print(f"{clean(args.out)}: {plural(done.messages, 'message')}, {size(done.data)}, {duration(seconds)}")
    for old, new in done.renamed.items():
        print(f"renamed: {clean(old)} is {clean(new)} in the new file")
    for name in done.left_out:
        print(f"not read: {clean(name)}")
    for reason in done.unknown.values():
        print(f"left out: {clean(reason)}")
    for name, count in done.refused.items():
        print(f"left out: {plural(count, 'message')} of {clean(name)} that do not match their type")
    for name, topic in done.undefined.items():
        text = f"{plural(topic.messages, 'message')} of {clean(name)} ({clean(topic.type_name)})"
        print(f"copied without a definition, so that readers cannot decode it: {text}: {clean(topic.reason)}")
        print(f"    cure: {clean(topic.cure)}")
    for name, fields in done.lost.items():
        print(f"ROS 2 has no place for {clean(', '.join(fields))} of {clean(name)}")
    for err in done.damage:
        where = f"{err.path.name}, " if err.path != args.bag else ""
        place = f" ({where}byte {err.offset})" if err.offset is not None else where and f" ({err.path.name})"
        print(clean(f"not read: {err.what}{place}"))

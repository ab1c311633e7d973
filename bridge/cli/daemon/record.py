"""``midspan record``: records topics of any side into MCAP files, here or in the daemon."""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.cli.arguments import add_exclude, add_hub_arguments, span
from bridge.cli.client import CliClient, client_config, open_client, warn_of_daemon
from bridge.cli.output import CliError, print_json
from bridge.text import clean, size
from yarp_compat.file_names import forbidden

if TYPE_CHECKING:
    from bridge.config.model import Config
    from bridge.record.places import RecordPlace
    from bridge.record.section import RecordSection
    from bridge.record.status import RecordingStatus
    from bridge.record.worker import Recording

_EPILOG = """\
examples:
  midspan record -a                                    # all topics on the hub
  midspan record /scan /tf /tf_static -o run.mcap
  midspan record -a -x '^/camera' --split-size 1GB
  midspan record -a --side yarp --duration 1m          # also topics that stay on YARP
  midspan record -a --ring 10m --trigger /bumper       # the last ten minutes before each trigger
  midspan record --daemon trigger                      # trigger the daemon's recorder (section 'record')
"""
_COMMANDS = ("start", "stop", "split", "trigger")
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kMGT]?)i?B?", re.IGNORECASE)
_JOIN_SECONDS = 5.0
_NO_RECORDER = "set record.enabled in the daemon's configuration"
_POLL_SECONDS = 0.2


def megabytes(text: str) -> int:
    """Parse a size such as ``1GB``, ``500 MB`` or ``64`` (megabytes); each unit is 1,024 of the next smaller one."""
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size: write it as 500MB or 1GB")
    value = float(match[1]) * 1024.0 ** ({"k": -1, "": 0, "m": 0, "g": 1, "t": 2}[match[2].lower()])
    if value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is less than a megabyte")
    return int(value)


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Records topics of any side until Ctrl-C, into an MCAP file for ROS 2's tools, Foxglove and 'midspan play'. The"
        " messages are written as they are on the hub; each file starts with the latched ones. If the recording is"
        " killed, its file is readable up to the last second."
    )
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    group = parser.add_argument_group("what")
    group.add_argument("topics", nargs="*", metavar="TOPIC", help="names or globs, such as /camera/**")
    group.add_argument("-a", "--all", action="store_true", help="all topics")
    add_exclude(group)
    group.add_argument(
        "--side", action="append", default=[], metavar="SIDE",
        help="only topics of this side, including those that are not bridged: ros1, ros2, yarp, zenoh ...; may be"
        " repeated",
    )  # fmt: skip
    group.add_argument("--duration", type=span, metavar="TIME", help="exit after this time, such as 30s or 10m")
    files = parser.add_argument_group("where")
    files.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="file to write (default: midspan_<time>.mcap in this folder)"
    )
    files.add_argument(
        "--folder", action="store_true", help="write a folder of that name with a metadata.yaml, as rosbag2 does"
    )
    files.add_argument(
        "--split-size", type=megabytes, default=0, metavar="SIZE", help="start a new file at this size, such as 1GB"
    )
    files.add_argument(
        "--split-time", type=span, default=0.0, metavar="TIME", help="start a new file after this time, such as 10m"
    )
    files.add_argument(
        "--compression",
        choices=["zstd", "lz4", "none"],
        default="zstd",
        help="compression of the file's chunks (default zstd)",
    )
    files.add_argument(
        "--queue",
        type=megabytes,
        default=128,
        metavar="SIZE",
        help="maximum size of messages that wait to be written (default 128MB)",
    )
    ring = parser.add_argument_group("only the last minutes")
    ring.add_argument(
        "--ring", type=span, default=0.0, metavar="TIME",
        help="keep only this time span, and write it into a folder (inside that of -o) when triggered by"
        " 'midspan halt', a failed goal of the gateway, a call to /record/trigger, or --trigger",
    )  # fmt: skip
    ring.add_argument(
        "--ring-size", type=megabytes, default=2048, metavar="SIZE", help="maximum size of the ring (default 2GB)"
    )
    ring.add_argument(
        "--trigger",
        action="append",
        default=[],
        metavar="TOPIC",
        help="a message on this topic writes the ring; may be repeated",
    )
    parser.add_argument("--daemon", choices=_COMMANDS, help="control the daemon's recorder (section 'record')")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record until the time is over or Ctrl-C, or control the daemon's recorder."""
    if args.daemon is not None:
        with open_client(args) as client:
            return _command_daemon(client, args)
    if not (args.topics or args.all or args.side):
        raise CliError("name the topics to record: names, globs, or -a for all")
    if args.trigger and not args.ring:
        raise CliError("--trigger writes the ring: give --ring TIME too")
    config = client_config(args)
    # the local transport in the state folder belongs to the daemon
    config = config.model_copy(update={"hub": config.hub.model_copy(update={"lane": False})})
    section = _section(args)
    from bridge.record.places import stamp

    output: Path = args.output or Path("." if args.ring else f"midspan_{stamp()}.mcap")
    if reason := forbidden(output.name):
        raise CliError(f"{output} {reason}")
    if output.exists() and not (output.is_file() or output.is_dir()):
        raise CliError(f"cannot record into {output}: it is a pipe or a device; record into a file")
    warn_of_daemon(args, config)
    return _record(args, config, section, output)


def _command_daemon(client: CliClient, args: argparse.Namespace) -> int:
    answers = client.ask("record", {"do": args.daemon}, worker="record", timeout=15.0)
    if not answers:
        missing = client.daemon().why_missing("record", client.config)
        raise CliError(f"no recorder answers: {missing or _NO_RECORDER}")
    replies: list[dict[str, str]] = []
    for answer in answers:
        if answer.error:
            continue
        file = str(answer.value.get("file", "")) if isinstance(answer.value, dict) else ""
        replies.append({"daemon": answer.daemon, "done": args.daemon, "file": file})
        if not args.json:
            prefix = {"start": "records into", "trigger": "the ring is in"}.get(args.daemon, "closed")
            print(
                f"{clean(answer.daemon)}: {prefix} {clean(file)}" if file else f"{clean(answer.daemon)}: nothing to do"
            )
    if args.json and replies:
        print_json(replies)
    if failed := [f"the recorder of {answer.daemon}: {answer.error}" for answer in answers if answer.error]:
        raise CliError("\n".join(failed))
    return 0


def _section(args: argparse.Namespace) -> RecordSection:
    from pydantic import ValidationError

    from bridge.client.graph import absolute
    from bridge.record.section import RecordSection

    topics = [absolute(topic) for topic in args.topics]
    try:
        return RecordSection.model_validate(
            {
                "enabled": True,
                "topics": ["/**"] if args.all or not topics else topics,
                "exclude": args.exclude,
                "sides": args.side,
                "compression": args.compression,
                "queue": args.queue,
                "split": {"size": args.split_size, "seconds": args.split_time},
                "ring": {"seconds": args.ring, "size": args.ring_size},
                "keep": {"size": 0},
                "trigger": {"topics": [absolute(topic) for topic in args.trigger]},
            }
        )
    except ValidationError as err:
        first = err.errors()[0]
        raise CliError(f"{first['loc'][0]}: {first['msg'].removeprefix('Value error, ')}") from None


def _place(args: argparse.Namespace, section: RecordSection, output: Path) -> RecordPlace:
    from bridge.record.places import BagFolder, Files, KeptFolder
    from bridge.record.ring import Ring

    if args.ring:
        return Ring(KeptFolder(output, section.keep), section.ring)
    base = output.with_suffix("") if output.suffix == ".mcap" else output
    if args.folder:
        return BagFolder(base)
    return Files(base, split=bool(section.split.size or section.split.seconds))


def _record(args: argparse.Namespace, config: Config, section: RecordSection, output: Path) -> int:
    from bridge.record.worker import Recording

    recording = Recording(f"record_{os.getpid()}", config, section, _place(args, section, output))
    ended = threading.Event()
    before = {number: signal.signal(number, lambda *_: ended.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        _await_hub(recording, config, ended)
        if args.ring:
            recording.add_triggers(section)
        try:
            path = recording.recorder.begin()
        except OSError as err:
            raise CliError(f"cannot write {err.filename or output}: {err.strerror or err}") from None
        where = f"the last {args.ring:g} s are kept" if args.ring else f"recording into {path}"
        print(f"{where}; Ctrl-C ends the recording", file=sys.stderr, flush=True)
        _follow(recording, args.duration or None, ended)
    finally:
        recording.close()
        for number, handler in before.items():
            signal.signal(number, handler)
    status = recording.recorder.status()
    if args.json:
        print_json(status.document())
    else:
        _print(status)
    return 1 if status.error else 0


def _await_hub(recording: Recording, config: Config, ended: threading.Event) -> None:
    end = time.monotonic() + _JOIN_SECONDS
    while not recording.joined:
        if time.monotonic() > end or ended.is_set():
            raise CliError(
                f"no zenoh router answers at {config.hub.listen}\n"
                "Is the daemon running? Start it with 'midspan run', or name another router with --router."
            )
        ended.wait(_POLL_SECONDS)


def _follow(recording: Recording, duration: float | None, ended: threading.Event) -> None:
    """Wait for the end, and report errors and new files meanwhile."""
    end = None if duration is None else time.monotonic() + duration
    trouble = ""
    while not ended.wait(_POLL_SECONDS if end is None else max(0.0, min(_POLL_SECONDS, end - time.monotonic()))):
        try:
            recording.recorder.computes()
        except (RuntimeError, TimeoutError) as err:
            raise CliError(f"recording ends: {err}") from None
        status = recording.recorder.status()
        if status.error != trouble:
            trouble = status.error
            print(f"not recording: {trouble}" if trouble else f"recording again, into {status.file}", file=sys.stderr)
        if end is not None and time.monotonic() >= end:
            return


def _print(status: RecordingStatus) -> None:
    for topic in status.topics:
        dropped = sum(topic.dropped.values())
        drops = f", {dropped} dropped" if dropped else ""
        print(f"{clean(topic.topic)} ({clean(topic.type)}): {topic.messages} messages{drops}")
    drops = ", ".join(f"{count} {clean(reason)}" for reason, count in status.dropped.items())
    print(f"{status.file}: {status.messages} messages, {size(status.bytes)}" + (f"; dropped: {drops}" if drops else ""))
    if status.error:
        print(f"the recording ended early: {clean(status.error)}", file=sys.stderr)

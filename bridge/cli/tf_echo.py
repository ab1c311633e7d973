"""``midspan tf echo``: where one frame is in another, again and again."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import time
from typing import Any

from bridge.cli.console import print_json
from bridge.cli.errors import CliError
from bridge.cli.text import clean
from bridge.cli.tf_feed import Heard, add_tf_arguments, open_heard
from bridge.tf.errors import InvalidArgumentError, TransformError
from bridge.tf.transform import Quaternion, Transform

_RATE = 1.0
_LOOK_SECONDS = 1.0


def register(verbs: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "echo",
        help="print where one frame is in another",
        description="Prints the pose of FRAME in REFERENCE, which takes points from FRAME to REFERENCE, at the newest"
        " time that all frames between them know, until Ctrl-C. While there is none, it says why.",
        epilog="Example: midspan tf echo map base_link",
    )
    parser.add_argument("reference", metavar="REFERENCE", help="the frame to see it in, for example map")
    parser.add_argument("frame", metavar="FRAME", help="the frame to look at, for example base_link")
    parser.add_argument("--rate", type=_rate, default=_RATE, metavar="HZ", help=f"how often (default {_RATE:g})")
    parser.add_argument("--count", type=int, metavar="N", help="end after so many")
    parser.add_argument(
        "--timeout", type=float, metavar="SECONDS", help="end with exit code 1 when there was none for so long"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    add_tf_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Print poses until the count, the time-out or Ctrl-C."""
    with open_heard(args) as heard, contextlib.suppress(KeyboardInterrupt):
        shown = 0
        while args.count is None or shown < args.count:
            due = time.monotonic() + 1.0 / args.rate
            _print(args, heard, _next(args, heard))
            shown += 1
            if shown != args.count:
                heard.listen(due - time.monotonic())
    return 0


def _next(args: argparse.Namespace, heard: Heard) -> Transform:
    """Wait for a transform, saying why there is none; raises `CliError` when the time is over."""
    end = math.inf if args.timeout is None else time.monotonic() + args.timeout
    told = ""
    while True:
        left = max(0.0, end - time.monotonic())
        try:
            return heard.buffer.lookup_transform(args.reference, args.frame, timeout=min(left, _LOOK_SECONDS))
        except TransformError as err:
            why = clean(err).strip()
            if left <= _LOOK_SECONDS or isinstance(err, InvalidArgumentError):
                raise CliError(why) from None
        if why != told:
            print(f"waiting: {why}", file=sys.stderr, flush=True)
            told = why
        heard.look()


def _print(args: argparse.Namespace, heard: Heard, found: Transform) -> None:
    age = (heard.clock.now_ns() - found.stamp) / 1e9 if found.stamp else None
    if args.json:
        print_json(
            {
                "reference": found.frame_id,
                "frame": found.child_frame_id,
                "time_ns": found.stamp,
                "age": age,
                "translation": dict(zip("xyz", found.translation, strict=True)),
                "rotation": dict(zip("xyzw", found.rotation, strict=True)),
            },
            lines=True,
        )
        return
    when = "static" if age is None else f"at {found.stamp / 1e9:.3f} s, {age:.3f} s ago"
    moved = ", ".join(f"{part:.3f}" for part in found.translation)
    turned = ", ".join(f"{part:.4f}" for part in found.rotation)
    angles = ", ".join(f"{math.degrees(part):.2f}" for part in angles_of(found.rotation))
    print(f"{when}\n  x, y, z:          {moved} m", flush=False)
    print(f"  roll, pitch, yaw: {angles} degrees\n  quaternion:       {turned}", flush=True)


def angles_of(rotation: Quaternion) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians: first about x, then y, then z, all axes fixed (REP 103)."""
    x, y, z, w = rotation
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


def _rate(text: str) -> float:
    value = float(text)
    if not 0.0 < value <= 1000.0:
        msg = "a rate is more than 0 and at most 1000"
        raise argparse.ArgumentTypeError(msg)
    return value

"""``midspan tf list`` and ``midspan tf tree``: which frames there are, and how they hang together."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.cli.console import make_console, print_json
from bridge.cli.text import clean, rate
from bridge.cli.tf_feed import Heard, add_tf_arguments, open_heard
from bridge.tf import tree
from bridge.tf.transform import FrameInfo

_DURATION = 1.0


def register(verbs: Any) -> None:
    """Add the parsers of both."""
    listing: argparse.ArgumentParser = verbs.add_parser(
        "list",
        help="all frames",
        description="Lists every frame that is heard of within --duration.",
    )
    listing.add_argument(
        "-v", "--verbose", action="store_true", help="with parents, authorities, rates and newest stamps"
    )
    drawing: argparse.ArgumentParser = verbs.add_parser(
        "tree",
        help="the tree of frames, as text or for Graphviz",
        description="Draws the tree of the frames that are heard of within --duration, with loops and frames that"
        " several programs place under different parents marked.",
        epilog="Example: midspan tf tree --dot | dot -Tpdf > frames.pdf",
    )
    drawing.add_argument("--dot", action="store_true", help="print it for Graphviz")
    for parser in (listing, drawing):
        parser.add_argument(
            "--duration", type=float, default=_DURATION, metavar="SECONDS",
            help=f"how long to listen once a transform came (default {_DURATION:g}); a slow frame needs longer",
        )  # fmt: skip
        parser.add_argument("--json", action="store_true", help="print all that is known of each frame as JSON")
        add_tf_arguments(parser)


def run_list(args: argparse.Namespace) -> int:
    """List the frames."""
    with open_heard(args) as heard:
        frames = _frames(args, heard)
    if args.json:
        print_json([frame_json(info) for info in frames])
    elif args.verbose:
        make_console().print(_table(frames))
    else:
        for name in sorted({info.name for info in frames} | {info.parent for info in frames}):
            print(clean(name))
    return 0


def run_tree(args: argparse.Namespace) -> int:
    """Draw the tree."""
    with open_heard(args) as heard:
        frames = _frames(args, heard)
    if args.json:
        print_json([frame_json(info) for info in frames])
    else:
        drawn = tree.as_dot(frames) if args.dot else tree.as_text(frames)
        print("\n".join(line[: len(line) - len(line.lstrip())] + clean(line.lstrip()) for line in drawn.splitlines()))
    return 0


def frame_json(info: FrameInfo) -> dict[str, Any]:
    """What is known of a frame, for ``--json``."""
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


def _frames(args: argparse.Namespace, heard: Heard) -> list[FrameInfo]:
    heard.wait()
    heard.listen(args.duration)
    return heard.buffer.frames()


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

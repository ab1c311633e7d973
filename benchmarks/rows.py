"""Benchmark results as rows, with Midspan's and a peer's figures, as a table and as JSON.

A row is ``{case, ours, peer, ratio, unit, better}``; ``ratio`` is ours over the peer's (infinite if the peer's is 0),
``better`` is "less" or "more".
"""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, slots=True)
class Row:
    """One comparison, both values in ``unit``."""

    case: str
    ours: float
    peer: float
    unit: str
    better: Literal["less", "more"] = "less"

    @property
    def ratio(self) -> float:
        """Midspan's figure over the peer's."""
        return self.ours / self.peer if self.peer else float("inf")


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--json FILE`` to a benchmark."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to this file as JSON")


def need_peers(*modules: str) -> None:
    """Exit with an error if a compared library is missing, because a table without its rows would mislead."""
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        raise SystemExit(f"missing peers: {', '.join(missing)}; 'make bench-peers' installs them")


def report(rows: Sequence[Row], file: Path | None = None) -> None:
    """Print the rows as a table, and write them to ``file`` if given."""
    width = max((len(row.case) for row in rows), default=4)
    print(f"{'case':<{width}}  {'ours':>12}  {'peer':>12}  {'ratio':>7}  unit    better")
    for row in rows:
        numbers = f"{row.ours:>12.3f}  {row.peer:>12.3f}  {row.ratio:>7.3f}"
        print(f"{row.case:<{width}}  {numbers}  {row.unit:<6}  {row.better}")
    if file is not None:
        listed = [{**asdict(row), "ratio": row.ratio} for row in rows]
        file.write_text(json.dumps(listed, indent=2) + "\n", encoding="utf-8")

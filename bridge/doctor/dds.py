"""The ROS 2 network as a process of its own sees it: rclpy is loaded there, never here."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass

from bridge.adapters.ros2.environment import available
from bridge.adapters.ros2.mark import is_marked
from bridge.config.model import Config
from bridge.daemon.workers import worker_kinds

_SECONDS = 12.0


class LookError(Exception):
    """The ROS 2 network could not be looked at."""


@dataclass(frozen=True, slots=True)
class DdsView:
    """Who is on the ROS 2 network.

    Attributes:
        midspans: GUID prefixes in hex of participants that Midspans made, without the looker's own.
        nodes: names of nodes that have endpoints.
    """

    midspans: frozenset[str]
    nodes: frozenset[str]


def look(config: Config, environ: Mapping[str, str]) -> DdsView:
    """Join the network for a moment; raises `LookError`."""
    reason = available(config)
    if reason:
        raise LookError(reason)
    env = worker_kinds({})["ros2"].child_environment(config, environ)
    command = [sys.executable, "-m", "bridge.adapters.ros2.look"]
    try:
        done = subprocess.run(
            command, input=config.model_dump_json(by_alias=True), env=env, capture_output=True, text=True,
            timeout=_SECONDS, check=False,
        )  # fmt: skip
        found = json.loads(done.stdout.splitlines()[-1])
        prefixes = {str(prefix) for prefix in found["participants"]}
        return DdsView(
            frozenset(p for p in prefixes if is_marked(bytes.fromhex(p))), frozenset(str(n) for n in found["nodes"])
        )
    except subprocess.TimeoutExpired:
        msg = f"no answer within {_SECONDS:g} s"
        raise LookError(msg) from None
    except (IndexError, KeyError, TypeError, ValueError):
        last = done.stderr.strip().splitlines()[-1:] or ["it printed nothing"]
        raise LookError(last[0]) from None

"""Real genpy and real rclpy, in separate processes, which encode and decode sample messages."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.support.missing import ROS1, ROS2, need, needs

HERE = Path(__file__).parent
SYSTEM_PYTHON = Path("/usr/bin/python3")

needs_genpy = needs(ROS1)


def genpy(items: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the replies of ``genpy_peer.py``."""
    return _batch(SYSTEM_PYTHON, "ros1/genpy_peer.py", items, {"PATH": os.environ["PATH"], "LC_ALL": "C.UTF-8"})


def rclpy(items: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the replies of ``rclpy_peer.py``."""
    need(ROS2)
    return _batch(Path(sys.executable), "ros2/rclpy_peer.py", items, None)


def base64_text(content: bytes) -> str:
    """Return bytes as base64, because JSON has no bytes."""
    return base64.b64encode(content).decode()


def _batch(python: Path, peer: str, items: list[dict[str, Any]], env: dict[str, str] | None) -> list[dict[str, Any]]:
    done = subprocess.run(
        [python, HERE / peer],
        input=json.dumps(items),
        capture_output=True,
        text=True,
        env=env,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    answers: list[dict[str, Any]] = json.loads(done.stdout)
    assert len(answers) == len(items)
    return answers

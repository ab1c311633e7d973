"""Ends routers of killed daemons, which outlive the daemon by design."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import psutil


def end_router(state: Path) -> None:
    """End the router whose lock is in a daemon's state folder, if it runs."""
    for lock in state.glob("*.router.lock"):
        text = lock.read_text()
        with contextlib.suppress(psutil.NoSuchProcess):
            if text:
                psutil.Process(json.loads(text)["pid"]).kill()

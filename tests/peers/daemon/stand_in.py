"""A stand-in for the worker ``modules``, which crashes or never starts, as ordered by the file ``modules.do``."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from bridge.config.model import Config
from bridge.worker import Health, Worker


class Modules(Worker):
    """Starts as ordered: ``crash``, ``hang``, or any other word for a normal start."""

    def start(self, config: Config) -> None:  # noqa: ARG002
        """Follow the order."""
        order = Path(os.environ["FAKE_FOLDER"], "modules.do").read_text(encoding="utf-8")
        if order == "crash":
            os._exit(7)
        if order == "hang":
            threading.Event().wait(600)

    def reload(self, config: Config) -> bool:  # noqa: ARG002
        """Ignore the change."""
        return True

    def health(self) -> Health:
        """Report that the worker is running."""
        return Health("running", "")

    def stop(self) -> None:
        """Do nothing."""

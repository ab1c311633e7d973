"""A stand-in for the worker ``modules``: it crashes, or never comes up, as the file ``modules.do`` orders."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from bridge.config.model import Config
from bridge.worker import Health, Worker


class Modules(Worker):
    """Starts as ordered: ``crash``, ``hang``, or anything else."""

    def start(self, config: Config) -> None:  # noqa: ARG002
        """Follow the order."""
        order = Path(os.environ["FAKE_FOLDER"], "modules.do").read_text(encoding="utf-8")
        if order == "crash":
            os._exit(7)
        if order == "hang":
            threading.Event().wait(600)

    def reload(self, config: Config) -> bool:  # noqa: ARG002
        """Nothing changes."""
        return True

    def health(self) -> Health:
        """All is well."""
        return Health("running", "")

    def stop(self) -> None:
        """Nothing to stop."""

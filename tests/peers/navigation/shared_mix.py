"""A mix that several tests share because they leave its daemon running."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.mix import NAV2, Mix
from tests.peers.navigation.mix_clients import SECONDS
from tests.support.wait import until


class SharedMix:
    """A daemon and a planner for several tests.

    Tests may kill workers, roscore and Nav2's servers. After a failed test, or kills that would influence the next
    test, that test starts a new daemon and planner.

    Args:
        folders: creates the daemon's folder.
        planner: Nav2 or move_base.
        options: those of `Mix`.
    """

    def __init__(self, folders: pytest.TempPathFactory, planner: str = NAV2, **options: Any) -> None:
        self._folders, self._planner, self._options = folders, planner, options
        self._stack = contextlib.ExitStack()
        self._mix: Mix | None = None

    def at_rest(self) -> Mix:
        """Return the mix once all its programs run, and no robot or goal is active."""
        if self._mix is not None and self._mix.worn:
            self.close()
        try:
            return self._at_rest()
        except BaseException:
            self.close()
            raise

    def _at_rest(self) -> Mix:
        if self._mix is None:
            deployment = self._stack.enter_context(Deployment(self._folders.mktemp("shared")))
            self._mix = Mix.over(deployment, self._planner, **self._options)
        mix = self._mix
        mix.repair()
        rest = ("", "idle", "aborted", "goal_reached")
        until(
            lambda: not mix.driving() and mix.state() in rest and not mix.base.moves,
            "no goal is active and the base stands",
            SECONDS,
        )
        return mix

    def close(self) -> None:
        """Stop all programs."""
        self._mix = None
        self._stack.close()

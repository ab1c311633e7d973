"""A mix that several tests share because they leave its daemon and planner running."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.mix import NAV2, Mix
from tests.peers.navigation.mix_clients import SECONDS
from tests.support.wait import until


class SharedMix:
    """A daemon and a planner for tests that leave both running; after a failed test, the next test starts new ones.

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
        """Return the mix once no robot or goal is active."""
        if self._mix is None:
            deployment = self._stack.enter_context(Deployment(self._folders.mktemp("shared")))
            self._mix = Mix.over(deployment, self._planner, **self._options)
        mix = self._mix
        until(
            lambda: not mix.driving() and mix.state() in ("", "idle", "aborted") and not mix.base.moves,
            "no goal is active and the base stands",
            SECONDS,
        )
        return mix

    def close(self) -> None:
        """Stop all programs."""
        self._mix = None
        self._stack.close()

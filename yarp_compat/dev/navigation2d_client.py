"""A client of a robot's navigation, as ``navigation2D_nwc_yarp`` is one, and the Python way.

with Navigation2DClient("/navigationServer", "/mapServer", "/localizationServer") as robot:
    robot.go("kitchen")
    while not robot.status.ended: ...
    robot.gotoTargetByLocationName("kitchen")      # as in C++: true where it succeeded
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import Any, Self

from yarp_compat.dev.client import PATIENCE, ServiceClient
from yarp_compat.dev.ilocalization2d import ILocalization2DMsgs
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, NavigationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.map2d_views import succeeded
from yarp_compat.dev.navigation2d import INavigation2D
from yarp_compat.dev.service import Service
from yarp_compat.naming.naming import Naming
from yarp_compat.pythonic import Server
from yarp_compat.wire.values import Vocab

_PERIOD = 0.1
"""Seconds between two questions for the status."""


class Navigation2DClient(INavigation2D):
    """A client of three servers, between ``with`` and its end; each is connected again where it was away.

    With a name, ``<name>/user_commands/rpc`` answers people: ``gotoLocation NAME``, ``listLocations``, ``help``.

    Args:
        navigation: what the planner's ports begin with.
        maps: what the map server's begin with; empty: there is none, and what would be asked of it fails.
        localization: what the localisation server's begin with; empty: there is none.
        name: what the own ports begin with; empty lets the name server choose names.
        timeout: seconds to wait for a reply; None: for ever.
        naming: who knows the names; by default the name server of ``yarp.conf``.
    """

    def __init__(
        self,
        navigation: str = "/navigation2D_nws_yarp",
        maps: str = "/map2D_nws_yarp",
        localization: str = "/localization2D_nws_yarp",
        name: str = "",
        *,
        timeout: float | None = PATIENCE,
        naming: Naming | None = None,
    ) -> None:
        self._open = ExitStack()
        self._clients: list[ServiceClient[Any]] = []

        def reached(interface: type[Service], server: str, own: str) -> Any:
            if not server:
                return _Nobody()
            mine = name and f"{name}/{own}/rpc"
            client = ServiceClient(interface, f"{server}/rpc", mine, timeout=timeout, naming=naming)
            self._clients.append(client)
            return client.remote

        super().__init__(
            reached(INavigation2DMsgs, navigation, "navigation"),
            reached(IMap2DMsgs, maps, "locations"),
            reached(ILocalization2DMsgs, localization, "localization"),
        )
        self._people = Server(f"{name}/user_commands/rpc", self._respond, naming=naming) if name else None

    def open(self) -> Self:
        """Open the ports and connect them.

        Raises:
            NamingError: there is no name server.
            PortError: one of the servers is not there.
        """
        with ExitStack() as opened:
            for client in self._clients:
                opened.enter_context(client)
            if self._people is not None:
                opened.enter_context(self._people)
            self._open = opened.pop_all()
        return self

    def close(self) -> None:
        """Close the ports."""
        self._open.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- the Python way: errors are exceptions ------------------------------------------------------------------------

    def go(self, place: str | Map2DLocation) -> None:
        """Drive to a location, area or path by its name, or to a pose.

        Raises:
            CallFailed: there is none such, or the planner refuses it.
        """
        go = self.gotoTargetByLocationName if isinstance(place, str) else self.gotoTargetByAbsoluteLocation
        succeeded(go(place))  # type: ignore[arg-type] # each takes its own

    @property
    def status(self) -> NavigationStatusEnum:
        """How it is getting on.

        Raises:
            CallFailed: the planner does not say.
            OSError: it is not there, or does not answer.
        """
        outcome, status = self._navigation.get_navigation_status_RPC()
        succeeded(outcome)
        return status

    def wait(self, timeout: float | None = None) -> NavigationStatusEnum:
        """Wait until the robot has come to the end of what it was told.

        Args:
            timeout: seconds; None: for ever.

        Returns:
            the status then: goal_reached, aborted, failing, error or idle.

        Raises:
            TimeoutError: it is still under way.
            CallFailed: the planner does not say how it is getting on.
            OSError: it is not there, or does not answer.
        """
        end = None if timeout is None else time.monotonic() + timeout
        while not (status := self.status).ended:
            if end is not None and time.monotonic() > end:
                raise TimeoutError(f"after {timeout} s the robot is still under way: {status.name}")
            time.sleep(_PERIOD)
        return status

    def _respond(self, words: list[Any]) -> list[Any]:
        """What upstream's client answers people; other than there, ``gotoLocation`` says where it failed."""
        verb, *rest = [str(word) for word in words] or [""]
        if verb == "gotoLocation":
            return [Vocab("ok" if rest and self.gotoTargetByLocationName(rest[0]) else "fail")]
        if verb == "listLocations":
            names: list[str] = []
            self.getLocationsList(names)
            return [Vocab("many"), *names]
        if verb == "help":
            return [Vocab("many"), "gotoLocation <locationName>", "listLocations"]
        return [Vocab("err")]


class _Nobody:
    """A server that there is not."""

    def __getattr__(self, name: str) -> Any:
        def call(*_: Any) -> Any:
            raise ConnectionRefusedError(f"{name}: no such server was given")

        return call

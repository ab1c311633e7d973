"""The modules' YARP side: clients' calls, and connections to a robot's ports."""

# ruff: noqa: N802, D102 - YARP's names, documented in `yarp_compat.dev.inavigation2d`

from __future__ import annotations

import logging
import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

from bridge.modules.loop import ANSWER_SECONDS, EventLoop
from navigation.pose import Pose
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode
from yarp_compat.dev.service import Service
from yarp_compat.naming import connections
from yarp_compat.ports.naming import Naming
from yarp_compat.wire.errors import WireError

T = TypeVar("T")
M = TypeVar("M", bound=Service)


class Calls:
    """Runs YARP clients' calls on a module's thread; errors of the types ``refusals``, and time-outs, fail the call."""

    def __init__(self, loop: EventLoop, *refusals: type[Exception]) -> None:
        self._loop, self._refusals = loop, refusals

    def do(self, action: Callable[[], T]) -> T:
        """Run an action even if its client has timed out, as is necessary for a stop."""
        return self._done(action, ANSWER_SECONDS, late=True)

    def move(self, action: Callable[[], T], seconds: float = ANSWER_SECONDS) -> T:
        """Run an action that moves the robot, but never after its client has timed out."""
        return self._done(action, seconds, late=False)

    def _done(self, action: Callable[[], T], seconds: float, *, late: bool) -> T:
        try:
            result: T = self._loop.call(action, seconds, late=late)
        except self._refusals as err:
            raise CallFailed(ReturnCode.METHOD_FAILED, str(err)) from None
        except TimeoutError as err:
            raise CallFailed(ReturnCode.NOT_READY, str(err)) from None
        return result


class Commands:
    """The commands of an RPC port, by the first word of a Bottle. Used only on the module's thread.

    ``lines`` are the reply to ``help``. Each handler in ``known`` receives the values after its command, and
    returns the answer or raises `ValueError` with the reason.
    """

    def __init__(self, lines: Sequence[str], known: Mapping[str, Callable[[list[Any]], str]]) -> None:
        self._lines, self._known = lines, known

    def answer(self, values: list[Any]) -> list[Any]:
        """Answer a Bottle; raises `ValueError` with the reason if the command is unknown or fails."""
        command, *arguments = (str(values[0]) if values else "", *values[1:])
        if command in ("help", "[help]"):
            return ["[many]", *self._lines]
        if command not in self._known:
            raise ValueError(f"unknown command '{command}'; 'help' lists all")
        return [self._known[command](arguments)]


class NavigationDevice(ABC):
    """The targets of YARP's ``INavigation2D``, for the modules that serve it. Called on connections' threads."""

    def __init__(self, calls: Calls) -> None:
        self._do, self._move = calls.do, calls.move

    @abstractmethod
    def _robot(self) -> Pose:
        """Return the robot's pose on the map; an error fails the call."""

    @abstractmethod
    def _target(self) -> Map2DLocation | None: ...

    @abstractmethod
    def _go_to(self, pose: Pose) -> None:
        """Drive to a pose on the current map."""

    def gotoTargetByRelativeLocation(self, x: float, y: float, theta: float) -> None:
        def go() -> None:
            goal = self._robot() @ Pose(x, y, 0.0 if math.isnan(theta) else math.radians(theta))
            self._go_to(goal._replace(theta=math.nan) if math.isnan(theta) else goal)

        self._accept(go)

    def _accept(self, action: Callable[[], None]) -> None:
        """Accept a goal, but never after its client has timed out."""
        self._move(action)

    def getAbsoluteLocationOfCurrentTarget(self) -> Map2DLocation | None:
        return self._do(self._target)

    def getRelativeLocationOfCurrentTarget(self) -> tuple[float, float, float] | None:
        def relative() -> tuple[float, float, float] | None:
            target = self._target()
            if target is None:
                return None
            pose = self._robot().inverse @ Pose(target.x, target.y, math.radians(target.theta))
            return pose.x, pose.y, math.degrees(pose.theta)

        return self._do(relative)


def location_of(map_name: str, pose: Pose) -> Map2DLocation:
    """Return a pose on a map as a YARP location."""
    return Map2DLocation(map_name, float(pose.x), float(pose.y), math.degrees(pose.theta))


_AGAIN = 2.0  # seconds between two attempts, and the time-out of each
_END_SECONDS = 0.4  # a module has one second to stop; a connection attempt to an absent machine takes longer

_log = logging.getLogger(__name__)


class PortConnection:
    """Connects a port of the robot to a port of Midspan, and reconnects them if necessary; runs on its own thread."""

    def __init__(self, naming: Naming, source: str, target: str) -> None:
        self._naming, self._source, self._target = naming, source, target
        self.trouble = f"connecting to {source}"
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-connect", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop connecting; an attempt in progress ends by itself."""
        self._end.set()
        self._thread.join(_END_SECONDS)

    def _run(self) -> None:
        begun = time.monotonic()
        while not self._end.is_set():
            try:
                if not connections.carrier_between(self._naming, self._source, self._target, timeout=_AGAIN):
                    connections.connect(self._naming, self._source, self._target, timeout=_AGAIN)
                self.trouble = ""
            except (OSError, WireError) as err:
                if str(err) != self.trouble and time.monotonic() - begun > _AGAIN:
                    _log.info("%s is not connected to %s: %s", self._source, self._target, err)
                self.trouble = str(err) or type(err).__name__
            self._end.wait(_AGAIN)


_PATIENCE = 2.0  # seconds until a call times out
_RETRY = 1.0  # seconds until the next attempt to connect


class PolledServer(ABC, Generic[M]):
    """A YARP server that is polled on its own thread, and reconnected when it returns."""

    def __init__(self, messages: type[M], port: str, naming: Naming, thread: str) -> None:
        self._messages, self._port, self._naming = messages, port, naming
        self._lock = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._poll, name=thread, daemon=True)
        self._thread.start()

    @abstractmethod
    def _follow(self, remote: M) -> None:
        """Poll the server until it stops answering, or until `_closed`; runs on the polling thread."""

    @abstractmethod
    def _on_unreachable(self, reason: str) -> None:
        """Handle an unreachable server or an invalid answer; runs on the polling thread."""

    def close(self) -> None:
        with self._lock:
            self._closed = True
            self._lock.notify()
        self._thread.join(_PATIENCE + 0.5)

    def _poll(self) -> None:
        while not self._closed:
            try:
                with ServiceClient(self._messages, self._port, timeout=_PATIENCE, naming=self._naming) as client:
                    self._follow(client.remote)
            except (OSError, WireError) as err:
                self._on_unreachable(str(err) or type(err).__name__)
            except Exception as err:  # the thread continues after any answer
                _log.exception("%s", self._port)
                self._on_unreachable(f"{type(err).__name__}: {err}")
            with self._lock:
                self._lock.wait_for(lambda: self._closed, _RETRY)

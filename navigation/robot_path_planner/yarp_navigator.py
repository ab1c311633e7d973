"""A local navigator behind a port of YARP: a robotGoto, or any other server of INavigation2D."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.status import Fault, State
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, statusToString
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.naming.naming import Naming
from yarp_compat.wire.errors import WireError

_log = logging.getLogger(__name__)

_POLL = 0.1
_AGAIN = 1.0
_PATIENCE = 2.0
GRACE = 1.0
"""Seconds after a goal was taken for which a server that has not been seen to drive may still tell how the goal before
ended; later its word is believed: a robot that is there already need not move."""
_STATUS = "navigation_status_"
_ENDS = (State.REACHED, State.ABORTED, State.FAILING)


class YarpNavigator:
    """Sends goals to one server, and asks it how they are; see `LocalNavigator`. Safe to use from any thread.

    Speeds and gains of waypoints do not reach it: INavigation2D has no words for them.

    Args:
        server: what its ports begin with, as ``/robotGoto``.
        map_name: says which map the robot is on.
        naming: who knows YARP's names.
    """

    def __init__(self, server: str, map_name: Callable[[], str], naming: Naming) -> None:
        self._port, self._map_name, self._naming = f"{server}/rpc", map_name, naming
        self._lock = threading.Condition()
        self._state, self._reason = State.ERROR, f"{self._port} has not answered yet"
        self._wanted: Map2DLocation | None = None
        self._number = self._sent = 0
        self._taken_at, self._drove, self._denied = -math.inf, False, False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="midspan-yarp-navigator", daemon=True)
        self._thread.start()

    @property
    def state(self) -> State:
        """How the goal that was sent last is getting on."""
        return self._state

    @property
    def reason(self) -> str:
        """Why it is not there."""
        return self._reason

    @property
    def fault(self) -> Fault:
        """INavigation2D has no words for one."""
        return Fault.NONE

    def send(self, pose: Pose, constraints: Constraints) -> None:
        """Drive there, instead of where it was sent before."""
        theta = math.degrees(pose.theta) if constraints.heading else math.nan
        self._want(Map2DLocation(self._map_name(), pose.x, pose.y, theta), State.PREPARING)

    def cancel(self) -> None:
        """Stand still."""
        self._want(None, State.IDLE)

    def brake(self) -> Callable[[], None]:
        """What has it give up the goal at hand, and no later one; see `ActionNavigator.brake`."""
        number = self._number

        def stop() -> None:
            with self._lock:
                if self._number == number:
                    self.cancel()

        return stop

    def close(self) -> None:
        """Ask no more; what drives is left to whoever stops it before."""
        with self._lock:
            self._closed = True
            self._lock.notify()
        self._thread.join(_PATIENCE + 0.5)

    def _want(self, place: Map2DLocation | None, state: State) -> None:
        with self._lock:
            self._wanted = place
            self._number += 1
            if self._state is not State.ERROR:
                self._state, self._reason = state, ""
            self._lock.notify()

    def _run(self) -> None:
        while not self._closed:
            try:
                with ServiceClient(INavigation2DMsgs, self._port, timeout=_PATIENCE, naming=self._naming) as client:
                    while self._step(client.remote):
                        with self._lock:
                            self._lock.wait_for(lambda: self._closed or self._number != self._sent, _POLL)
            except (OSError, WireError) as err:
                self._gone(str(err) or type(err).__name__)
            except Exception as err:  # the thread goes on whatever a server answers
                _log.exception("%s", self._port)
                self._gone(f"{type(err).__name__}: {err}")
            with self._lock:
                self._lock.wait_for(lambda: self._closed, _AGAIN)

    def _step(self, remote: INavigation2DMsgs) -> bool:
        """Send what is wanted, and ask; whether to go on."""
        with self._lock:
            number, place = self._number, self._wanted
            due, closed = number != self._sent, self._closed
        if closed and not due:
            return False
        if due:
            done = remote.goto_target_by_absolute_location_RPC(place) if place else remote.stop_navigation_RPC()
            self._sent, self._taken_at, self._drove, self._denied = number, time.monotonic(), False, not done
            if not done:
                self._refused(number)
                return True
        outcome, status = remote.get_navigation_status_RPC()
        if outcome:
            self._heard(number, State(statusToString(status).removeprefix(_STATUS)))
        else:
            self._gone(f"{self._port} does not say how it is getting on")
        return True

    def _refused(self, number: int) -> None:
        with self._lock:
            if number == self._number:
                self._state, self._reason = State.FAILING, f"{self._port} refused the goal"

    def _heard(self, number: int, state: State) -> None:
        with self._lock:
            if number != self._number:
                return  # of a goal before
            if self._wanted is not None:
                if self._denied:
                    return  # whatever it does, it does not do it for us
                self._drove = self._drove or not state.ended
                if not self._drove and time.monotonic() < self._taken_at + GRACE:
                    state = State.PREPARING
                elif state is State.IDLE and self._state in _ENDS:
                    return  # robotGoto becomes idle some time after it has arrived
            self._state, self._reason = state, ""

    def _gone(self, why: str) -> None:
        with self._lock:
            self._state, self._reason = State.ERROR, why
            self._taken_at, self._denied = -math.inf, False
            # a goal is not sent again by itself: the planner does that once the server is back; a stop is
            if self._wanted is not None:
                self._sent = self._number

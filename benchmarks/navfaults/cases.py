"""The faults, and the expected outcome of each."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.navfaults.outcome import Outcome
from benchmarks.navfaults.two_machines import TwoMachines
from bridge.messages.actions import GoalState
from navigation.status import Fault as Why
from tests.peers.navigation.chain import Chain, SentGoal

Make = Callable[[Chain], AbstractContextManager[object]]


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        key: its name.
        make: causes the fault, and ends it when the context is left.
        lasts: duration, seconds.
        limit: seconds until the wheels should stand; infinite if the robot should continue.
        says: text that the reason in the client's status must contain.
        ends: expected final state of the goal; None: any.
        code: expected error_code of the result; None: any.
        tries: whether the robot may move briefly during the fault, to test whether the fault is over.
        again: whether another goal to the same place is sent after the fault.
        where: creates the deployment.
    """

    key: str
    make: Make
    lasts: float
    limit: float
    says: str = ""
    ends: GoalState | None = GoalState.SUCCEEDED
    code: int | None = None
    tries: bool = False
    again: bool = False
    where: Callable[[Path], Chain] = Chain

    def happen(self, chain: Chain, place: str) -> Outcome:
        """Drive to a place, cause the fault meanwhile, and return the outcome."""
        outcome = Outcome(self.key)
        try:
            self._happen(chain, place, outcome)
        except AssertionError as err:
            outcome.wrong = outcome.wrong or str(err) or "the case was not completed"
        return outcome

    def _happen(self, chain: Chain, place: str, outcome: Outcome) -> None:
        goal = chain.goto(place)
        chain.until_moving()
        chain.until(lambda: _driven(chain, goal) > 0.5, "the robot has driven 0.5 m")
        truth = chain.truth
        assert truth is not None
        x, y, began = truth.x, truth.y, time.monotonic()
        with self.make(chain):
            try:
                outcome.still = _still(chain, max(self.limit + 3.0, self.lasts) if math.isfinite(self.limit) else 3.0)
            except AssertionError as err:
                outcome.wrong = str(err) if math.isfinite(self.limit) else ""
            now = chain.truth
            assert now is not None
            outcome.distance = math.dist((x, y), (now.x, now.y))
            time.sleep(max(0.0, began + self.lasts - time.monotonic()))
            if math.isfinite(self.limit) and not self.tries and not (chain.truth and chain.truth.still):
                outcome.wrong = outcome.wrong or "the robot drove again before the fault was over"
        over = time.monotonic()
        if self.ends is GoalState.SUCCEEDED and math.isfinite(self.limit):
            with contextlib.suppress(AssertionError):
                outcome.onward = chain.until_moving(30.0)
        chain.until(lambda: goal.ended is not None, "the goal ends", 90.0)
        reasons = [reason for _, reason in chain.statuses_since(began) if self.says and self.says in reason]
        outcome.reported = (
            reasons[0] if reasons else " | ".join(dict.fromkeys(w for _, w in chain.statuses_since(began) if w))
        )
        status = goal.status or GoalState.UNKNOWN
        outcome.end = (
            f"{status.name}{f' ({goal.reason})' if goal.reason else ''} after {(goal.ended or over) - over:.1f} s"
        )
        if self.again:
            chain.goto(place)
            outcome.anew = chain.until_moving(30.0)
        if self.ends is not None and status is not self.ends:
            outcome.wrong = outcome.wrong or f"the goal should have ended {self.ends.name}"
        if self.code is not None and goal.code != self.code:
            outcome.wrong = outcome.wrong or f"the goal ended with the code {goal.code}, not {self.code}"
        if self.says and not reasons and self.says not in goal.reason:
            outcome.wrong = outcome.wrong or f"the client did not receive '{self.says}'"


def _driven(chain: Chain, goal: SentGoal) -> float:
    if goal.ended is not None:
        raise AssertionError(f"the goal ended before the fault: {goal.status} {goal.reason}")
    truth = chain.truth
    return truth.speed + 0.4 if truth else 0.0


def _still(chain: Chain, seconds: float) -> float:
    """Return the seconds until the wheels have stopped and stay stopped."""
    began = time.monotonic()
    while True:
        chain.until_still(max(0.1, began + seconds - time.monotonic()))
        since = time.monotonic()
        while chain.truth is not None and chain.truth.still and time.monotonic() < since + 0.5:
            time.sleep(0.01)
        if chain.truth is not None and chain.truth.still:
            return since - began
        if time.monotonic() > began + seconds:
            raise AssertionError(f"the wheels do not stand within {seconds:g} s")


# -- the faults


def _sensor(name: str) -> Make:
    @contextmanager
    def make(chain: Chain) -> Iterator[None]:
        chain.fail(name)
        try:
            yield
        finally:
            chain.mend(name)

    return make


@contextmanager
def _emergency(chain: Chain) -> Iterator[None]:
    chain.client.call("/sim/emergency_stop", "std_srvs/srv/SetBool", data=True)
    yield
    chain.client.call("/sim/emergency_stop", "std_srvs/srv/SetBool", data=False)


def _once(do: Callable[[Chain], Any]) -> Make:
    @contextmanager
    def make(chain: Chain) -> Iterator[None]:
        do(chain)
        yield

    return make


def _killed(worker: str) -> Make:
    return _once(lambda chain: chain.kill(worker))


def _frozen(worker: str) -> Make:
    @contextmanager
    def make(chain: Chain) -> Iterator[None]:
        pid = int(chain.status(worker)["pid"])
        os.kill(pid, signal.SIGSTOP)
        yield
        os.kill(pid, signal.SIGCONT)

    return make


def _without(module: str) -> Make:
    """Return a fault that disables a module by the configuration, and enables it again."""

    @contextmanager
    def make(chain: Chain) -> Iterator[None]:
        _switch(chain, module, on=False)
        yield
        _switch(chain, module, on=True)

    return make


def _switch(chain: Chain, module: str, *, on: bool) -> None:
    chain.config["modules"][module]["enabled"] = on
    chain.write()
    assert chain.daemon is not None
    os.kill(chain.daemon.pid, signal.SIGHUP)


@contextmanager
def _halt(chain: Chain) -> Iterator[None]:
    command = [sys.executable, "-m", "bridge.cli.main", "halt", "--config", str(chain.file)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as halting:
        yield
        halting.wait(30)


def _elsewhere(chain: Chain) -> None:
    chain.teleport(*chain.places["bedroom"])


@contextmanager
def _cut(chain: Chain) -> Iterator[None]:
    assert isinstance(chain, TwoMachines)
    chain.cable.cut()
    yield
    chain.cable.mend()


FAULTS = (
    Fault("laser silent", _sensor("laser_silent"), 4.0, 1.5, "laser"),
    Fault("laser blind", _sensor("laser_blind"), 4.0, 1.5, "laser"),
    Fault("laser silent for good", _sensor("laser_silent"), 14.0, 1.5, "laser", GoalState.ABORTED, Why.NO_LASER),
    Fault("odometry silent", _sensor("encoders_silent"), 4.0, 1.5, "odom"),
    Fault("odometry frozen", _sensor("encoders_frozen"), 6.0, 3.0, "does not follow", tries=True),
    Fault("localizer switched off", _without("localization_server"), 5.0, 3.5, "stale"),
    Fault("robot_goto switched off", _without("robot_goto"), 3.0, 1.5, "robot_goto"),
    Fault("planner switched off", _without("robot_path_planner"), 3.0, 1.5, "stopped", ends=GoalState.ABORTED),
    Fault("base_control switched off", _without("base_control"), 4.0, 1.5),
    Fault("emergency stop", _emergency, 4.0, 1.5, "does not follow"),
    Fault(
        "emergency stop for good",
        _emergency,
        14.0,
        1.5,
        "does not follow",
        GoalState.ABORTED,
        Why.BASE_STANDS,
        tries=True,
    ),
    Fault("modules killed", _killed("robot_path_planner"), 3.0, 1.5, ends=GoalState.ABORTED),
    Fault("modules stand still", _frozen("robot_path_planner"), 3.0, 1.5, ends=None),
    Fault("yarp worker killed", _killed("yarp"), 2.0, math.inf),
    Fault("router killed", _killed("router"), 2.0, math.inf),
    Fault("halt", _halt, 4.0, 2.5, ends=GoalState.CANCELED),
    Fault("localization lost", _once(_elsewhere), 8.0, 3.0, "localization status is", tries=True),
    Fault("simulator killed", _killed("sim"), 5.0, math.inf, ends=None),
    Fault("link to the client cut", _cut, 8.0, 6.0, "left", ends=GoalState.ABORTED, again=True, where=TwoMachines),
    Fault("link to the planner cut", _cut, 6.0, 6.0, "is silent", where=partial(TwoMachines, split=True)),
)

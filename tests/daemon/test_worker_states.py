"""Every transition of a worker's process: in the table, and as caused by the daemon and the process."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.daemon import protocol
from bridge.daemon.worker_channel import Exit
from bridge.daemon.worker_launcher import Launch
from bridge.daemon.worker_process import WorkerProcess
from bridge.daemon.worker_run import Timing
from bridge.daemon.worker_states import IDLE, TRANSITIONS, WORKER, Phase, WorkerEvent, WorkerState
from bridge.progress import Busy
from bridge.worker import Health
from tests.support.wait import until
from yarp_compat.selector_loop import SelectorLoop

PAIRS = [(state, event) for state in Phase for event in WorkerEvent]
POSSIBLE = [(state, event) for state, event in PAIRS if event in WORKER[state]]
IMPOSSIBLE = [(state, event) for state, event in PAIRS if event not in WORKER[state]]


def name_of(value: Any) -> str:
    return value.name.lower()


def in_state(phase: Phase) -> WorkerState:
    state = WorkerState()
    state.state, state.text = phase, "before"
    return state


@pytest.mark.parametrize(("phase", "event"), POSSIBLE, ids=name_of)
def test_each_transition_leads_to_the_state_of_the_table(phase: Phase, event: WorkerEvent) -> None:
    state = in_state(phase)
    since = state.since
    assert state.enter(event, "after")
    assert state.state is TRANSITIONS[event][1]
    assert state.text == "after"
    assert (state.since == since) == (state.state is phase)


@pytest.mark.parametrize(("phase", "event"), IMPOSSIBLE, ids=name_of)
def test_an_event_without_a_transition_changes_neither_state_nor_text(phase: Phase, event: WorkerEvent) -> None:
    state = in_state(phase)
    since = state.since
    assert not state.accepts(event)
    assert not state.enter(event, "after")
    assert (state.state, state.text, state.since) == (phase, "before", since)


def test_each_state_is_reached() -> None:
    reached, pending = {Phase.OFF}, [Phase.OFF]
    while pending:
        following = set(WORKER[pending.pop()].values()) - reached
        reached |= following
        pending.extend(following)
    assert reached == set(Phase)


class _Channel:
    """A stand-in for the channel to a process; it only records commands and kills."""

    pid, owner, started_here, needs_polls = 7, "daemon", True, False

    def __init__(self) -> None:
        self.sent: list[protocol.Command] = []
        self.killed = 0

    def send(self, command: protocol.Command) -> None:
        self.sent.append(command)

    def stop(self) -> None:
        self.send(protocol.Stop())

    def kill(self) -> None:
        self.killed += 1

    def poll(self) -> None:
        pass

    def detach(self) -> None:
        pass


class _Kind:
    """A kind of worker that can be disabled, or lack a requirement."""

    name, outlives = "ros1", False

    def __init__(self) -> None:
        self.on, self.lacks = "auto", ""

    def enabled(self, _config: Config) -> Any:
        return self.on

    def missing(self, _config: Config) -> str:
        return self.lacks

    def config_part(self, config: Config) -> Any:
        return config.name


class _Launcher:
    """Starts no processes: each attempt has the given result."""

    standing = False

    def __init__(self) -> None:
        self.channel = _Channel()
        self.result = Launch(WorkerEvent.START, channel=self.channel)  # type: ignore[arg-type]

    def launch(self, _config: Config) -> Launch:
        return self.result

    def changes_environment(self, _config: Config) -> bool:
        return False


class _IsolatedWorker:
    """A worker without a process, and the objects that it depends on."""

    def __init__(self, timing: Timing | None = None) -> None:
        self.loop, self.kind, self.launcher = SelectorLoop(), _Kind(), _Launcher()
        self.worker = WorkerProcess(self.loop, self.kind, timing or Timing())  # type: ignore[arg-type]
        self.worker._launcher = self.launcher  # type: ignore[assignment]
        self.pause = 60.0

    def configure(self, name: str = "first") -> None:
        self.worker.configure(Config(name=name))

    def bring_to(self, phase: Phase) -> None:
        """Bring the worker to a state by events that happen on a machine."""
        if phase is Phase.OFF:
            return
        if phase in IDLE:
            event = next(event for event, (states, to) in TRANSITIONS.items() if to is phase and Phase.OFF in states)
            self.cause(event)
        else:
            self.configure()
        if phase is Phase.UP:
            self.cause(WorkerEvent.HEARTBEAT)
        if phase is Phase.STOPPING:
            self.worker.stop("requested")
        assert self.worker.phase is phase

    def cause(self, event: WorkerEvent) -> None:
        """Cause an event through the configuration, the machine or the process."""
        worker = self.worker
        self.kind.on, self.kind.lacks = "auto", ""
        match event:
            case WorkerEvent.DISABLE:
                self.kind.on = False
                self.configure("other")
            case WorkerEvent.MISS:
                self.kind.lacks = "no rclpy"
                self.configure("other")
            case WorkerEvent.CANNOT_WORK if worker.channel is not None:
                worker.on_report(protocol.Failed("no master"))
                worker.on_exit(Exit(protocol.EXIT_CANNOT_WORK))
            case WorkerEvent.QUEUE | WorkerEvent.BLOCK | WorkerEvent.CANNOT_WORK:
                self.launcher.result = Launch(event, "a reason", self.pause)
                self.configure("other")
            case WorkerEvent.START:
                self.launcher.result = Launch(event, channel=self.launcher.channel)  # type: ignore[arg-type]
                self.configure("other")
            case WorkerEvent.HEARTBEAT:
                worker.on_report(protocol.Beat(1, Health("running", "2 routes")))
            case WorkerEvent.STOP:
                worker.stop("requested")
            case WorkerEvent.EXIT | WorkerEvent.CRASH:
                worker.on_exit(Exit(1))
            case WorkerEvent.RELEASE:
                worker.release()


@pytest.fixture
def isolated() -> Iterator[_IsolatedWorker]:
    isolated = _IsolatedWorker()
    yield isolated
    isolated.loop.close()


@pytest.mark.parametrize(("phase", "event"), POSSIBLE, ids=name_of)
def test_a_worker_makes_each_transition(isolated: _IsolatedWorker, phase: Phase, event: WorkerEvent) -> None:
    isolated.bring_to(phase)
    assert (isolated.worker.phase in IDLE) == isolated.worker.idle
    if event is WorkerEvent.EXIT:
        isolated.kind.on = False
    isolated.cause(event)
    assert isolated.worker.phase is TRANSITIONS[event][1]
    assert (isolated.worker.phase in IDLE) == isolated.worker.idle


def test_reports_of_a_stopping_worker_do_not_change_its_state(isolated: _IsolatedWorker) -> None:
    isolated.bring_to(Phase.STOPPING)
    for report in (protocol.Beat(2, Health("running", "2 routes")), Busy("unregistering", 0.1, 0)):
        isolated.worker.on_report(report)
        assert (isolated.worker.phase, isolated.worker.text) == (Phase.STOPPING, "requested")


def test_a_second_stop_request_keeps_the_state_and_its_reason(isolated: _IsolatedWorker) -> None:
    isolated.bring_to(Phase.STOPPING)
    isolated.worker.stop("once more")
    assert (isolated.worker.phase, isolated.worker.text) == (Phase.STOPPING, "requested")
    assert len(isolated.launcher.channel.sent) == 1


def test_a_disabled_worker_stays_off_even_if_it_asks_for_a_restart_before_it_exits(isolated: _IsolatedWorker) -> None:
    isolated.bring_to(Phase.UP)
    isolated.cause(WorkerEvent.DISABLE)
    assert isolated.worker.phase is Phase.STOPPING
    isolated.worker.on_report(protocol.Restart("the new configuration needs a restart"))
    isolated.worker.on_exit(Exit(0))
    assert isolated.worker.phase is Phase.OFF


def test_a_worker_that_is_enabled_again_while_it_stops_starts_after_its_exit(isolated: _IsolatedWorker) -> None:
    isolated.bring_to(Phase.UP)
    isolated.cause(WorkerEvent.DISABLE)
    isolated.cause(WorkerEvent.START)
    assert isolated.worker.phase is Phase.STOPPING
    isolated.worker.on_exit(Exit(0))
    assert isolated.worker.phase is Phase.STARTING


@pytest.mark.parametrize("event", [WorkerEvent.BLOCK, WorkerEvent.CANNOT_WORK, WorkerEvent.CRASH], ids=name_of)
def test_a_timer_starts_a_worker_again(event: WorkerEvent) -> None:
    isolated = _IsolatedWorker(Timing(retry=0.0))
    isolated.pause = 0.0
    isolated.bring_to(Phase.UP if event is WorkerEvent.CRASH else Phase.OFF)
    isolated.cause(event)
    isolated.launcher.result = Launch(WorkerEvent.START, channel=isolated.launcher.channel)  # type: ignore[arg-type]
    until(lambda: isolated.loop.step(1.0) or isolated.worker.phase is Phase.STARTING, "the worker starts again")
    isolated.loop.close()


def test_a_timer_kills_a_worker_that_does_not_stop(caplog: pytest.LogCaptureFixture) -> None:
    isolated = _IsolatedWorker(Timing(stop=0.0))
    isolated.bring_to(Phase.STOPPING)
    until(lambda: isolated.loop.step(1.0) or isolated.launcher.channel.killed, "the process is killed")
    assert "ros1 did not stop in time; killing process 7" in caplog.text
    isolated.loop.close()


def test_the_timer_of_an_earlier_state_has_no_effect() -> None:
    isolated = _IsolatedWorker(Timing(stop=0.0))
    isolated.bring_to(Phase.STOPPING)
    isolated.worker.on_exit(Exit(0))
    isolated.configure("other")
    isolated.loop.step(0.0)
    isolated.loop.step(0.0)
    assert isolated.worker.phase is Phase.STARTING
    assert isolated.launcher.channel.killed == 0
    isolated.loop.close()

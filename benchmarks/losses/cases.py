"""The losses: what fails, how it is restored, and the moment from which all messages could flow again."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from benchmarks.losses.field import ANCHORS, EXTRAS, JOINER, WORKERS, Field
from benchmarks.losses.outcome import Outcome, Watch
from benchmarks.losses.traces import left_behind

PAUSE = 0.3
"""Seconds after the loss at which the programs publish new latched lines."""
AWAY = 1.0
"""Seconds until a killed roscore is restarted."""
FORGET_SECONDS = 30.0
"""Seconds within which a dead participant is removed; Fast DDS needs 20 s, unless the participant's profile differs."""

LOST_PORT = "removed this participant's shared memory"
"""Why the ros2 worker rarely restarts after a short stop; see `bridge.adapters.ros2.graph.ports`."""


@dataclass(frozen=True, slots=True)
class Loss:
    """One kind of loss.

    Attributes:
        key: short name.
        name: name for display.
        limit: seconds allowed for the recovery, by the project's limit or the parts' times to detect a loss.
        happen: causes the loss and its repair, and returns the outcome.
    """

    key: str
    name: str
    limit: float
    happen: Callable[[Field], Outcome]


def roscore(field: Field, *, simulated: bool = False) -> Outcome:
    """Restart roscore, and the ROS 1 programs, which never register again by themselves."""
    if simulated and not field.clock:
        field.master("setParam", "/use_sim_time", True)
        field.command("ros1", "clock", "ticking", start=1000.0)
        field.clock = True
    field.master("setParam", "/robot/name", "r1")
    watch = _settled(field)
    field.kill("roscore")
    _speak(field, "ros2", "hub")
    time.sleep(AWAY)
    field.kill("ros1", JOINER)
    field.start_master()
    field.master("setParam", "/robot/name", "r2")
    if field.clock:
        field.master("setParam", "/use_sim_time", True)
    field.start_programs("ros1", JOINER)
    if field.clock:  # a restarted simulation begins at zero, so time goes back
        field.command("ros1", "clock", "ticking", start=0.0)
    outcome = watch.until_steady(time.monotonic())
    watch.check_state(outcome)
    outcome.left += left_behind(field)
    if field.clock and field.master("getParam", "/use_sim_time") is not True:
        outcome.left.append("/use_sim_time has changed")
    if field.master("getParam", "/robot/name") != "r2":
        outcome.left.append("/robot/name has changed")
    return outcome


def simulated_roscore(field: Field) -> Outcome:
    """Restart roscore with ``/use_sim_time`` and a clock that restarts."""
    outcome = roscore(field, simulated=True)
    since = time.monotonic()
    for listener in ("ros2", "hub"):
        last = _time_at(field, listener, since)
        if last >= 1000.0:
            outcome.left.append(f"{listener} receives the old time {last:g}")
    field.command("ros1", "clock", "ticking", start=1000.0)
    return outcome


def _time_at(field: Field, listener: str, since: float) -> float:
    """Return the newest simulated time that a program has received since a moment, once there is one."""
    flow, times = (listener, "/clock"), list[float]()

    def received() -> bool:
        times[:] = [sent for _, sent, _ in field.sounds(since).get(flow, ())]
        return bool(times)

    field.until(received, f"{listener} receives /clock")
    return times[-1]


def program(field: Field, side: str, *, forget: bool = True) -> Outcome:
    """Kill and restart a side's program; at the end stop it or, with ``forget``, kill it and await its removal."""
    name = EXTRAS[side]
    field.start_programs(name)
    watch = _settled(field)
    if side == "ros2" and not forget:
        field.lingering[field.states[name]] = time.monotonic() + FORGET_SECONDS
    field.kill(name)
    _speak(field, *ANCHORS)
    field.start_programs(name)
    outcome = watch.until_steady(time.monotonic())
    if not forget:
        field.stop(name)
        return outcome
    field.kill(name)
    watch.check_state(outcome, FORGET_SECONDS)
    return outcome


def worker_killed(field: Field, worker: str) -> Outcome:
    """Send SIGKILL to a worker, which the daemon restarts."""
    field.until_old(worker)
    watch = _settled(field)
    process = field.worker(worker)
    process.kill()
    begun = time.monotonic()
    _speak(field, *ANCHORS)
    return _after(field, watch, begun, replaced=(worker, process.pid))


def worker_stopped(field: Field, *workers: str, seconds: float) -> Outcome:
    """Send SIGSTOP to workers for a time; if it is short they continue, if it is long they are replaced."""
    for worker in workers:
        field.until_old(worker)
    watch = _settled(field)
    processes = [(worker, field.worker(worker)) for worker in workers]
    begun = time.monotonic()
    for _, process in processes:
        process.send_signal(signal.SIGSTOP)
    _speak(field, *ANCHORS)
    if seconds > 5.0:  # the heartbeat's limit
        old = [(w, p.pid) for w, p in processes]
        field.until(
            lambda: all(_replaced(field, *worker_and_pid) for worker_and_pid in old),
            "the stopped workers are replaced",
            20,
        )
        return _after(field, watch, begun)
    time.sleep(max(0.0, begun + seconds - time.monotonic()))
    for _, process in processes:
        process.send_signal(signal.SIGCONT)
    outcome = _after(field, watch, time.monotonic())
    if LOST_PORT not in field.words():
        outcome.left += [f"{w} was replaced" for w, p in processes if field.worker(w).pid != p.pid]
    return outcome


def daemon(field: Field, *workers: str) -> Outcome:
    """Send SIGKILL to the daemon and to workers, and restart the daemon at once."""
    watch = _settled(field)
    processes = [field.worker(name) for name in workers]
    for process in processes:
        process.kill()
    field.kill_daemon()
    field.start_daemon()
    begun = time.monotonic()
    _speak(field, *ANCHORS)
    return _after(field, watch, begun)


def _settled(field: Field) -> Watch:
    """Start watching once all messages flow."""
    first = Watch(field).until_steady(time.monotonic())
    if not first.recovered:
        msg = f"not all messages flow before the loss: {first}\n{field.words()}"
        raise RuntimeError(msg)
    return Watch(field)


def _speak(field: Field, *programs: str) -> None:
    """Let programs publish new latched lines shortly after the loss."""
    time.sleep(PAUSE)
    field.say_state(*programs)


def _after(field: Field, watch: Watch, returned: float, replaced: tuple[str, int] | None = None) -> Outcome:
    if replaced is not None:
        field.until(lambda: _replaced(field, *replaced), f"{replaced[0]} is restarted")
    outcome = watch.until_steady(returned)
    watch.check_state(outcome)
    outcome.left += left_behind(field)
    return outcome


def _replaced(field: Field, worker: str, pid: int) -> bool:
    report = next((w for w in field.document().workers if w.worker == worker), None)
    return report is not None and report.pid not in (0, pid)


def _of_workers(what: str, limit: float, happen: Callable[[Field, str], Outcome]) -> list[Loss]:
    key = what.replace("for ", "").replace(" s", "").replace(" ", "-")
    return [Loss(f"{w}-{key}", f"the {w} worker {what}", limit, partial(_swapped, happen, w)) for w in WORKERS]


def _swapped(happen: Callable[[Field, str], Outcome], worker: str, field: Field) -> Outcome:
    return happen(field, worker)


LOSSES = (
    Loss("roscore", "roscore killed and started, with parameters", 3.0, roscore),
    Loss("ros1-node", "a ROS 1 node killed and started", 3.0, lambda field: program(field, "ros1")),
    Loss("ros2-node", "a DDS participant killed and started", 3.0, lambda field: program(field, "ros2")),
    *_of_workers("killed", 3.0, worker_killed),
    *_of_workers("stopped for 2 s", 3.0, lambda field, worker: worker_stopped(field, worker, seconds=2.0)),
    Loss("daemon", "the daemon killed and started", 3.0, daemon),
    *_of_workers("stopped for 10 s", 8.0, lambda field, worker: worker_stopped(field, worker, seconds=10.0)),
    Loss("everything", "the daemon and all workers killed and started", 4.0, lambda field: daemon(field, *WORKERS)),
    Loss("simulated", "roscore killed and started, with simulated time", 3.0, simulated_roscore),
)

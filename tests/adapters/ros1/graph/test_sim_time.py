"""A real master's `/use_sim_time`: what Midspan has set is taken back, and what others have set stays."""

from __future__ import annotations

import contextlib
import signal
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

import pytest

from bridge.adapters.ros1.edge import Ros1Edge
from bridge.adapters.ros1.graph import master as master_module
from bridge.adapters.ros1.graph.presence import NodeEntry
from bridge.adapters.ros1.graph.sim_time import SET_BY, SIM_TIME, SimTime
from bridge.adapters.ros1.graph.state import NAMESPACE, PRESENCE
from bridge.adapters.ros1.master import saved
from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from bridge.config.model import Config
from bridge.config.sections.clock import ClockSection
from bridge.config.sections.ros import Ros1Section
from tests.peers.listener import Listener
from tests.peers.ros1.adapter import EdgeUnderTest, edge_on
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.peers.ros1.parameters import REGISTRY
from tests.support.ports import free_port
from tests.support.wait import until

pytestmark = needs_ros1

CURE = "clock.source to sim"


@pytest.fixture(autouse=True)
def clean(master: RosMaster) -> Iterator[None]:
    """Remove what a test has left on the master."""
    yield
    for name in (SIM_TIME, SET_BY):
        master.call("deleteParam", name)


def simulated(master: RosMaster, state: Path, daemon: str = "robot") -> EdgeUnderTest:
    return edge_on(master, state, daemon, clock="sim")


def sim_time(master: RosMaster) -> Any:
    return master.call("getParam", SIM_TIME)


@pytest.mark.parametrize("before", [None, False])
def test_a_stop_restores_the_former_value(master: RosMaster, tmp_path: Path, before: Any) -> None:
    if before is not None:
        master.call("setParam", SIM_TIME, before)
    with simulated(master, tmp_path) as edge:
        assert sim_time(master) is True
        edge.leave()
        assert sim_time(master) is before
        assert master.call("getParam", SET_BY) is None


def test_a_value_that_was_set_before_stays(master: RosMaster, tmp_path: Path) -> None:
    master.call("setParam", SIM_TIME, True)
    with simulated(master, tmp_path) as edge:
        edge.leave()
        assert sim_time(master) is True


@pytest.mark.parametrize("value", [True, False])
def test_a_value_that_a_program_sets_meanwhile_stays(master: RosMaster, tmp_path: Path, value: bool) -> None:
    """A launch file of a simulation sets the same value."""
    with simulated(master, tmp_path) as edge:
        master.call("setParam", SIM_TIME, value)
        until(lambda: master.call("getParam", SET_BY) is None, "the value is no longer Midspan's")
        edge.leave()
        assert sim_time(master) is value


def test_the_last_of_several_nodes_takes_it_back(master: RosMaster, tmp_path: Path) -> None:
    with simulated(master, tmp_path / "one") as one, simulated(master, tmp_path / "two", "other") as two:
        one.leave()
        assert sim_time(master) is True
        two.leave()
        assert sim_time(master) is None


def test_a_stop_waits_for_other_hosts_only_after_the_node_has_stopped(master: RosMaster, tmp_path: Path) -> None:
    """A worker has few seconds to stop; other hosts may be off, and each is asked for two seconds."""
    with contextlib.closing(socket.create_server(("127.0.0.1", 0), backlog=100)) as silent:
        silent.settimeout(40)
        port = silent.getsockname()[1]
        uris = [f"http://127.0.0.1:{port}/{number}" for number in range(10)]
        entries = [NodeEntry(uri, "silent", f"/{uri[-1]}", uri, 1, 1, simulated=True) for uri in uris]
        with simulated(master, tmp_path) as edge, ThreadPoolExecutor() as threads:
            (uri,) = (entry["uri"] for entry in master.call("getParam", PRESENCE).values())
            for entry in entries:
                master.call("setParam", entry.parameter, entry.as_dict())
            leaving = threads.submit(edge.leave)
            with contextlib.ExitStack() as stack:
                for _ in entries:
                    connection = stack.enter_context(silent.accept()[0])
                    assert connection.recv(4096).startswith(b"POST")
                assert is_refused(uri), "the node has stopped by now"
                assert leaving.result() < 2.0 * len(entries), "they are asked at the same time"
        assert sim_time(master) is None, "a node that does not respond counts as dead"
        master.call("deleteParam", PRESENCE)


def is_refused(uri: str) -> bool:
    """Return whether no program listens at the address of a node."""
    address = urlsplit(uri)
    try:
        socket.create_connection((address.hostname, address.port)).close()
    except ConnectionRefusedError:
        return True
    return False


@pytest.mark.parametrize("before", [None, False])
def test_nodes_that_join_and_leave_at_the_same_time(
    master: RosMaster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: Any
) -> None:
    """Both read that the parameter is not set before either sets it; each is then notified of the other's value."""
    if before is not None:
        master.call("setParam", SIM_TIME, before)
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    for limit in ("_TIMEOUT", "_STOP_TIMEOUT"):  # a master on a busy machine may respond late
        monkeypatch.setattr(master_module, limit, 40.0)
    at_once, followed = threading.Barrier(2, timeout=40), set[SimTime]()
    set_value, follow, release = SimTime._set, SimTime._follow, SimTime.release

    def set_together(node: SimTime, value: Any) -> None:
        at_once.wait()
        set_value(node, value)

    def recorded_follow(node: SimTime, *args: Any) -> None:
        follow(node, *args)
        followed.add(node)

    def release_together(node: SimTime, client: Any) -> None:
        at_once.wait()
        release(node, client)

    monkeypatch.setattr(SimTime, "_set", set_together)
    monkeypatch.setattr(SimTime, "_follow", recorded_follow)
    monkeypatch.setattr(SimTime, "release", release_together)
    edges = []
    for name in ("one", "two"):
        config = Config(name=name, clock=ClockSection(source="sim"), ros1=Ros1Section(master=master.uri, poll=0.1))
        edges.append(Ros1Edge(config, REGISTRY, tmp_path / name))
    for edge in edges:
        edge.start(Listener())
    until(lambda: len(followed) == 2, "each node has handled the other's value")
    assert sim_time(master) is True
    assert master.call("getParam", SET_BY)["before"] == ([] if before is None else [before])
    with ThreadPoolExecutor(2) as threads:
        list(threads.map(Ros1Edge.stop, edges))
    assert sim_time(master) is before
    assert master.call("getParam", NAMESPACE) is None


def test_a_node_that_joins_while_another_one_takes_it_back_sets_it_again(master: RosMaster, tmp_path: Path) -> None:
    with simulated(master, tmp_path):
        master.call("deleteParam", SET_BY)
        master.call("deleteParam", SIM_TIME)
        until(lambda: sim_time(master) is True, "it is set again")
        assert master.call("getParam", SET_BY)["before"] == []


@pytest.mark.parametrize("clock", ["system", "sim"])
def test_the_successor_of_a_killed_process_takes_it_back(master: RosMaster, tmp_path: Path, clock: str) -> None:
    with simulated(master, tmp_path) as edge:
        edge.signal(signal.SIGKILL)
    assert sim_time(master) is True
    with edge_on(master, tmp_path / "bystander", "other"):
        assert sim_time(master) is True, "the killed process may start again"
    with edge_on(master, tmp_path, clock=clock) as edge:
        assert sim_time(master) is (True if clock == "sim" else None)
        assert not [w for w in edge.ask("status")["warnings"] if CURE in w]
        edge.leave()
        assert sim_time(master) is None


def test_a_node_on_the_system_clock_follows_the_parameter(master: RosMaster, tmp_path: Path) -> None:
    with edge_on(master, tmp_path) as edge:

        def warns() -> bool:
            return any(CURE in warning for warning in edge.ask("status")["warnings"])

        assert not warns()
        assert sim_time(master) is None
        master.call("setParam", SIM_TIME, True)
        until(warns, "the warning appears")
        master.call("setParam", SIM_TIME, False)
        until(lambda: not warns(), "the warning's cure ends it")


def test_new_programs_run_on_the_system_clock_after_a_simulated_run(master: RosMaster, tmp_path: Path) -> None:
    """A rospy node on `/clock` would sleep forever, because nothing publishes the time any longer."""
    with simulated(master, tmp_path) as edge:
        edge.leave()
    with master.peer("late") as peer:
        assert peer.ask("now")["seconds"] > 0


class RestartingMaster:
    """Midspan's master, which has the same process id and run id after each restart, as in a container.

    Attributes:
        reads: how often `SET_BY` was read since the last start.
    """

    def __init__(self, state: Path) -> None:
        self._state, self._port = state / "master.json", free_port()
        self.start()
        self._run_id = self.get("/run_id")

    def start(self) -> None:
        self._master = EmbeddedMaster("127.0.0.1", self._port, state=self._state, rosout=False)
        self.uri, self.reads = self._master.uri, 0
        get = self._master.api.methods["getParam"]

        def get_param(caller: str, key: str) -> Any:
            self.reads += key == SET_BY
            return get(caller, key)

        self._master.api.methods["getParam"] = get_param
        if not self._state.exists():
            self._master.api.set_param("/roslaunch", "/run_id", getattr(self, "_run_id", "1"))
        self._master.start()

    def restart(self, *, forget: bool) -> None:
        self.close()
        thread = self._master._server._loop._thread
        until(lambda: not thread.is_alive(), "the port is free")
        if forget:
            self._state.unlink()
        self.start()

    def get(self, name: str) -> Any:
        code, _, value = self._master.api.get_param("/test", name)
        return value if code == 1 else None

    def close(self) -> None:
        self._master.close()


@pytest.fixture
def restarting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RestartingMaster]:
    monkeypatch.setattr(saved, "_JOIN_SECONDS", 40.0)  # each state is written before the next start
    with contextlib.closing(RestartingMaster(tmp_path)) as master:
        yield master


@pytest.mark.parametrize("before", [None, False])
def test_a_restart_of_midspans_master_is_not_taken_for_a_programs_value(
    restarting: RestartingMaster, tmp_path: Path, before: Any
) -> None:
    """The master repeats all parameters to their subscribers, since it may have been killed before it sent them."""
    if before is not None:
        restarting._master.api.set_param("/test", SIM_TIME, before)
    with edge_on(cast("Any", restarting), tmp_path, clock="sim", poll=2.0) as edge:
        until(lambda: restarting.get(SIM_TIME) is True, "the value is set")
        restarting.restart(forget=False)
        until(lambda: restarting.reads > 0, "the node has read the repeated value")
        edge.leave()
        assert restarting.get(SIM_TIME) is before
        assert restarting.get(SET_BY) is None


def test_a_master_that_has_lost_its_parameters_gets_the_value_again(
    restarting: RestartingMaster, tmp_path: Path
) -> None:
    """Such a master has neither another run id nor another process id, so it does not seem to have restarted."""
    with edge_on(cast("Any", restarting), tmp_path, clock="sim", poll=1.0) as edge:
        until(lambda: restarting.get(SIM_TIME) is True, "the value is set")
        restarting.restart(forget=True)
        until(lambda: restarting.get(SIM_TIME) is True, "the value is set again")
        restarting._master.api.delete_param("/test", SET_BY)
        restarting._master.api.delete_param("/test", SIM_TIME)
        until(lambda: restarting.get(SIM_TIME) is True, "the node has subscribed again")
        edge.leave()
        assert restarting.get(SIM_TIME) is None

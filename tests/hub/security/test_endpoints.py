"""The states of the `hub.open` endpoints, with real routers over TLS, and their logs and test rates."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pytest

from bridge.config.model import Config
from bridge.hub.router import RouterWorker
from bridge.hub.security import certificates, endpoints
from bridge.hub.security.certificates import Authority
from bridge.hub.security.handshake import Attempt
from bridge.hub.security.reasons import EndpointState, Reason
from bridge.hub.security.zenoh_log import ZenohLog
from tests.support.ports import free_port
from tests.support.wait import until


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    for fleet in ("a", "b"):
        authority = Authority(folder / fleet)
        authority.make()
        for name in ("robot1", "operator1"):
            authority.issue(name, ["127.0.0.1"])
    return folder


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the tests of endpoints ten times as frequent as on a robot."""
    monkeypatch.setattr(endpoints, "POLL_SECONDS", 0.1)
    monkeypatch.setattr(endpoints, "FIRST_SECONDS", 0.5)
    monkeypatch.setattr(endpoints, "TEST_SECONDS", 1.0)
    monkeypatch.setattr("bridge.hub.router._ANSWER_SECONDS", 40.0)  # no matter how slow the machine is


class Machine:
    """A router worker with an external router."""

    def __init__(self, name: str, keys: Path, **opened: Any) -> None:
        hub = {"listen": f"tcp/127.0.0.1:{free_port()}", "open": {"keys": str(keys), **opened}}
        self.router = RouterWorker()
        self.config = Config.model_validate({"name": name, "hub": hub})

    def __enter__(self) -> Self:
        self.router.start(self.config)
        return self

    def __exit__(self, *_: object) -> None:
        self.router.stop()

    def statuses(self) -> list[endpoints.EndpointStatus]:
        external = self.router._external.router
        assert external is not None
        return external.endpoints()

    def wait(self, state: EndpointState, number: int = 0) -> endpoints.EndpointStatus:
        return until(
            lambda: (status := self.statuses()[number]).state == state and status, f"{state}: {self.statuses()}"
        )


@pytest.fixture
def port() -> int:
    return free_port()


def test_a_connection_is_reported_on_both_machines(keys: Path, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        Machine("robot1", keys / "a", listen=[f"tls/127.0.0.1:{port}"]) as robot,
        Machine("operator1", keys / "a", connect=[f"tls/127.0.0.1:{port}"]) as operator,
    ):
        status = operator.wait(EndpointState.CONNECTED)
        assert (status.way, status.machine, status.reason) == ("connect", "robot1", "")
        assert abs(status.since - time.time()) < 60
        with monkeypatch.context() as clock:
            clock.setattr(time, "time", lambda now=time.time: now() + 86400)
            assert abs(operator.statuses()[0].since - time.time()) < 60, "the age stays right if the clock is set"
        assert robot.wait(EndpointState.LISTENING).way == "listen"
        assert operator.router.health().text.endswith("; 1 other machines")


def test_a_refused_endpoint_reports_the_foreign_authority_and_recovers(
    keys: Path, port: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "bridge.hub.security")
    place = f"tls/127.0.0.1:{port}"
    robot = Machine("robot1", keys / "a", listen=[place])
    with robot, Machine("operator1", keys / "b", connect=[place]) as operator:
        refused = operator.wait(EndpointState.REFUSED)
        assert "other machine's certificate is from another authority" in refused.reason
        assert refused.machine == "robot1"
        assert "midspan keys" in refused.cure
        health = operator.router.health()
        assert health.state == "running"
        assert f"hub.open.connect {place}: refused: the other" in health.text
        (answer,) = operator_status(operator)
        assert answer["state"] == "refused"
        assert abs(answer["since"] - refused.since) < 1.0
        robot.router.stop()
        operator.wait(EndpointState.NOT_ANSWERING)
        with Machine("robot1", keys / "b", listen=[place]):
            assert operator.wait(EndpointState.CONNECTED).machine == "robot1"
        operator.wait(EndpointState.NOT_ANSWERING)
    lines = [record.getMessage() for record in caplog.records if "hub.open.connect" in record.getMessage()]
    assert [line.partition(f"{place}: ")[2].partition(":")[0] for line in lines] == [
        "refused", "not answering", "connected to robot1", "not answering",
    ], lines  # fmt: skip


def operator_status(machine: Machine) -> list[dict[str, Any]]:
    endpoints: list[dict[str, Any]] = machine.router._external.status(machine.config).document()["endpoints"]
    return endpoints


def test_each_endpoint_has_its_own_state(keys: Path, port: int) -> None:
    """A reachable endpoint, another address of the same machine, a wrong port and an unknown host name."""
    wrong = free_port()
    connect = [f"tls/127.0.0.1:{port}", f"tls/localhost:{port}", f"tls/127.0.0.1:{wrong}", "tls/robot9.invalid:7448"]
    authority = Authority(keys / "a")
    authority.issue("robot1", ["127.0.0.1", "localhost"], replace=True)
    with (
        Machine("robot1", keys / "a", listen=[connect[0]]),
        Machine("operator1", keys / "a", connect=connect) as operator,
    ):
        for number in (0, 1):
            assert operator.wait(EndpointState.CONNECTED, number).machine == "robot1"
        assert "nothing listens" in operator.wait(EndpointState.NOT_ANSWERING, 2).reason
        assert "cannot be resolved" in operator.wait(EndpointState.UNREACHABLE, 3).reason


def test_two_machines_may_connect_to_each_other(keys: Path, port: int) -> None:
    places = [f"tls/127.0.0.1:{port}", f"tls/127.0.0.1:{free_port()}"]
    with (
        Machine("robot1", keys / "a", listen=[places[0]], connect=[places[1]]) as robot,
        Machine("operator1", keys / "a", listen=[places[1]], connect=[places[0]]) as operator,
    ):
        for machine, name in ((robot, "operator1"), (operator, "robot1")):
            machine.wait(EndpointState.LISTENING)
            assert machine.wait(EndpointState.CONNECTED, 1).machine == name


def test_an_endpoint_without_tls_connects(keys: Path, port: int) -> None:
    place = f"tcp/127.0.0.1:{port}"
    with Machine("operator1", keys / "a", connect=[place], insecure=True) as operator:
        operator.wait(EndpointState.NOT_ANSWERING)
        with Machine("robot1", keys / "a", listen=[place], insecure=True):
            assert operator.wait(EndpointState.CONNECTED).machine == ""


def test_an_endpoint_without_zenoh_is_reported(keys: Path, port: int) -> None:
    import socket

    with (
        socket.create_server(("127.0.0.1", port)),
        Machine("operator1", keys / "a", connect=[f"tcp/127.0.0.1:{port}"], insecure=True) as operator,
    ):
        assert "opens no zenoh session" in operator.wait(EndpointState.NO_SESSION).reason


def test_endpoints_without_keys_stay_closed(keys: Path, tmp_path: Path) -> None:
    with Machine("robot1", tmp_path, listen=["tls/127.0.0.1:0"], connect=["tls/127.0.0.1:1"]) as robot:
        endpoints = robot.router._external.status(robot.config).document()["endpoints"]
    assert [(endpoint["way"], endpoint["state"]) for endpoint in endpoints] == [
        ("listen", "closed"),
        ("connect", "closed"),
    ]
    assert all("there is no" in endpoint["reason"] for endpoint in endpoints)


def test_an_expired_own_certificate_is_reported(tmp_path: Path, port: int) -> None:
    Authority(tmp_path).make()
    Authority(tmp_path).issue("robot1", ["127.0.0.1"], days=-1)
    with Machine("robot1", tmp_path, listen=[f"tls/127.0.0.1:{port}"]) as robot:
        reason = robot.wait(EndpointState.REFUSED).reason
    assert f"this machine's certificate {tmp_path}/robot1.pem expired on" in reason
    assert (
        "'midspan keys make robot1 127.0.0.1 --replace' on the machine with the authority's ca.key renews it" in reason
    )


def test_an_expired_own_certificate_explains_a_refused_connection(tmp_path: Path, port: int) -> None:
    Authority(tmp_path).make()
    Authority(tmp_path).issue("robot1", ["127.0.0.1"])
    Authority(tmp_path).issue("operator1", days=-1)
    place = f"tls/127.0.0.1:{port}"
    with Machine("robot1", tmp_path, listen=[place]), Machine("operator1", tmp_path, connect=[place]) as operator:
        reason = operator.wait(EndpointState.REFUSED).reason
    assert reason.startswith(f"this machine's certificate {tmp_path}/operator1.pem expired on ")
    assert "'midspan keys make operator1 --replace'" in reason


def test_an_own_certificate_that_is_not_valid_yet_is_reported(
    tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    Authority(tmp_path).make()
    monkeypatch.setattr(certificates, "_EARLIER", timedelta(hours=-6))  # made on a machine whose clock was ahead
    Authority(tmp_path).issue("robot1", ["127.0.0.1"])
    with Machine("robot1", tmp_path, listen=[f"tls/127.0.0.1:{port}"]) as robot:
        assert "robot1.pem is not valid before" in robot.wait(EndpointState.REFUSED).reason


def test_a_resolver_that_hangs_blocks_nothing(keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hangs, entered = threading.Event(), threading.Event()

    def resolve(*_: object, **__: object) -> list[Any]:
        entered.set()
        hangs.wait(60.0)
        return []

    monkeypatch.setattr("bridge.hub.security.handshake.socket.getaddrinfo", resolve)
    with Machine("operator1", keys / "a", connect=["tls/robot1.invalid:7448"]) as operator:
        assert entered.wait(40.0)
        before = time.monotonic()
        assert operator.router.health().state == "running"
        assert operator_status(operator)[0]["state"] == "connecting"
        operator.router.stop()
        assert time.monotonic() - before < 30.0, "nothing waits for the resolver"
    hangs.set()


class Pool:
    """A stand-in for a thread pool that counts the jobs, and ends each at once with the given result."""

    def __init__(self, result: Attempt) -> None:
        self.result, self.jobs = result, 0

    def submit(self, _job: Callable[[], Attempt]) -> Future[Attempt]:
        self.jobs += 1
        done: Future[Attempt] = Future()
        done.set_result(self.result)
        return done


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> float:
    monkeypatch.setattr(endpoints, "FIRST_SECONDS", 2.0)
    monkeypatch.setattr(endpoints, "TEST_SECONDS", 10.0)
    return time.monotonic()


@pytest.mark.parametrize("state", [EndpointState.REFUSED, EndpointState.CONNECTING, EndpointState.UNREACHABLE])
def test_the_rate_of_the_tests_is_bounded(slow: float, state: EndpointState) -> None:
    endpoint = endpoints._Connect("tls/10.0.0.9:7448", None)
    pool: Any = Pool(Attempt(Reason(state, "why")))
    for second in range(601):
        endpoint.poll([], pool, None, slow + second)
    assert 55 <= pool.jobs <= 62


def test_a_linked_endpoint_is_not_tested(slow: float) -> None:
    endpoint = endpoints._Connect("tls/10.0.0.9:7448", None)
    link: Any = SimpleNamespace(dst="tls/10.0.0.9:7448", auth_identifier="robot1")
    pool: Any = Pool(Attempt(Reason(EndpointState.CONNECTING), "", frozenset({"tls/10.0.0.9:7448"})))
    for second in range(100):
        endpoint.poll([link], pool, None, slow + second)
    assert pool.jobs == 1, "the endpoint is tested only once, to resolve its addresses"
    assert endpoint.status.state == EndpointState.CONNECTED


def logged(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return the messages about endpoints; zenoh's log of earlier tests may still arrive."""
    return [record.getMessage() for record in caplog.records if record.name == endpoints.__name__]


REFUSED = "2026-11-26T01:39:43Z  WARN acc-0 ThreadId(05) zenoh_link_tls::unicast: {}. Hint: increase the limit."


def test_a_listener_logs_each_cause_once_and_recovers(slow: float, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "bridge.hub.security")
    log, listener = ZenohLog(), endpoints._Listen("tls/0.0.0.0:1")
    log.reports_refusals = True
    for second in range(40):
        log.feed(REFUSED.format("invalid peer certificate: UnknownIssuer"))
        if second > 20:
            log.feed(REFUSED.format("received fatal alert: CertificateExpired"))
        log.feed(REFUSED.format("tls handshake eof"))
        listener.poll(log, None, slow + second)
    assert listener.status.state == EndpointState.REFUSED
    assert "a machine is refused: its certificate is from another authority" in listener.status.reason
    assert "this machine's certificate: it has expired" in listener.status.reason
    assert listener.refused == 40 + 19
    listener.poll(log, None, slow + 50)
    assert listener.status.state == EndpointState.REFUSED
    listener.poll(log, None, slow + 60)
    assert listener.status.state == EndpointState.LISTENING
    messages = logged(caplog)
    assert [("another authority" in m, "expired" in m, "no longer refused" in m) for m in messages] == [
        (True, False, False), (False, True, False), (False, False, True),
    ], messages  # fmt: skip


def test_a_listener_logs_the_problem_of_its_own_certificate_instead_of_alerts(
    slow: float, caplog: pytest.LogCaptureFixture
) -> None:
    log, listener = ZenohLog(), endpoints._Listen("tls/0.0.0.0:1")
    log.reports_refusals = True
    for second in range(10):
        log.feed(REFUSED.format("received fatal alert: BadCertificate"))
        log.feed(REFUSED.format("received fatal alert: CertificateExpired"))
        listener.poll(
            log, Reason(EndpointState.REFUSED, "robot1.pem is not valid before 2030", "set it"), slow + second
        )
    assert logged(caplog) == ["hub.open.listen tls/0.0.0.0:1: robot1.pem is not valid before 2030; set it"]


def test_a_listener_whose_address_has_disappeared_is_reported(
    slow: float, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The socket stays open without the address, for instance of a Wi-Fi network that this machine has left."""
    caplog.set_level(logging.INFO, "bridge.hub.security")
    present = {"10.5.0.1"}
    monkeypatch.setattr(endpoints, "has_address", lambda host: host in present)
    listener = endpoints._Listen("tcp/10.5.0.1:7448")
    states = []
    for second in range(9):
        present.clear() if second in range(3, 6) else present.add("10.5.0.1")
        listener.poll(None, None, slow + second)
        states.append(listener.status.state)
    assert states == [*["listening"] * 3, *["unreachable"] * 3, *["listening"] * 3]
    lost, back = logged(caplog)
    assert lost == (
        "hub.open.listen tcp/10.5.0.1:7448: unreachable: this machine does not have the address 10.5.0.1 now; connect"
        " this machine to that network, or correct the address"
    )
    assert back == "hub.open.listen tcp/10.5.0.1:7448: this machine has the address again"


@pytest.mark.parametrize(
    "place", ["tcp/127.0.0.1:1", "tcp/0.0.0.0:1", "tcp/[::]:1", "tcp/[fe80::1]:1", "tcp/name:1", "x"]
)
def test_other_listeners_count_as_reachable(slow: float, place: str) -> None:
    listener = endpoints._Listen(place)
    listener.poll(None, None, slow)
    assert listener.status.state == EndpointState.LISTENING


def test_an_address_that_this_machine_lacks_is_recognized(slow: float) -> None:
    listener = endpoints._Listen("tls/192.0.2.1:7448")  # for documentation (RFC 5737)
    listener.poll(None, None, slow)
    assert listener.status.state == EndpointState.UNREACHABLE


def test_zenohs_reason_is_reported_if_no_test_is_possible(slow: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.hub.security.zenoh_log.time", SimpleNamespace(monotonic=lambda: slow + 31))
    endpoint, log = endpoints._Connect("quic/10.0.0.9:7448", None), ZenohLog()
    pool: Any = Pool(Attempt(Reason(EndpointState.CONNECTING, "zenoh does not report why over quic")))
    for second in range(40):
        if second > 30:
            log.feed(
                "2026 DEBUG net-0 zenoh::net::runtime::orchestrator: Unable to connect to configured peer"
                " quic/10.0.0.9:7448! deadline has elapsed at /root/x/manager.rs:901.. Retry in 250ms."
            )
        endpoint.poll([], pool, log, slow + second)
        if second == 30:
            assert endpoint.status.reason == "zenoh does not report why over quic"
    assert endpoint.status.state == EndpointState.NOT_ANSWERING
    assert endpoint.status.reason == "deadline has elapsed"

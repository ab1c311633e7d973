"""The doctor's check of `hub.open`: it connects to each endpoint, and adds what the router reports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bridge.doctor.check import Finding, Result
from bridge.doctor.checks.connections import check_connections
from bridge.hub.security.certificates import Authority
from tests.doctor.parts import around, every, hub
from tests.hub.security.test_endpoints import Machine
from tests.support.ports import free_port


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    for fleet in ("a", "b"):
        Authority(folder / fleet).make()
        for name in ("robot1", "operator1"):
            Authority(folder / fleet).issue(name, ["127.0.0.1"])
    return folder


def check_endpoints(keys: Path, *reported: dict[str, Any], **opened: Any) -> list[Finding]:
    documents = [{"worker": "router", "side": "router", "endpoints": list(reported)}] if reported else []
    return list(every(check_connections(around({"hub": {"open": {"keys": str(keys), **opened}}}, hub=hub(*documents)))))


def report(way: str, endpoint: str, state: str, reason: str = "") -> dict[str, Any]:
    return {"way": way, "endpoint": endpoint, "state": state, "reason": reason, "cure": "cure" if reason else ""}


def test_a_closed_hub_is_skipped() -> None:
    assert [finding.result for finding in every(check_connections(around({})))] == [Result.SKIP]


def test_a_successful_and_a_failed_connection_are_reported(keys: Path) -> None:
    place, wrong = f"tls/127.0.0.1:{free_port()}", f"tls/127.0.0.1:{free_port()}"
    with Machine("operator1", keys / "a", listen=[place]):
        own_status, good, bad = check_endpoints(keys / "a", connect=[place, wrong])
        assert own_status.result is good.result is Result.OK
        assert good.seen == f"hub.open.connect {place}: TLS with operator1 succeeds"
        assert (bad.result, bad.seen.startswith(f"hub.open.connect {wrong}: not answering: nothing listens")) == (
            Result.WARN, True,
        )  # fmt: skip
        assert bad.cure
        foreign = check_endpoints(keys / "b", connect=[place])[-1]
        assert foreign.result is Result.FAIL
        assert "from another authority" in foreign.seen


def test_a_listener_of_this_machine_is_tested_on_loopback(keys: Path) -> None:
    """The listener is tested on loopback, whatever names its certificate has."""
    Authority(keys / "a").issue("far", ["10.9.9.9"])
    port = free_port()
    place = f"tls/0.0.0.0:{port}"
    far = {"certificate": str(keys / "a" / "far.pem"), "key": str(keys / "a" / "far.key")}
    with Machine("robot1", keys / "a", listen=[place], **far):
        finding = check_endpoints(keys / "a", report("listen", place, "listening"), listen=[place], **far)[-1]
        assert finding.result is Result.OK
        assert finding.seen == f"hub.open.listen {place}: TLS with far succeeds, and the router reports listening"
        refusing = report("listen", place, "refused", "a machine is refused")
        finding = check_endpoints(keys / "a", refusing, listen=[place], **far)[-1]
        assert (finding.result, finding.cure) == (Result.WARN, "cure")
        assert finding.seen == f"hub.open.listen {place}: refused: a machine is refused"
    finding = check_endpoints(keys / "a", report("listen", place, "listening"), listen=[place], **far)[-1]
    assert "nothing listens" in finding.seen
    assert check_endpoints(keys / "a", listen=[place], **far)[-1].result is Result.SKIP, "the router does not run"


def test_router_report_is_used_if_the_keys_are_unreadable(tmp_path: Path) -> None:
    places = ["tls/10.9.9.9:7448", "tls/10.9.9.8:7448"]
    reported = [report("connect", places[0], "refused", "why"), report("connect", places[1], "connected")]
    files, router = check_endpoints(tmp_path, *reported, connect=places)
    assert files.result is Result.FAIL
    assert (router.result, router.seen) == (Result.WARN, f"hub.open.connect {places[0]}: refused: why")


def test_a_connection_without_tls_is_checked(keys: Path) -> None:
    place = f"tcp/127.0.0.1:{free_port()}"
    assert "nothing listens" in check_endpoints(keys, connect=[place], insecure=True)[0].seen
    with Machine("operator1", keys, listen=[place], insecure=True):
        (finding,) = check_endpoints(keys, connect=[place], insecure=True)
    assert (finding.result, finding.seen) == (Result.OK, f"hub.open.connect {place}: it answers")


def test_quic_is_tested_by_the_router(keys: Path) -> None:
    place = "quic/10.9.9.9:7448"
    assert check_endpoints(keys / "a", connect=[place])[-1].seen.endswith("only the router can test it")
    reported = report("connect", place, "not answering", "deadline has elapsed")
    assert check_endpoints(keys / "a", reported, connect=[place])[-1].result is Result.WARN


def test_the_test_leaves_no_session(keys: Path) -> None:
    place = f"tls/127.0.0.1:{free_port()}"
    with Machine("operator1", keys / "a", listen=[place]) as operator:
        for _ in range(3):
            assert check_endpoints(keys / "a", connect=[place])[-1].result is Result.OK
        external = operator.router._external.router
        assert external is not None
        assert external.machines() == []
        assert external.endpoints()[0].state == "listening"

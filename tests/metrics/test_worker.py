"""The metrics worker on a hub: its responses, its access control, and faults of the hub or of another worker."""

from __future__ import annotations

import http.client
import ssl
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse

from bridge.config.document import ConfigError
from bridge.config.load import loads
from bridge.config.model import Config
from bridge.hub.daemons import DaemonIdentity, identity_of
from bridge.hub.node import Hub
from bridge.hub.security.certificates import Authority
from bridge.hub.security.tokens import new_token
from bridge.metrics.section import MetricsSection
from bridge.web.metrics_worker import MetricsWorker
from tests.metrics.documents import route, side
from tests.peers.hub.quick import QuickHub
from tests.support.status_documents import check_document
from tests.support.wait import until
from tests.web.conftest import Desk
from tests.web.test_server import ask

TOKEN = new_token()
OPENMETRICS = "application/openmetrics-text; version=1.0.0"


class MetricsRig:
    """A hub with a worker of the daemon ``here``, a worker of the daemon ``there``, and the metrics worker."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hubs = QuickHub()
        self.far = Hub.open(self.hubs.settings("ros1", "ros1", "here"))
        self.other = Hub.open(self.hubs.settings("ros1", "ros1", "there"))
        for hub in (self.far, self.other):
            hub.serve("status", lambda _params: side(route()))
        self.worker: MetricsWorker | None = None

    def start(self, **sections: Any) -> MetricsWorker:
        metrics = {"enabled": True, "listen": "127.0.0.1:0", **sections.pop("metrics", {})}
        config = Config.model_validate(
            {
                "name": "here",
                "state": self.folder,
                "hub": {"listen": self.hubs.endpoint},
                "metrics": metrics,
                **sections,
            }
        )
        self.worker = MetricsWorker()
        self.worker.start(config)
        return self.worker

    def ask(self, path: str, accept: str = "", tls: ssl.SSLContext | None = None, token: str = "") -> Any:
        """Return the status, content type and text of a response."""
        assert self.worker is not None
        assert self.worker.server is not None
        port = self.worker.server.port
        connection = (
            http.client.HTTPConnection("127.0.0.1", port, timeout=20)
            if tls is None
            else http.client.HTTPSConnection("127.0.0.1", port, timeout=20, context=tls)
        )
        headers = {"Accept": accept} if accept else {}
        if token:
            headers["Authorization"] = f"Bearer {token}"
        try:
            connection.request("GET", path, headers=headers)
            answer = connection.getresponse()
            return answer.status, answer.getheader("content-type"), answer.read().decode()
        finally:
            connection.close()

    def families(self) -> dict[str, list[Any]]:
        return {family.name: family.samples for family in parse(self.ask("/metrics")[2])}

    def close(self) -> None:
        if self.worker is not None:
            self.worker.stop()
            self.worker.stop()
        self.far.close()
        self.other.close()
        self.hubs.stop_router()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[MetricsRig]:
    opened = MetricsRig(tmp_path)
    yield opened
    opened.close()


def test_metrics_are_exported_in_both_formats(rig: MetricsRig) -> None:
    worker = rig.start()
    worker.health()

    def with_routes(accept: str = "") -> Any:
        """Return a response that has the routes; on a busy machine, their worker may answer too late for a scrape."""
        response = rig.ask("/metrics", accept)
        return response if "midspan_route_carry_seconds_count{" in response[2] else None

    status, kind, text = until(with_routes, "the routes are exported", 20)
    assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
    assert [s.value for f in parse(text) if f.name == "midspan_route_messages" for s in f.samples] == [3], (
        "only this daemon's routes are exported"
    )
    (answer,) = rig.far.ask("status", {}, daemon="here", worker="metrics", timeout=20.0)
    check_document(answer.value, "metrics")
    status, kind, text = until(lambda: with_routes(OPENMETRICS), "the routes are exported as OpenMetrics", 20)
    assert status == 200
    assert kind.startswith(OPENMETRICS)
    assert "midspan_route_carry_seconds" in {family.name for family in parse_openmetrics(text)}


@pytest.mark.parametrize("known", [True, False], ids=["both", "without its token"])
def test_another_daemon_with_the_same_name_is_left_out(rig: MetricsRig, tmp_path: Path, known: bool) -> None:
    """A worker of an earlier release announces no identity of its daemon, and is included."""
    settings = replace(rig.hubs.settings("ros2", "ros2", "here"), identity=identity(tmp_path) if known else None)
    own_hub = Hub.open(settings)
    (tmp_path / "other").mkdir()
    namesake = Hub.open(replace(rig.hubs.settings("yarp", "yarp", "here"), identity=identity(tmp_path / "other")))
    try:
        own_hub.serve("status", lambda _params: side(route(), worker="ros2", side="ros2"))
        namesake.serve("status", lambda _params: side(route(), worker="yarp", side="yarp"))
        rig.start().health()

        def sides() -> set[str]:
            return {sample.labels["side"] for sample in rig.families().get("midspan_side_state", [])}

        until(lambda: len(namesake.ask("status", {}, "here")) >= 3, "all workers answer")
        # on a busy machine, a worker may answer too late for one of the scrapes
        exported = until(lambda: now if (now := sides()) >= {"ros1", "ros2"} else None, "both workers are exported", 20)
        assert exported == {"ros1", "ros2"}
    finally:
        own_hub.close()
        namesake.close()


def identity(folder: Path) -> DaemonIdentity | None:
    return identity_of(Config.model_validate({"name": "here", "state": folder}))


def test_the_worker_responds_without_a_hub_and_joins_it_later(rig: MetricsRig) -> None:
    rig.hubs.stop_router()
    worker = rig.start()
    assert "no router" in worker.health().text
    assert rig.families()["midspan_hub_up"][0].value == 0
    rig.hubs.start_router()

    def has_routes() -> bool:
        worker.health()
        return "midspan_route_messages" in rig.families()

    until(has_routes, "the routes are exported", 20, every=0.2)
    rig.hubs.stop_router()
    until(lambda: rig.families()["midspan_hub_up"][0].value == 0, "the hub is reported as down", 20, every=0.2)
    rig.hubs.start_router()
    until(has_routes, "the routes are exported again", 20, every=0.2)


def test_a_hanging_worker_does_not_delay_the_others(rig: MetricsRig) -> None:
    hangs = threading.Event()
    stuck = Hub.open(rig.hubs.settings("ros2", "ros2", "here"))
    try:
        stuck.serve("status", lambda _params: hangs.wait(30))
        rig.start().health()

        def with_routes() -> dict[str, list[Any]] | None:
            families = rig.families()
            return families if "midspan_route_messages" in families else None

        families = until(with_routes, "the worker that responds is exported")
        assert families is not None
        assert 0.9 < families["midspan_ask_duration_seconds"][0].value < 25.0, "the worker hangs for 30 s"
    finally:
        hangs.set()
        stuck.close()


def test_the_worker_is_alive_but_not_ready_without_a_daemon(rig: MetricsRig) -> None:
    rig.start()
    assert rig.ask("/healthz") == (200, "text/plain; charset=utf-8", "alive\n")
    assert rig.ask("/readyz")[::2] == (503, "no daemon named 'here' answers\n")
    assert rig.ask("/none")[0] == 404


def test_another_machine_needs_a_token(rig: MetricsRig, tmp_path: Path) -> None:
    authority = Authority(tmp_path / "keys")
    authority.make()
    authority.issue("here", ["127.0.0.1"])
    rig.start(
        hub={"listen": rig.hubs.endpoint, "open": {"keys": str(tmp_path / "keys")}},
        metrics={"listen": "0.0.0.0:0"},
        web={"tokens": {"prometheus": {"role": "watch", "sha256": TOKEN[1]}}},
    )
    tls = ssl.create_default_context(cafile=tmp_path / "keys" / "ca.pem")
    assert rig.ask("/metrics", tls=tls)[0] == 401
    assert rig.ask("/metrics", tls=tls, token=TOKEN[0])[0] == 200
    assert rig.ask("/healthz", tls=tls)[0] == 200, "a supervisor, which has no token, may read /healthz"
    status, _, text = rig.ask("/readyz", tls=tls)
    assert (status, "daemon" in text) == (503, False)
    assert "no daemon" in rig.ask("/readyz", tls=tls, token=TOKEN[0])[2]


def test_a_public_address_without_protection_is_refused(rig: MetricsRig) -> None:
    with pytest.raises(ConfigError, match=r"metrics\.listen.*web\.tokens"):
        loads("metrics: {enabled: true, listen: '0.0.0.0:9480'}")
    with pytest.raises(RuntimeError, match=r"metrics\.listen: other machines reach"):
        rig.start(metrics={"listen": "0.0.0.0:0"})
    with pytest.raises(ConfigError, match="not an address with a port"):
        loads("metrics: {listen: '9480'}")
    assert loads("metrics: {listen: '0.0.0.0:9480'}").section(MetricsSection).reached


def test_an_address_in_use_is_reported(rig: MetricsRig) -> None:
    worker = rig.start()
    assert worker.server is not None
    second = MetricsWorker()
    listen = f"127.0.0.1:{worker.server.port}"
    with pytest.raises(RuntimeError, match=f"the worker metrics cannot listen on {listen}: .*; set metrics.listen"):
        second.start(Config.model_validate({"state": rig.folder, "metrics": {"enabled": True, "listen": listen}}))
    second.stop()


def test_the_console_serves_the_same_metrics(desk: Desk) -> None:
    with_worker = Hub.open(desk.hubs.settings("ros1", "ros1", "here"))
    try:
        with_worker.serve("status", lambda _params: side(route()))

        def get(path: str) -> str:
            return ask(desk.port, path)[2].decode()

        def with_routes() -> dict[str, Any]:
            families = {family.name: family.samples for family in parse(get("/metrics"))}
            return families if {"midspan_route_messages", "midspan_web_pages"} <= families.keys() else {}

        families = until(with_routes, "the route and the console are exported", 10)
        assert (get("/healthz"), get("/readyz")) == ("alive\n", "no daemon named 'here' answers\n")
    finally:
        with_worker.close()
    assert families["midspan_route_messages"][0].value == 3
    assert families["midspan_web_pages"][0].value == 0

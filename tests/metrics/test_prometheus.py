"""A real Prometheus scrapes a real daemon; promtool checks the alerts; alerts and dashboard use existing metrics."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse

from bridge.config.load import load
from bridge.daemon.query import ask_daemon
from bridge.metrics.families import FAMILIES
from tests.peers.daemon.deployment import Deployment
from tests.support.missing import PROMETHEUS, needs, prometheus_tool
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

ROOT = Path(__file__).parents[2]
RULES = ROOT / "packaging" / "prometheus" / "midspan.rules.yml"
DASHBOARD = ROOT / "packaging" / "grafana" / "midspan.json"
STRING = "std_msgs/String"


class ScrapedDeployment(Deployment):
    """A deployment with metrics at a separate address, a gateway, a store, a bridged topic and an external endpoint."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.port_of_metrics = free_port()
        self.address = f"127.0.0.1:{self.port_of_metrics}"

    def begin(self) -> None:
        other = {"connect": [f"tcp/127.0.0.1:{free_port()}"], "insecure": True}
        self.start(
            hub={"listen": f"tcp/127.0.0.1:{self.port}", "open": other},
            metrics={"enabled": True, "listen": self.address},
            navigation={"planner": "nav2"}, store={"enabled": True}, yarp={"enabled": False},
        )  # fmt: skip
        talker, hearer = self.ros1(), self.ros2()
        out, chat = talker.advertise("/chat", STRING), hearer.subscribe("/chat", STRING)

        def is_bridged() -> bool:
            talker.publish(out, {"data": "x"})
            return bool(hearer.wait(chat, 1, 0.2))

        until(is_bridged, "a message is bridged", 40)
        added = self.command("location", "add", "--map", "hall", "dock", "1", "2", "90")
        assert added.returncode == 0, added.stderr
        until(lambda: self.get("/readyz")[0] == 200, "the daemon is ready", 40, every=0.2)

    def pid_of(self, worker: str) -> int:
        """Return the worker's process id, as the daemon reports it."""
        daemon_status = ask_daemon(load(self.file), 20.0)
        assert daemon_status is not None
        return next(report.pid for report in daemon_status.workers if report.worker == worker)

    def get(self, path: str, accept: str = "text/plain") -> tuple[int, str]:
        request = urllib.request.Request(f"http://{self.address}{path}", headers={"Accept": accept})
        try:
            with urllib.request.urlopen(request, timeout=20) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as err:
            with err:
                return err.code, err.read().decode()
        except OSError as err:
            return 0, str(err)


@pytest.fixture(scope="module")
def deployment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ScrapedDeployment]:
    with ScrapedDeployment(tmp_path_factory.mktemp("deployment")) as deployment:
        deployment.begin()
        yield deployment


def promtool(*words: str, text: str = "") -> str:
    done = subprocess.run(
        [str(prometheus_tool("promtool")), *words], input=text, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def metric_names(text: str) -> set[str]:
    """Return the metric families named in a text."""
    names = set(re.findall(r"\bmidspan_[a-z0-9_]+\b", text))
    return {re.sub(r"_(bucket|sum|count)$", "", name) for name in names}


@needs(PROMETHEUS)
def test_promtool_accepts_the_alerts() -> None:
    assert "5 rules found" in promtool("check", "rules", str(RULES))


@needs(PROMETHEUS)
def test_the_alerts_fire_as_specified() -> None:
    assert "SUCCESS" in promtool("test", "rules", str(Path(__file__).with_name("alerts.test.yml")))


@needs(PROMETHEUS)
def test_promtool_accepts_a_scrape(deployment: ScrapedDeployment) -> None:
    assert promtool("check", "metrics", text=deployment.get("/metrics")[1]) == ""


def test_a_scrape_of_a_real_daemon_is_openmetrics(deployment: ScrapedDeployment) -> None:
    families: dict[str, Any] = {}

    def message_counts(family: str) -> dict[tuple[str, str], float]:
        samples = families[family].samples if family in families else []
        counts = [s for s in samples if s.labels["topic"] == "/chat" and s.name.endswith("_count")]
        return {(s.labels["side"], s.labels["direction"]): s.value for s in counts}

    def scraped() -> tuple[dict[tuple[str, str], float], dict[tuple[str, str], float]] | None:
        """Return the counts if both sides have answered; a busy worker may answer too late for one of the scrapes."""
        text = deployment.get("/metrics", "application/openmetrics-text; version=1.0.0")[1]
        families.clear()
        families.update({family.name: family for family in parse_openmetrics(text)})
        delivered = message_counts("midspan_route_latency_seconds")
        carried = message_counts("midspan_route_carry_seconds")
        return (delivered, carried) if delivered and carried else None

    counts = until(scraped, "both sides are exported")
    assert counts is not None
    delivered, carried = counts
    assert (delivered.keys(), carried.keys()) == ({("ros2", "out")}, {("ros1", "in")})
    assert min(*delivered.values(), *carried.values()) > 0


def test_a_daemon_exports_every_metric_of_dashboard_and_alerts(deployment: ScrapedDeployment) -> None:
    wanted = metric_names(DASHBOARD.read_text()) | metric_names(RULES.read_text())
    assert len(wanted) > 30
    wanted |= {family.name for family in FAMILIES}
    missing = set[str]()

    def all_exported() -> bool:
        """Return whether a scrape has each family; a busy worker may answer too late for one of the scrapes."""
        families = list(parse(deployment.get("/metrics")[1]))
        missing.clear()
        missing.update(wanted - {family.name + ("_total" if family.type == "counter" else "") for family in families})
        return not missing

    try:
        until(all_exported, "a real daemon has each family", every=0.2)
    except AssertionError as err:
        err.add_note(f"missing: {sorted(missing)}")
        raise


def test_the_dashboard_is_complete() -> None:
    dashboard = json.loads(DASHBOARD.read_text())
    panels = [panel for panel in dashboard["panels"] if panel["type"] != "row"]
    assert len({panel["id"] for panel in dashboard["panels"]}) == len(dashboard["panels"])
    assert all(target["datasource"]["uid"] == "${datasource}" for panel in panels for target in panel["targets"])
    variables = {variable["name"] for variable in dashboard["templating"]["list"]}
    used = {name for name in re.findall(r"\$(\w+)", json.dumps(panels)) if not name.startswith("__")}
    assert used <= variables
    wanted = {
        "bytes",
        "drops",
        "latency",
        "cpu",
        "memory",
        "restarts",
        "heartbeat",
        "lease",
        "store",
        "goals",
        "side_state",
    }
    text = json.dumps(panels)
    assert not {topic for topic in wanted if topic not in text}


class Prometheus:
    """A Prometheus that scrapes an address each second, with the alerts."""

    def __init__(self, folder: Path, target: str) -> None:
        self.port = free_port()
        config = {
            "global": {"scrape_interval": "1s", "evaluation_interval": "1s"},
            "rule_files": [str(RULES)],
            "scrape_configs": [{"job_name": "midspan", "static_configs": [{"targets": [target]}]}],
        }
        (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
        promtool("check", "config", str(folder / "prometheus.yml"))
        self._process = Process([
            str(prometheus_tool("prometheus")), f"--config.file={folder / 'prometheus.yml'}",
            f"--storage.tsdb.path={folder / 'data'}", f"--web.listen-address=127.0.0.1:{self.port}",
            "--log.level=warn",
        ])  # fmt: skip

    def query(self, expression: str) -> list[dict[str, Any]]:
        query = urllib.parse.urlencode({"query": expression})
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/api/v1/query?{query}", timeout=10) as answer:
                result: list[dict[str, Any]] = json.load(answer)["data"]["result"]
        except OSError:
            return []
        return result

    def close(self) -> None:
        self._process.stop()


def test_a_hanging_worker_is_reported_and_delays_nothing(deployment: ScrapedDeployment) -> None:
    answering, ros1 = 'midspan_worker_answering{worker="modules"} ', 'midspan_worker_answering{worker="ros1"} 1.0'
    pid = deployment.pid_of("modules")
    os.kill(pid, signal.SIGSTOP)
    try:
        scrapes = iter(lambda: deployment.get("/metrics")[1], "")
        text = until(
            lambda: text if f"{answering}0.0" in (text := next(scrapes)) and ros1 in text else "",
            "only this worker is reported as not answering",
            9,
        )
        took = next(float(line.split()[1]) for line in text.splitlines() if line.startswith("midspan_ask_duration"))
        assert 0.9 < took < 9.0, "the scrape does not wait until the worker is replaced"
        assert 'midspan_worker_resident_memory_bytes{worker="modules"}' in text, "its memory is read from the system"
    finally:
        with contextlib.suppress(ProcessLookupError):  # on a busy machine, the daemon may have replaced the process
            os.kill(pid, signal.SIGCONT)

    def is_back() -> bool:
        """Return whether the worker answers, and reports its modules, which other tests expect."""
        text = deployment.get("/metrics")[1]
        return f"{answering}1.0" in text and "midspan_goals_total{" in text

    until(is_back, "the worker answers again", 40, every=0.2)


@pytest.mark.thorough
@needs(PROMETHEUS)
def test_a_real_prometheus_scrapes_it(deployment: ScrapedDeployment, tmp_path: Path) -> None:
    with contextlib.closing(Prometheus(tmp_path, deployment.address)) as prometheus:
        until(lambda: prometheus.query('up{job="midspan"} == 1'), "Prometheus scrapes the daemon", every=0.2)
        routes = 'midspan_route_messages_total{topic="/chat"}'
        until(
            lambda: {route["metric"]["side"] for route in prometheus.query(routes)} == {"ros1", "ros2"},
            "the routes of both sides are stored", 20, every=0.2,
        )  # fmt: skip
        quantile = "histogram_quantile(0.5, sum by (le) (midspan_route_latency_seconds_bucket{topic='/chat'}))"
        latency = until(lambda: prometheus.query(quantile), "the latency is stored", every=0.2)
        assert 0.0 < float(latency[0]["value"][1]) < 2.5
        answering = "midspan_worker_up == 1 and midspan_worker_answering == 1"
        until(lambda: prometheus.query(answering), "a worker is up and answers", every=0.2)
        restart_alert = 'ALERTS{alertname="MidspanWorkerRestarts", worker="modules", alertstate="firing"}'
        assert not prometheus.query(restart_alert)
        os.kill(deployment.pid_of("modules"), signal.SIGKILL)
        until(lambda: prometheus.query(restart_alert), "the alert fires", 40, every=0.2)
    until(lambda: "midspan_goals_total" in deployment.get("/metrics")[1], "the modules are back", 40, every=0.2)

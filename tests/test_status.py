"""Status documents keep their keys, are read from any release, and never break the commands that show them."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from rich.console import Console

from bridge.cli.inspection.status import show
from bridge.client.refusals import refusals
from bridge.config.model import Config
from bridge.doctor.checks import CHECKS
from bridge.doctor.context import CheckContext, HubSnapshot
from bridge.doctor.daemon_state import DaemonState, Life
from bridge.hub.control import WorkerAnswer
from bridge.metrics.collector import MidspanCollector
from bridge.metrics.parts import parts
from bridge.metrics.source import Snapshot
from bridge.module_keys import GatewayKeys, MapServerKeys, StoreKeys
from bridge.status import (
    INVALID,
    ModuleStatus,
    Part,
    RouterStatus,
    RouteStatus,
    StatusDocument,
    WorkerStatus,
    read_daemon_status,
    read_status,
)
from bridge.web.feeds import hub as web_feed
from tests.doctor.parts import every
from tests.support.status_documents import DAEMON, DOCUMENTS, check_document
from tests.support.wait import until
from tests.web.conftest import Desk

COMMON = {"topics", "refused"}
"""Keys of each module that no program reads by name."""

DOCUMENT_CHECKS = ("daemon", "types", "type-hash", "ros2-releases", "cyclone", "yarp-releases")


def read(document: dict[str, Any], worker: str = "ros1") -> StatusDocument:
    return read_status(document, "robot", worker)


@pytest.mark.parametrize("worker", DOCUMENTS)
def test_real_documents_are_unchanged_after_reading(worker: str) -> None:
    document = DOCUMENTS[worker]
    status = read_status(document, "interop", worker)
    expected = {**document, "daemon": "interop", "worker": worker}
    assert json.dumps(status.document(), sort_keys=True) == json.dumps(expected, sort_keys=True)
    assert status.error == document.get("error", "")
    kinds = {"router": RouterStatus}
    expected_kind = ModuleStatus if document.get("module") else kinds.get(worker, WorkerStatus)
    assert type(status) is expected_kind


def test_a_real_daemon_document_is_unchanged_after_reading() -> None:
    status = read_daemon_status(DAEMON)
    assert json.dumps(status.document(), sort_keys=True) == json.dumps(DAEMON, sort_keys=True)
    assert status.error == ""


@pytest.mark.parametrize(
    ("worker", "kind"), [("gateway", GatewayKeys), ("map2d_server", MapServerKeys), ("store", StoreKeys)]
)
def test_the_own_keys_of_a_module_are_typed_in_the_recorded_order(worker: str, kind: type[Part]) -> None:
    typed = read_status(DOCUMENTS[worker], "interop", worker).other(kind).document()
    assert json.dumps({key: typed[key] for key in kind.model_fields if key in typed}) == json.dumps(
        {key: value for key, value in DOCUMENTS[worker].items() if key in kind.model_fields}
    )
    assert DOCUMENTS[worker].keys() - kind.model_fields.keys() <= ModuleStatus.model_fields.keys() | COMMON


def test_a_running_console_reports_the_recorded_keys(tmp_path: Path) -> None:
    """Other tests check the other workers, with `check_document`."""
    desk = Desk(tmp_path)
    try:
        (answer,) = until(lambda: desk.far.hub.ask("status", {}, worker="web"), "the console answers")
        check_document(answer.value, "web")
    finally:
        desk.close()


def test_documents_of_a_newer_release_keep_unknown_keys() -> None:
    document = {"side": "ros1", "novelty": {"a": [1]}, "routes": [{"topic": "/scan", "novelty": 2}]}
    status = read(document)
    assert status.document() == {**document, "daemon": "robot", "worker": "ros1"}
    report = {"workers": [{"worker": "ros1", "phase": "dreaming", "novelty": 1}], "novelty": 2}
    assert read_daemon_status(report).document() == report


def test_documents_of_an_older_release_have_defaults() -> None:
    status = read({"side": "ros1", "routes": [{}]})
    assert isinstance(status, WorkerStatus)
    assert (status.state, status.pid, status.uptime, status.network, status.warnings) == ("", 0, None, None, [])
    assert status.routes == [RouteStatus()]
    (report,) = read_daemon_status({"workers": [{"worker": "ros1"}]}).workers
    assert (report.phase, report.pid, report.restarts, report.beat) == ("", 0, 0, None)


def test_values_of_the_wrong_type_are_omitted_and_named() -> None:
    route = {"topic": "/a", "messages": "7", "drops": {"queue": 2, "bad": None, "large": 1.5}}
    status = read({"state": 5, "pid": 7, "routes": [8, route], "text": None})
    assert status.document() == {
        "daemon": "robot", "worker": "ros1", "pid": 7, "error": status.error,
        "routes": [{"topic": "/a", "drops": {"queue": 2}}],
    }  # fmt: skip
    assert status.error.startswith(f"{INVALID}: state: ")
    assert "routes.0: " in status.error
    assert "routes.1.messages: " in status.error
    assert "1 more; it may be of another release" in status.error
    assert "text" not in status.error, "null counts as missing"


def test_an_answer_that_is_not_a_document_counts_as_a_failed_worker() -> None:
    for value, error in ((None, "it hangs"), ([], ""), ("x", "")):
        status = read_status(value, "robot", "ros1", error)
        assert status.state == "failed"
        assert status.error == (error or "the answer is not a status document")


@pytest.mark.parametrize("value", [float("inf"), float("nan"), 10**400])
def test_numbers_that_no_display_can_show_are_refused(value: float) -> None:
    status = read({"uptime": value, "rss": value, "routes": [{"rate": value, "messages": value}]})
    assert INVALID in status.error
    assert status.document().keys() == {"daemon", "worker", "routes", "error"}


def test_names_that_are_not_unicode_are_kept() -> None:
    document = {"routes": [{"topic": "/\udc80"}], "warnings": ["\udcff"]}
    assert read(document).document()["routes"] == document["routes"]
    assert read(document).error == ""


ODD: tuple[Any, ...] = (None, "x", [7], {"x": -1})


def variants(document: Any) -> Iterator[Any]:
    """Yield a JSON value with each value in it replaced by each odd one; of a list, only the first element."""
    yield from ODD
    if isinstance(document, dict):
        for key, value in document.items():
            for odd in variants(value):
                yield {**document, key: odd}
    elif isinstance(document, list) and document:
        for odd in variants(document[0]):
            yield [odd, *document[1:]]


@pytest.mark.parametrize("worker", ["ros1", "router", "yarp", "transform_server", "store"])
def test_no_document_breaks_a_display(worker: str, displays: Callable[[StatusDocument], str]) -> None:
    for document in variants(DOCUMENTS[worker]):
        status = read_status(document, "interop", worker)
        shown = displays(status)
        assert not status.error or status.error.split(";")[0][:40] in shown


def test_no_report_of_the_daemon_breaks_a_display() -> None:
    config = Config.model_validate({"name": "interop"})
    for report in variants(DAEMON):
        if not isinstance(report, dict):
            continue
        daemon = read_daemon_status(report)
        state = DaemonState("interop", Life.RUNNING, daemon.pid, document=daemon)
        assert state.absences() is not None
        assert state.trouble.endswith(daemon.error)
        assert bool(state.trouble) is bool(daemon.error)
        state.why_missing("ros1", config)
        snapshot = Snapshot("interop", (), daemon, hub=True, seconds=0.1)
        assert parts(snapshot, config)
        assert list(MidspanCollector(cast("Any", None), 10).families(snapshot))


def test_a_module_that_counts_its_refusals_does_not_break_the_doctor() -> None:
    """The frame server's `refused` is a count by reason, but that of a side is a list of routes."""
    status = read({"module": True, "state": "running", "refused": {"it is a loop": 3}}, "frame_transform_server")
    assert "no type was refused" in doctor(status)


def doctor(status: StatusDocument) -> str:
    """Return the findings of the checks that use status documents."""
    context = CheckContext(Config(name=status.daemon), environ={}, hub=HubSnapshot(documents=[status]))
    findings = [every(check.run(context)) for check in CHECKS if check.id in DOCUMENT_CHECKS]
    return "\n".join(finding.seen for group in findings for finding in group)


@pytest.fixture
def displays(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[StatusDocument], str]:
    """Return a function that shows a document with status, doctor, console, metrics and diagnostics."""
    config = Config.model_validate({"name": "interop", "state": tmp_path})
    graph = SimpleNamespace(**dict.fromkeys(("endpoints", "publishers", "clients", "servers"), lambda *_: []))
    hub = SimpleNamespace(zid="ff", graph=graph, domain=0)
    collector = MidspanCollector(cast("Any", None), 10)
    monkeypatch.setattr(web_feed, "ask_daemon", lambda _config: read_daemon_status(DAEMON))

    def display(status: StatusDocument) -> str:
        answer = WorkerAnswer(status.daemon, status.worker, status.document())
        client = SimpleNamespace(ask=lambda *_, **__: [answer], config=config, hub=hub, here=True)
        shown = io.StringIO()
        show(Console(width=1000, file=shown), [status], refusals(cast("Any", client), [status]))
        json.dumps(web_feed.ask_status(cast("Any", client)))
        snapshot = Snapshot("interop", (status,), None, hub=True, seconds=0.1)
        assert list(collector.families(snapshot))
        assert parts(snapshot, config)
        doctor(status)
        return shown.getvalue()

    return display

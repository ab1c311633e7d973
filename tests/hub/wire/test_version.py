"""Hub peers with another protocol version: another minor version is accepted, another major one refused and logged."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest
import zenoh

from bridge.hub.graph.tokens import (
    BRIDGE_ENCLAVE,
    EndpointKind,
    EndpointToken,
    NodeToken,
    Origin,
    OriginToken,
    endpoint_key,
    origin_key,
)
from bridge.hub.lane import folder
from bridge.hub.lane.wire import VERSION
from bridge.hub.node import Hub
from bridge.hub.wire.version import MAJOR, WIRE, refusal
from tests.peers.hub.endpoints import HASH, STREAM, TYPE
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

LATER = f"{MAJOR}.12345"
NEXT = f"{MAJOR + 1}.0"


@pytest.mark.parametrize("version", [None, WIRE, LATER])
def test_same_major_version_is_accepted(version: object) -> None:
    assert refusal(version) == ""


@pytest.mark.parametrize("version", [NEXT, "0.9", "1", "1.0.0", "", 1, 1.0, True, ["1.0"], "1.0\n", "1.123456"])
def test_other_major_versions_are_rejected(version: object) -> None:
    assert refusal(version)


def test_endpoints_of_another_major_version_have_no_origin(
    network: HubNetwork, caplog: pytest.LogCaptureFixture
) -> None:
    with Hub.open(network.settings("here")) as hub, network.program() as program:
        zid = str(program.zid())
        node = NodeToken(network.domain, zid, "0", "/", "far", BRIDGE_ENCLAVE)
        endpoint = endpoint_key(EndpointToken(node, "1", EndpointKind.PUBLISHER, "/scan", TYPE, HASH, STREAM))
        origin = origin_key(OriginToken(network.domain, zid, Origin("ros1", "net", "far")))

        def seen() -> list[tuple[Origin | None, bool]]:
            return [(publisher.origin, publisher.pending) for publisher in hub.graph.publishers("/scan")]

        tokens = program.liveliness()
        kept = [tokens.declare_token(key) for key in (origin, endpoint)]
        until(lambda: seen() == [(Origin("ros1", "net", "far"), False)], "the endpoint's origin is known")
        version = f"@midspan/{network.domain}/wire/{zid}"
        with caplog.at_level(logging.WARNING):
            later = tokens.declare_token(f"{version}/{LATER}/9.9/and/more")
            strange = tokens.declare_token(f"{version}/{NEXT}/9.9")
            until(lambda: seen() == [(None, True)], "the origin is refused, so the endpoint is not bridged")
        (log_line,) = (line for line in caplog.messages if zid in line)
        assert log_line == f"Midspan 9.9 on the hub is refused, session {zid}: {refusal(NEXT)}"
        assert (
            f"it uses version {NEXT} of Midspan's protocol, and this Midspan {WIRE}; install the same release"
            in log_line
        )
        strange.undeclare()
        until(lambda: seen() == [(Origin("ros1", "net", "far"), False)], "the origin is accepted again")
        for token in (later, *kept):
            token.undeclare()


def test_session_announces_its_version(network: HubNetwork) -> None:
    with Hub.open(network.settings("here")) as hub, network.program() as program:
        key = f"@midspan/{network.domain}/wire/{hub.zid}/*/*"
        until(lambda: list(program.liveliness().get(key)), "the session announces a version")
        (reply,) = program.liveliness().get(key)
        assert str(reply.ok.key_expr).split("/")[4] == WIRE


def test_only_answers_of_a_compatible_wire_version_are_accepted(network: HubNetwork) -> None:
    with Hub.open(network.settings("here")) as hub, network.program() as program:
        key = f"@midspan/{network.domain}/far/worker"
        answers = {"later": {"wire": LATER}, "next": {"wire": NEXT}, "none": {}}

        def answer(query: zenoh.Query) -> None:
            verb = str(query.key_expr).rpartition("/")[2]
            query.reply(f"{key}/{verb}", json.dumps({"value": 7, "more": 8, **answers[verb]}))

        kept = [program.declare_queryable(f"{key}/{verb}", answer, complete=True) for verb in answers]
        until(lambda: hub.ask("none", {}), "the session responds")
        assert [(a.value, a.error) for a in hub.ask("none", {}, timeout=40.0)] == [(7, "")]
        assert [(a.value, a.error) for a in hub.ask("later", {}, timeout=40.0)] == [(7, "")]
        (refused,) = hub.ask("next", {}, timeout=40.0)
        assert refused.value is None
        assert refused.error.startswith(f"far/worker cannot be understood: it uses version {NEXT}")
        for queryable in kept:
            queryable.undeclare()


def test_a_lane_of_another_version_is_named(tmp_path: Path) -> None:
    (tmp_path / "ab.7").touch()
    assert folder.other_version(tmp_path, "ab") == f"its lane has version 7, ours {VERSION}; zenoh is used instead"
    assert folder.other_version(tmp_path, "cd") == ""
    assert folder.other_version(tmp_path, "*") == ""

"""Versions of types on the DDS network: the version of an endpoint, the conversions, and the texts for users."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pytest

from bridge.adapters.ros2.versions import EndpointVersions
from bridge.hub.wire.qos import Qos
from bridge.messages.definitions.hashes import rihs01
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.releases import NO_HASH
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from bridge.routing.edge import Endpoint, Kind, MadeBy

RANGE, EVENT = "sensor_msgs/msg/Range", "lifecycle_msgs/msg/TransitionEvent"
RESULT = "nav2_msgs/action/NavigateThroughPoses_GetResult"
UNKNOWN = "RIHS01_" + "1" * 64


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry()


@pytest.fixture
def versions(registry: Registry) -> EndpointVersions:
    return EndpointVersions(registry)


def end(kind: Kind, type_name: str, type_id: str, node: str = "/node") -> Endpoint:
    return Endpoint(node, kind, "/name", type_name, Qos(), MadeBy.NATIVE, node=node, type_id=type_id)


def test_a_publisher_without_hash_has_humbles_version(registry: Registry, versions: EndpointVersions) -> None:
    publisher = end(Kind.PUBLISHER, RANGE, NO_HASH)
    conversion = versions.to_hub(publisher)
    assert conversion is not None
    assert conversion.convert is not None
    here = registry.schema(RANGE)
    message = MessageWriter(here).message({"range": 2.5, "variance": 0.0})
    received = MessageReader(here, conversion.convert(message[:-4])).message()
    assert (received["range"], received["variance"]) == (2.5, 0.0)
    assert versions.is_of(publisher, conversion.source.type_id)
    assert not versions.is_of(replace(publisher, type_id=conversion.target.type_id), conversion.source.type_id)
    assert versions.to_hub(end(Kind.PUBLISHER, "std_msgs/msg/String", NO_HASH)) is None
    assert versions.to_hub(end(Kind.PUBLISHER, RANGE, UNKNOWN)) is None  # refused like any other unknown type
    assert versions.may_be_humble(publisher)
    assert versions.to_hub(versions.of_plain_dds(publisher)) is None


def test_readers_get_the_version_that_they_have_in_common(registry: Registry, versions: EndpointVersions) -> None:
    here, lyrical = registry.releases.hashes(EVENT)
    readers = [end(Kind.SUBSCRIPTION, EVENT, type_id) for type_id in (lyrical, UNKNOWN, here)]
    assert versions.for_readers(here, readers[:1]) == lyrical
    assert versions.for_readers(here, readers[:2]) == lyrical
    assert versions.for_readers(here, readers) == here
    assert versions.for_readers(here, []) == here
    assert versions.converter(EVENT, here, here) is None
    assert versions.converter(EVENT, here, lyrical) is not None


def test_readers_that_cannot_decode_are_named_once(registry: Registry, versions: EndpointVersions) -> None:
    here, lyrical = registry.releases.hashes(EVENT)
    ends = [end(Kind.SUBSCRIPTION, EVENT, type_id, node) for type_id, node in ((here, "/old"), (lyrical, "/new"))]
    (text,) = versions.notes([*ends, *ends])["topic", "out", "/name"][-1:]
    assert text.startswith(
        "/new (lyrical) decodes it wrongly: it is sent as lifecycle_msgs/msg/TransitionEvent of jazzy"
    )
    assert versions.warnings(ends, {"/name": EVENT}) == [f"/name: {text}"]
    assert versions.warnings(ends, {}) == []
    assert versions.warnings(ends[1:], {"/name": EVENT}) == []
    assert not any("decodes" in text for text in versions.notes(ends, {"/name"})["topic", "out", "/name"])
    assert versions.warnings(ends, {"/name": EVENT}, {"/name"}) == []
    (text,) = versions.warnings([*ends, end(Kind.SUBSCRIPTION, EVENT, UNKNOWN, "/odd")], {"/name": EVENT}, {"/name"})
    assert text.startswith(f"/name: /odd ({UNKNOWN}) decodes it wrongly")
    other = end(Kind.SUBSCRIPTION, "std_msgs/msg/String", UNKNOWN)
    (text,) = versions.warnings([other], {"/name": "std_msgs/msg/String"})
    assert UNKNOWN in text


def test_the_hash_of_the_replies_decides_the_version_of_a_service(
    registry: Registry, versions: EndpointVersions
) -> None:
    """The requests of all versions have the same hash, so the hash of the replies decides."""
    parts = {version: hashes for hashes, version in registry.releases._service_parts(RESULT).items()}
    here, kilted = parts
    request = parts[here][0]
    assert {hashes[0] for hashes in parts.values()} == {request}
    assert versions.of_service(RESULT, *parts[kilted]) == kilted
    unresolved = end(Kind.CLIENT, RESULT, versions.of_service(RESULT, request, ""))
    assert not versions.is_resolved(unresolved)
    assert versions.is_resolved(replace(unresolved, type_id=kilted))
    assert versions.of_service(RESULT, request, UNKNOWN) == UNKNOWN
    assert versions.of_client(RESULT, here, request, UNKNOWN) is None
    converters = versions.of_client(RESULT, here, request, kilted)
    assert converters is not None
    response = MessageWriter(registry.schema(f"{RESULT}_Response")).message({"status": 4})
    newer = registry.schema(RESULT, kilted).sub(f"{RESULT}_Response")
    assert MessageReader(newer, converters[1](response)).message()["status"] == 4


def test_servers_of_two_versions_cannot_be_called(registry: Registry, versions: EndpointVersions) -> None:
    here, kilted = registry.releases._service_parts(RESULT).values()
    servers = [end(Kind.SERVER, RESULT, type_id, node) for type_id, node in ((here, "/old"), (kilted, "/new"))]
    obstacle = versions.obstacle("/name", servers)
    assert obstacle is not None
    assert "jazzy: /old; kilted: /new" in obstacle.reason
    assert versions.obstacle("/name", servers[:1]) is None
    assert versions.obstacle("/name", servers[:1], here) is None
    assert versions.obstacle("/name", servers[:1], kilted) is not None
    unknown = end(Kind.SERVER, RESULT, UNKNOWN, "/odd")
    obstacle = versions.obstacle("/name", [servers[0], unknown], here)
    assert obstacle is not None
    assert f"jazzy: /old; {UNKNOWN}: /odd" in obstacle.reason
    own = [end(Kind.SERVER, "my_msgs/srv/Own", type_id) for type_id in ("", UNKNOWN, UNKNOWN[:-1] + "2")]
    assert versions.obstacle("/name", own[:2]) is None
    assert versions.obstacle("/name", [own[1], replace(own[2], type="my_msgs/srv/Other")]) is None
    assert versions.obstacle("/name", own) is not None


def named(servers: Iterable[Endpoint]) -> list[str]:
    return [server.node for server in servers]


def test_servers_of_one_version_are_called(registry: Registry, versions: EndpointVersions) -> None:
    """That is this machine's, or else the most frequent one that converts."""
    (here_request, _), here = next(iter(registry.releases._service_parts(RESULT).items()))
    kilted = list(registry.releases._service_parts(RESULT).values())[1]
    old, new, newer, odd = (
        end(Kind.SERVER, RESULT, type_id, node)
        for node, type_id in {"/old": here, "/new": kilted, "/newer": kilted, "/odd": UNKNOWN}.items()
    )
    assert named(versions.called([new, old, odd])) == ["/old"]
    assert named(versions.called([odd, new, newer])) == ["/new", "/newer"]
    assert named(versions.called([odd])) == ["/odd"]
    two_unknown = [odd, replace(odd, node="/odder", id="/odder", type_id=UNKNOWN[:-1] + "2")]
    assert named(versions.called(two_unknown)) == ["/odd", "/odder"]
    assert versions.obstacle("/name", two_unknown) is not None
    undiscovered = end(Kind.SERVER, RESULT, here_request, "/undiscovered")
    assert named(versions.called([undiscovered, new])) == ["/new"]
    assert named(versions.called([undiscovered])) == ["/undiscovered"]
    midspan = replace(new, made_by=MadeBy.MIDSPAN)
    assert versions.with_uncalled([old, midspan], {"/old"}) == [old, midspan]
    first, second = versions.with_uncalled([old, new], {"/old"})
    assert first.uncalled is None
    assert second.uncalled is not None
    assert second.uncalled.reason.endswith("(jazzy: /old; kilted: /new): calls go to /old")
    assert versions.notes([first, second])["service", "in", "/name"] == [second.uncalled.reason]


def test_servers_of_a_type_with_one_version_are_called_by_the_hash_of_their_requests(
    versions: EndpointVersions,
) -> None:
    name = "std_srvs/srv/SetBool"
    here = rihs01(Registry().service_schemas(name)[0])
    servers = [
        end(Kind.SERVER, name, type_id, node) for node, type_id in (("/odd", UNKNOWN), ("/ok", here), ("/bare", ""))
    ]
    assert named(versions.called(servers)) == ["/ok", "/bare"]


@pytest.mark.parametrize("kinds", [(Kind.PUBLISHER, Kind.SUBSCRIPTION), (Kind.CLIENT, Kind.SERVER)])
def test_native_nodes_of_two_versions_are_reported(
    registry: Registry, versions: EndpointVersions, kinds: tuple[Kind, Kind]
) -> None:
    type_name = EVENT if kinds[0] is Kind.PUBLISHER else RESULT
    here, other = list(registry.releases.hashes(type_name))[:2]
    sender, receiver = (end(kind, type_name, here, f"/{kind.value}") for kind in kinds)
    newer = replace(receiver, type_id=other, node="/newer")
    (warning,) = versions.warnings([sender, receiver, newer], {})
    assert warning.startswith(f"/name: native nodes have different versions of {type_name} (jazzy: ")
    assert "/newer)" in warning
    assert versions.warnings([sender, receiver], {}) == []
    assert versions.warnings([receiver, newer], {}) == []
    assert versions.warnings([sender, replace(newer, made_by=MadeBy.MIDSPAN)], {}) == []


def test_a_server_of_an_unknown_version_is_refused(registry: Registry, versions: EndpointVersions) -> None:
    (request, _), here = next(iter(registry.releases._service_parts(RESULT).items()))
    server = end(Kind.SERVER, RESULT, here)
    versions.check_server(server, here, request)
    versions.check_server(replace(server, type_id=NO_HASH), here, request)
    with pytest.raises(MessageTypeError, match=f"{UNKNOWN}.*{here}"):
        versions.check_server(replace(server, type_id=UNKNOWN), here, request)
    with pytest.raises(MessageTypeError, match="not discovered yet"):
        versions.check_server(replace(server, type_id=request), here, request)


def test_an_unknown_type_is_left_to_its_route(versions: EndpointVersions) -> None:
    for kind in Kind:
        name = "my_msgs/srv/Own" if kind in (Kind.SERVER, Kind.CLIENT) else "my_msgs/msg/Own"
        assert versions.notes([end(kind, name, UNKNOWN), end(kind, "odd", NO_HASH)]) == {}
    with pytest.raises(MessageTypeError):
        Registry().ros2("my_msgs/msg/Own")

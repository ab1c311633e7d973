"""Versions of types on the DDS network: endpoints of other releases, whose messages have different fields.

DDS matches endpoints by the name of their type, so an endpoint also receives messages of another version, and decodes
them wrongly. Endpoints announce the hash of their version (those of Humble announce none). Midspan converts received
messages from the version of their publisher, client or server, and sends messages in the version of the readers, server
or client.
"""

from __future__ import annotations

import contextlib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace

from bridge.adapters.ros2.graph import vendors
from bridge.hub.graph.tokens import EndpointKind
from bridge.messages.definitions.hashes import rihs01
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.releases import NO_HASH
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, Convert, ServiceConversion, SideType
from bridge.messages.unchanged import same
from bridge.routing.edge import Endpoint, Kind, MadeBy, Obstacle
from bridge.routing.versions import loss_text

Notes = Mapping[tuple[str, str, str], list[str]]
"""Texts by ``topic`` or ``service``, direction and name."""

_KINDS = {
    Kind.PUBLISHER: EndpointKind.PUBLISHER,
    Kind.SUBSCRIPTION: EndpointKind.SUBSCRIPTION,
    Kind.SERVER: EndpointKind.SERVER,
    Kind.CLIENT: EndpointKind.CLIENT,
}
_CURE = "install the same version of the package on both, or give its folder in types.folders"


def _by_type(servers: Iterable[Endpoint]) -> dict[str, list[Endpoint]]:
    """Group servers by their type: DDS matches equal names of types."""
    types: dict[str, list[Endpoint]] = defaultdict(list)
    for server in servers:
        types[server.type].append(server)
    return types


class EndpointVersions:
    """The versions of the endpoints' types. Safe to use from any thread."""

    def __init__(self, registry: Registry) -> None:
        self._registry, self._releases = registry, registry.releases

    def varies(self, type_name: str) -> bool:
        """Return whether a type has several known versions."""
        return self._releases.varies(type_name)

    def may_be_humble(self, endpoint: Endpoint) -> bool:
        """Return whether an endpoint has Humble's version of a type, if a ROS 2 program created it."""
        return not endpoint.type_id and self._differs(endpoint.type, NO_HASH)

    def of_plain_dds(self, endpoint: Endpoint) -> Endpoint:
        """Return the endpoint of a program outside ROS 2's graph; without a hash it gets this machine's version."""
        return replace(endpoint, type_id=self._releases.here_hash(endpoint.type)) if not endpoint.type_id else endpoint

    def of_service(self, type_name: str, request: str, reply: str) -> str:
        """Return the hash of a service from the hashes of its request and reply, which its endpoints announce.

        If no known version has both, return a hash that belongs to no version. ``reply`` is "" before it is discovered.
        """
        if not request or request in self._releases.hashes(type_name):
            return request
        known = self._releases.service_hash(type_name, request, reply)
        return known or (reply if reply and self._releases.has_request(type_name, request) else request)

    def is_resolved(self, service: Endpoint) -> bool:
        """Return whether the version of a server or client is known, or unknown for good."""
        name, type_id = service.type, service.type_id
        return not self.varies(name) or not self._releases.has_request(name, type_id)

    def is_of(self, endpoint: Endpoint, type_id: str) -> bool:
        """Return whether an endpoint has the version of a side's type."""
        if endpoint.type_id:
            return endpoint.type_id == type_id
        return type_id == NO_HASH or not self._differs(endpoint.type, NO_HASH)

    def _differs(self, type_name: str, type_id: str) -> bool:
        """Return whether a version is known and differs from this machine's."""
        return self._releases.here(type_name, type_id) != type_id

    def to_hub(self, endpoint: Endpoint) -> Conversion | None:
        """Return the conversion of a publisher's messages from another version; None if it has this machine's."""
        name, version = endpoint.type, endpoint.type_id
        if not self._differs(name, version):
            return None
        here = self._registry.ros2(name)
        convert = self._releases.converter(name, version, here.type_id)
        if convert is None or convert is same:
            convert = self._registry.hub_check(name)
        return Conversion(SideType(name, version, here.definition), here, convert)

    def service_to_hub(self, endpoint: Endpoint, here: ServiceConversion) -> ServiceConversion | None:
        """Return the conversion of a server of another version.

        None if the server has this machine's version, whose conversion is ``here``, or a version without converters.
        """
        name, version, own = endpoint.type, endpoint.type_id, here.hub.type_id
        if version == own or not self._differs(name, version):
            return None
        request = self._releases.converter(name, own, version, "Request")
        response = self._releases.converter(name, version, own, "Response")
        if request is None or response is None:
            return None
        return ServiceConversion(
            SideType(name, version, here.side.definition),
            here.hub,
            request_to_side=here.request_to_side if request is same else request,
            request_to_hub=None,
            response_to_side=None,
            response_to_hub=here.response_to_hub if response is same else response,
        )

    def called(self, servers: Iterable[Endpoint]) -> list[Endpoint]:
        """Return the servers that get a service's requests: of each type, the servers of one version.

        This is this machine's version if a server has it, else the most frequent version that can be converted. All
        servers are returned if neither exists.
        """
        called: list[Endpoint] = []
        for type_name, of_type in _by_type(servers).items():
            known = [(server, self._of_server(server)) for server in of_type]
            version = self._version_to_call(type_name, Counter(v for _, v in known if v is not None))
            hashless = None if self.varies(type_name) else version  # otherwise the version is not discovered yet
            called += [server for server, v in known if version in (None, hashless if v is None else v)]
        return called

    def _version_to_call(self, type_name: str, versions: Counter[str]) -> str | None:
        here = self._releases.here_hash(type_name)
        if not self.varies(type_name):
            with contextlib.suppress(MessageTypeError):
                here = rihs01(self._registry.service_schemas(type_name)[0])  # servers announce the hash of requests
        if here in versions or len(versions) < 2:
            return here if here in versions else next(iter(versions), None)
        convertible = {v: count for v, count in versions.items() if self._releases.here(type_name, v) == here}
        return min(convertible, key=lambda v: (-convertible[v], v), default=None)

    def with_uncalled(self, servers: Iterable[Endpoint], called: Collection[str]) -> list[Endpoint]:
        """Return a service's servers, and mark those whose version differs from the version that is called.

        ``called`` has the ids of the servers that are called.
        """
        marked: list[Endpoint] = []
        for type_name, of_type in _by_type(servers).items():
            versions = {server.id: self._of_server(server) for server in of_type}
            chosen = [server for server in of_type if server.id in called]
            others = {versions[server.id] for server in of_type if server.made_by is MadeBy.NATIVE}
            others -= {None, *(versions[server.id] for server in chosen)}
            nodes = self._versions_of_nodes(type_name, of_type)
            reason = (
                f"{of_type[0].topic} is served with different versions of {type_name} ({nodes}): calls go to"
                f" {', '.join(sorted(server.node or vendors.UNNAMED for server in chosen))}"
            )
            uncalled = Obstacle(reason, vendors.CURE)
            marked += [
                replace(server, uncalled=uncalled if chosen and versions[server.id] in others else None)
                for server in of_type
            ]
        return marked

    def _versions_of_nodes(self, type_name: str, servers: Iterable[Endpoint]) -> str:
        """Return the nodes of native servers, or other endpoints, by version, as text."""
        nodes: dict[str, set[str]] = defaultdict(set)
        for server in servers:
            version = self._of_server(server) if server.made_by is MadeBy.NATIVE else None
            if version is not None:
                nodes[version].add(server.node or vendors.UNNAMED)
        return "; ".join(f"{self._label(type_name, v)}: {', '.join(sorted(names))}" for v, names in nodes.items())

    def check_server(self, endpoint: Endpoint, here: str, request: str) -> None:
        """Raise `MessageTypeError` unless a server has this machine's version of its type, or announces no hash.

        Args:
            endpoint: the server.
            here: hash of this machine's version.
            request: hash of that version's requests.
        """
        name, version, varies = endpoint.type, endpoint.type_id, self.varies(endpoint.type)
        if version in ("", here if varies else request):
            return
        if not varies:
            raise MessageTypeError(
                f"{name}: its server's requests have {version}, this machine's have {request}", _CURE
            )
        if not self.is_resolved(endpoint):
            raise MessageTypeError(
                f"{name}: several versions have the requests of its server, whose replies are not discovered yet",
                "wait: DDS discovers them within seconds",
            )
        raise MessageTypeError(f"{name}: its server has an unknown version ({version}), this machine has {here}", _CURE)

    def others(self, type_name: str, here: str) -> dict[str, Convert | None]:
        """Return the other versions of a type, each with the converter of this machine's messages.

        The converter is None if the bytes are the same; versions without a converter are left out. Humble's version is
        among them as `NO_HASH`, if it differs.
        """
        hashless = [NO_HASH] if self._differs(type_name, NO_HASH) else []
        versions = [v for v in (*self._releases.hashes(type_name), *hashless) if v != here]
        converters = {version: self._releases.converter(type_name, here, version) for version in versions}
        return {version: None if convert is same else convert for version, convert in converters.items() if convert}

    def of_readers(self, readers: Iterable[Endpoint]) -> frozenset[str]:
        """Return the known versions of readers."""
        return frozenset(version for reader in readers if (version := self._known(reader)) is not None)

    def for_readers(self, here: str, readers: Iterable[Endpoint]) -> str:
        """Return the version for a writer that sends to all readers.

        This is this machine's version (``here``) if any reader has it or no reader's version is known, else the most
        frequent version.
        """
        versions = Counter(version for reader in readers if (version := self._known(reader)) is not None)
        if not versions or here in versions:
            return here
        return min(versions, key=lambda version: (-versions[version], version))

    def _known(self, endpoint: Endpoint) -> str | None:
        """Return the version of an endpoint; None if it is unknown."""
        if not endpoint.type_id:
            return NO_HASH if self._differs(endpoint.type, NO_HASH) else self._releases.here_hash(endpoint.type)
        return endpoint.type_id if endpoint.type_id in self._releases.hashes(endpoint.type) else None

    def converter(self, type_name: str, here: str, version: str) -> Convert | None:
        """Return the converter of this machine's messages to another version; None if there is nothing to convert."""
        convert = None if version == here else self._releases.converter(type_name, here, version)
        return None if convert is same else convert

    def of_client(self, type_name: str, here: str, request_hash: str, client: str) -> tuple[Convert, Convert] | None:
        """Return the converters of a client's requests to this machine's version, and of the replies from it.

        Args:
            type_name: the service.
            here: hash of this machine's version.
            request_hash: hash of that version's requests.
            client: hash that the client announced, as `of_service` returns it.

        Returns None if the client's version is unknown.
        """
        if client in (here, request_hash):
            return same, same
        if client == NO_HASH and not self._differs(type_name, NO_HASH):
            return same, same
        request = self._releases.converter(type_name, client, here, "Request")
        reply = self._releases.converter(type_name, here, client, "Response")
        return None if request is None or reply is None else (request, reply)

    # -- texts for users -----------------------------------------------------------------------------------------------

    def obstacle(self, service: str, servers: Iterable[Endpoint], expected: str | None = None) -> Obstacle | None:
        """Return why servers cannot be called because of their versions; None if they can.

        Args:
            service: the service's name.
            servers: all servers of the service.
            expected: the version of the client that is to call them; None before a client exists.
        """
        for type_name, of_type in _by_type(servers).items():
            versions = {self._of_server(server) for server in of_type if server.made_by is MadeBy.NATIVE} - {None}
            if not versions or (len(versions) == 1 and (expected is None or expected in versions)):
                continue
            found = self._versions_of_nodes(type_name, of_type)
            if len(versions) == 1:
                return Obstacle(f"{service} is now served with another version of {type_name} ({found})", "call again")
            reason = (
                f"{service} is served with different versions of {type_name} ({found}): DDS delivers each request to"
                " all servers, and some would decode it wrongly, so it was not sent"
            )
            return Obstacle(reason, vendors.CURE)
        return None

    def _of_server(self, server: Endpoint) -> str | None:
        """Return the version of an endpoint, or the hash of an unknown one; None if it is not discovered yet."""
        if not self.varies(server.type):
            return server.type_id or None  # the hash of its requests
        known = self._known(server)
        return server.type_id if known is None and self.is_resolved(server) else known

    def _label(self, type_name: str, version: str) -> str:
        return self._releases.release(type_name, version) or version

    def notes(self, endpoints: Iterable[Endpoint], separated: Collection[str] = ()) -> Notes:
        """Return what is lost in messages of native endpoints with another version, and who decodes messages wrongly.

        Servers that are not called because of their version are named, too.

        Args:
            endpoints: all endpoints of the graph.
            separated: the topics that Midspan publishes in each version of their subscriptions.
        """
        notes: dict[tuple[str, str, str], list[str]] = defaultdict(list)
        readers: dict[tuple[str, str], list[Endpoint]] = defaultdict(list)
        for endpoint in endpoints:
            if endpoint.made_by is not MadeBy.NATIVE:
                continue
            if endpoint.kind is Kind.SUBSCRIPTION:
                readers[endpoint.topic, endpoint.type].append(endpoint)
            if text := self._loss(endpoint) if endpoint.uncalled is None else endpoint.uncalled.reason:
                of = "topic" if endpoint.kind in (Kind.PUBLISHER, Kind.SUBSCRIPTION) else "service"
                direction = "in" if endpoint.kind in (Kind.PUBLISHER, Kind.SERVER) else "out"
                texts = notes[of, direction, endpoint.topic]
                if text not in texts:
                    texts.append(text)
        for topic, text in self._undecodable(readers, separated):
            notes["topic", "out", topic].append(text)
        return notes

    def warnings(
        self, endpoints: Collection[Endpoint], advertised: Mapping[str, str], separated: Collection[str] = ()
    ) -> list[str]:
        """Return the subscriptions that decode messages of Midspan wrongly, and native pairs of two versions.

        Args:
            endpoints: all endpoints of the graph.
            advertised: the types of the topics that Midspan publishes.
            separated: those topics that Midspan publishes in each version of their subscriptions.
        """
        readers: dict[tuple[str, str], list[Endpoint]] = defaultdict(list)
        for endpoint in endpoints:
            if endpoint.kind is Kind.SUBSCRIPTION and endpoint.made_by is MadeBy.NATIVE:
                readers[endpoint.topic, endpoint.type].append(endpoint)
        wanted = {key: ends for key, ends in readers.items() if advertised.get(key[0]) == key[1]}
        warnings = [f"{topic}: {text}" for topic, text in self._undecodable(wanted, separated)]
        return warnings + list(self._native_pairs(endpoints))

    def _native_pairs(self, endpoints: Iterable[Endpoint]) -> Iterator[str]:
        """Yield a warning for each name of which native nodes have different versions of the type."""
        ends: dict[tuple[str, str], dict[Kind, list[Endpoint]]] = defaultdict(lambda: defaultdict(list))
        for end in endpoints:
            if end.made_by is MadeBy.NATIVE and self.varies(end.type):
                ends[end.topic, end.type][end.kind].append(end)
        for (name, type_name), kinds in sorted(ends.items()):
            for senders, receivers in ((Kind.PUBLISHER, Kind.SUBSCRIPTION), (Kind.CLIENT, Kind.SERVER)):
                versions = [{self._of_server(end) for end in kinds[kind]} - {None} for kind in (senders, receivers)]
                if any(sent != received for sent in versions[0] for received in versions[1]):
                    nodes = self._versions_of_nodes(type_name, [*kinds[senders], *kinds[receivers]])
                    yield (
                        f"{name}: native nodes have different versions of {type_name} ({nodes}), and decode each"
                        " other's messages wrongly, because DDS delivers them unconverted; use one version for both,"
                        " or two domains, each with a Midspan daemon"
                    )

    def _loss(self, endpoint: Endpoint) -> str:
        name, version = endpoint.type, endpoint.type_id
        if not self._differs(name, version):
            return ""
        whose = f"{endpoint.node or 'a node'} has {self._label(name, version)}'s version"
        return loss_text(self._releases, _KINDS[endpoint.kind], name, version, whose)

    def _undecodable(
        self, readers: Mapping[tuple[str, str], list[Endpoint]], separated: Collection[str]
    ) -> Iterable[tuple[str, str]]:
        for (topic, type_name), ends in readers.items():
            here = self._releases.here_hash(type_name)
            if not here or (all(end.type_id in (here, NO_HASH) for end in ends) and not self.varies(type_name)):
                continue
            if topic in separated:
                sent, decoded = here, {here, *self.others(type_name, here)}
            else:
                sent = self.for_readers(here, ends)
                decoded = {sent}
            wrong = sorted({
                f"{end.node or 'a node'} ({self._label(type_name, end.type_id)})"
                for end in ends
                if self._known(end) not in decoded
            })  # fmt: skip
            if wrong:
                decodes = "decodes" if len(wrong) == 1 else "decode"
                yield (
                    topic,
                    (
                        f"{', '.join(wrong)} {decodes} it wrongly: it is sent as {type_name} of"
                        f" {self._label(type_name, sent)}, and DDS delivers it to all subscriptions; {_CURE}"
                    ),
                )

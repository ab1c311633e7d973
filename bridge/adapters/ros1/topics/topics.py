"""The topics of a ROS 1 graph: native publishers and subscribers, and Midspan's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

from typing_extensions import override

from bridge.adapters.ros1.graph.probe import EndUpdater, Facts, Ros1Context
from bridge.adapters.ros1.graph.state import MasterState, Registration, publisher_id
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.transcode.conversion import SideType
from bridge.routing.edge import Deliver, Endpoint, Kind, MadeBy

if TYPE_CHECKING:
    from bridge.adapters.ros1.topics.publisher import Ros1Publisher
    from bridge.adapters.ros1.topics.subscription import Ros1Subscription

_VOLATILE = Qos()


class Ros1Topics(EndUpdater["Ros1Subscription"]):
    """The topics of one edge; ``refused(topic, reason, why)`` reports a message that is not delivered."""

    def __init__(self, context: Ros1Context, refused: Callable[[str, str, str], None]) -> None:
        super().__init__(context, holds=True)
        self._refused = refused

    def endpoints(self, state: MasterState) -> Iterator[Endpoint]:
        """Yield the other nodes' publishers and subscriptions."""
        node, facts = self._context.node(), self.prober.facts()
        for link in state.publishers:
            if link.node != node:
                yield _publisher(link, state, facts.get(link))
        midspans = {entry.get("node") for entry in state.presence.values()}
        for link in state.subscribers:
            if link.node != node:
                yield _subscriber(link, state, midspan=link.node in midspans)

    def connected(self) -> frozenset[Registration]:
        """Return the publishers to which a subscription is connected."""
        return frozenset(link for end in self._current_ends() for link in end.connected)

    def warnings(self) -> Iterator[str]:
        """Yield publishers that do not announce their type."""
        for link, failure in sorted(self.prober.failures().items()):
            yield f"{link.topic}: its publisher {link.node} does not announce its type: {failure}"

    def subscribe(
        self, topic: str, side_type: SideType, deliver: Deliver, suffix: str = "", *, fresh: bool = False,
        settle: bool = True,
    ) -> Ros1Subscription:  # fmt: skip
        """Subscribe to the native publishers of a topic with this type, under this node's name plus ``suffix``.

        ``fresh``: do not deliver messages from before the subscription, as commands require.
        ``settle``: leave a new publisher unread until the other sides have created their endpoints of the topic.
        """
        from bridge.adapters.ros1.topics.subscription import SETTLE_SECONDS, Ros1Subscription

        plain = not suffix  # the prober's connections use the node's plain name
        take = self.prober.take if plain and not fresh else self.prober.discard if plain else lambda _: None
        refused = partial(self._refused, topic)
        return self._add(Ros1Subscription(
            self._context, self.prober, topic, side_type.type_id, deliver, suffix, take, refused, self._remove,
            settle=SETTLE_SECONDS if settle else 0.0,
        ))  # fmt: skip

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> Ros1Publisher:
        """Publish on a topic."""
        from bridge.adapters.ros1.topics.publisher import Ros1Publisher

        return Ros1Publisher(self._context.book, topic, side_type, qos)

    @override
    def _notify(self, end: Ros1Subscription, known: Mapping[Registration, Facts]) -> None:
        end.follow(known)


def _publisher(link: Registration, state: MasterState, facts: Facts | None) -> Endpoint:
    if facts is None:
        type_, qos, made_by, md5, definition = state.types.get(link.topic, ""), _VOLATILE, MadeBy.UNKNOWN, "", ""
    else:
        type_, md5, definition = facts.type, facts.md5, facts.definition
        qos = LATCHED if facts.latching else _VOLATILE
        made_by = MadeBy.NATIVE if facts.native else MadeBy.MIDSPAN
    name = publisher_id(link, latching=qos.latched)
    return Endpoint(name, Kind.PUBLISHER, link.topic, type_, qos, made_by, link.node, md5, definition)


def _subscriber(link: Registration, state: MasterState, *, midspan: bool) -> Endpoint:
    name = f"subscription {link.topic} {link.node} {link.uri}"
    type_ = state.types.get(link.topic, "").replace("*", "")
    made_by = MadeBy.MIDSPAN if midspan else MadeBy.NATIVE
    return Endpoint(name, Kind.SUBSCRIPTION, link.topic, type_, _VOLATILE, made_by, link.node)

"""A bridge on the network receives Midspan's tokens of the ros2dds dialect."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from bridge.adapters.zenoh.ros2dds_graph import TokenAnnouncer
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.routing.edge import Kind
from tests.adapters.zenoh.conftest import Place
from tests.peers.zenoh.actions import ACTION
from tests.peers.zenoh.programs import Ros2ddsBridge, open_session
from tests.support.wait import until

SERVICES = {"send_goal": f"{ACTION}_SendGoal", "cancel_goal": "action_msgs/srv/CancelGoal"}
RESULT = {"get_result": f"{ACTION}_GetResult"}
TOPICS = {"feedback": f"{ACTION}_FeedbackMessage", "status": "action_msgs/msg/GoalStatusArray"}
END = "the/end"
"""A topic that is announced last, because tokens of one session arrive in order.

They may not while zenoh links the two sessions directly, because the router still forwards some of them.
"""


class Tokens:
    """An announcer's tokens, and those that a bridge has received."""

    def __init__(self, announcer: TokenAnnouncer, bridge: Ros2ddsBridge) -> None:
        self.announcer, self.bridge, self.registry = announcer, bridge, Registry()
        self.withdraw: dict[str, Callable[[], None]] = {}

    def announce(self, kind: Kind, parts: dict[str, str]) -> None:
        for part, type_ in parts.items():
            known = self.registry.ros2(type_) if part in TOPICS else self.registry.service_ros2(type_)
            self.withdraw[part] = self.announcer.announce(kind, f"lookup/_action/{part}", known, Qos())

    def tokens(self, letters: str) -> int:
        """Return how many of the action's tokens with these letters the bridge has received."""
        end = self.announcer.announce(Kind.PUBLISHER, END, self.registry.ros2("std_msgs/msg/Empty"), Qos())
        until(lambda: self.bridge.tokens(f"/{END}"), "all tokens have arrived")
        result = len(self.bridge.tokens("/lookup", letters))
        end()
        until(lambda: not self.bridge.tokens(f"/{END}"), "the last token is withdrawn")
        return result


@pytest.fixture
def announced(place: Place) -> Iterator[Tokens]:
    with open_session(place.router.endpoint) as session:
        announcer = TokenAnnouncer(session)
        yield Tokens(announcer, place.ros2dds())
        announcer.close()


def test_an_action_server_is_announced_once_it_is_complete(announced: Tokens) -> None:
    announced.announce(Kind.SERVER, SERVICES | RESULT)
    assert announced.tokens("AS") == 0, "no announcement, because a client that sends a goal now would miss feedback"
    announced.announce(Kind.PUBLISHER, TOPICS)
    until(lambda: announced.tokens("AS") == 1, "the server is announced")
    for part in ("feedback", "status", "send_goal"):
        announced.withdraw[part]()
    assert announced.tokens("AS") == 1, "results are still available"
    announced.withdraw["cancel_goal"]()
    announced.withdraw["get_result"]()
    until(lambda: announced.tokens("AS") == 0, "the announcement is withdrawn")
    assert not [t for t in announced.bridge.all_tokens() if "_action" in t], "no part has a separate token"


def test_an_action_client_is_announced_with_its_goals_or_results(announced: Tokens) -> None:
    announced.announce(Kind.SUBSCRIPTION, TOPICS)
    assert announced.tokens("AC") == 0
    announced.announce(Kind.CLIENT, RESULT)
    until(lambda: announced.tokens("AC") == 1, "the client is announced")
    announced.withdraw["get_result"]()
    until(lambda: announced.tokens("AC") == 0, "the announcement is withdrawn")

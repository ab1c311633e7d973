"""The publications of the ROS 1 node, which several publishers of a topic share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.topics.book import TopicBook
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry


@pytest.fixture
def book() -> Iterator[TopicBook]:
    loop = ConnectionLoop()
    yield TopicBook(loop, lambda: "/midspan", "", lambda: None, lambda: None)
    loop.stop()


@pytest.mark.parametrize(
    ("first", "second", "text"),
    [
        (None, 0.5, "published on ROS 1 for messages that are queued, so it cannot also be for commands"),
        (0.5, None, "published on ROS 1 for commands, which are not queued, so it cannot also be for messages"),
    ],
)
def test_commands_share_no_publication_with_other_messages(
    book: TopicBook, first: float | None, second: float | None, text: str
) -> None:
    """They would wait in its queues, or other messages would be dropped as late commands."""
    twist = Registry().ros1("geometry_msgs/Twist")
    publication = book.publish("/cmd_vel", twist, latched=False, lifespan=first)
    with pytest.raises(MessageTypeError, match=text) as refusal:
        book.publish("/cmd_vel", twist, latched=False, lifespan=second)
    assert refusal.value.cure == "set `priority: command` in the rules of both topics, or rename one of the two"
    assert book.publish("/cmd_vel", twist, latched=False, lifespan=first) is publication
    for _ in range(2):
        book.unpublish(publication, latched=False)
    assert book.publish("/cmd_vel", twist, latched=False, lifespan=second).lifespan == second

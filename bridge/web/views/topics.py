"""The view Topics: topics with their messages and images, and services."""

from __future__ import annotations

from bridge.web.feeds.hub import PolledFeed, list_topics
from bridge.web.feeds.images import ImageFeed
from bridge.web.feeds.topics import MessageFeed
from bridge.web.verbs.sending import Sending, list_services, sending_verbs
from bridge.web.views import Offer, Parts, View


def offer(parts: Parts) -> Offer:
    """Return the lists, the feed of each topic, and the verbs of forms."""
    host, client, types, decoding = parts.host, parts.client, parts.types, parts.decoding
    sending = Sending(host, parts.config, client, types)
    return Offer(
        feeds=[
            PolledFeed(host, "topics", parts.asking, lambda: list_topics(client)),
            PolledFeed(host, "services", parts.asking, lambda: list_services(client)),
        ],
        factories={
            "topic:/": lambda name: MessageFeed(host, types, decoding, name),
            "image:": lambda name: ImageFeed(host, types, decoding, name),
        },
        verbs=sending_verbs(sending, types),
        closing=[sending.close],
    )


VIEW = View(name="topics", label="Topics", icon='<path d="M4 6h16M4 12h10M4 18h13"/>', offer=offer)

"""The view Status: the network, workers and routes."""

from __future__ import annotations

from bridge.web.feeds.hub import PolledFeed, StatusPoller
from bridge.web.views import Offer, Parts, View


def offer(parts: Parts) -> Offer:
    """Return the feed of all workers and routes."""
    return Offer(feeds=[PolledFeed(parts.host, "status", parts.asking, StatusPoller(parts.client))])


VIEW = View(name="status", label="Status", icon='<path d="M3 13h4l3-8 4 14 3-6h4"/>', offer=offer)

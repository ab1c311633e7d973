"""The view System: the log, the doctor, the configuration."""

from __future__ import annotations

from bridge.web.feeds.hub import PolledFeed
from bridge.web.sources.log import LOG_SECONDS, LogFollower
from bridge.web.verbs.inspection import inspection_verbs
from bridge.web.views import Offer, Parts, View


def offer(parts: Parts) -> Offer:
    """Return the feed that announces lines of the log, and the verbs that inspect the daemon."""
    log = LogFollower(parts.config)
    return Offer(
        feeds=[PolledFeed(parts.host, "log", parts.asking, log.ask, LOG_SECONDS)],
        verbs=inspection_verbs(parts.client, log),
    )


VIEW = View(name="system", label="System", icon='<path d="M5 3h10l4 4v14H5zM9 11h6M9 15h6M9 7h3"/>', offer=offer)

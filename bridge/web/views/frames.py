"""The view Frames: the tree of frames, and the pose of one frame in another."""

from __future__ import annotations

from bridge.web.feeds.frames import FramePoseFeed, FramesFeed
from bridge.web.views import Offer, Parts, View


def offer(parts: Parts) -> Offer:
    """Return the feeds of the frames and their poses."""
    host, follower = parts.host, parts.follower
    return Offer(
        feeds=[FramesFeed(host, follower)], factories={"pose:": lambda name: FramePoseFeed(host, follower, name)}
    )


VIEW = View(
    name="frames",
    label="Frames",
    icon='<path d="M5 4v14a2 2 0 0 0 2 2h5M5 11h7"/><circle cx="16" cy="11" r="2.5"/><circle cx="16" cy="20" r="2.5"/>',
    offer=offer,
)

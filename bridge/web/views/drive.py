"""The view Drive: the robot on its map, goals, patrols, manual driving."""

from __future__ import annotations

from bridge.web.feeds.layers import LayerFeed
from bridge.web.feeds.maps import MapFeed
from bridge.web.feeds.obstacles import ObstaclesFeed
from bridge.web.feeds.robot import LaserFeed, PathFeed, RobotFeed, disc
from bridge.web.feeds.robots import RobotsFeed
from bridge.web.section import WebSection
from bridge.web.verbs.paint import Painter
from bridge.web.views import Offer, Parts, View


def offer(parts: Parts) -> Offer:
    """Return the feeds of the map, and the verb that paints on it; the console has the verbs that drive."""
    host, config, follower, driving = parts.host, parts.config, parts.follower, parts.driving
    section = config.section(WebSection)
    map_feed = MapFeed(host, config, parts.store, parts.pictures)
    return Offer(
        feeds=[
            RobotFeed(host, follower, section.footprint or disc(section.radius)),
            RobotsFeed(host, follower, section.robots),
            LaserFeed(host, follower, section.laser),
            PathFeed(host, config, driving),
            ObstaclesFeed(host, config, follower, driving),
            LayerFeed(host, follower, section.layer),
            map_feed,
        ],
        verbs=Painter(*parts.store.writing).verbs(),
        closing=[map_feed.end],
    )


VIEW = View(name="drive", label="Drive", icon='<path d="M12 3l7 17-7-4-7 4z"/>', offer=offer)

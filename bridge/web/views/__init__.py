"""The views of the page, each described by a `View` in a module of this package; see docs/develop/add_a_view.md.

A package outside this tree registers a view as `bridge.registration` describes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from bridge.client.session import Client
from bridge.client.types import Types
from bridge.concurrency import SerialExecutor
from bridge.config.model import Config
from bridge.modules.host import Host
from bridge.registration import imported, registered
from bridge.web.feeds.feed import Feed, Make
from bridge.web.feeds.frames import FrameFollower
from bridge.web.feeds.map_pictures import Pictures
from bridge.web.feeds.maps import StoreFollower
from bridge.web.feeds.robot import DrivingFeed
from bridge.web.serving.page_files import Tab
from bridge.web.verbs.verbs import PageVerb

VIEWS = (
    "bridge.web.views.drive:VIEW",
    "bridge.web.views.places:VIEW",
    "bridge.web.views.status:VIEW",
    "bridge.web.views.topics:VIEW",
    "bridge.web.views.frames:VIEW",
    "bridge.web.views.system:VIEW",
)
"""The views that come with Midspan, in the order of their tabs."""


@dataclass(frozen=True, slots=True)
class Parts:
    """The objects that the views of a console share.

    Attributes:
        host: the console's node, thread and clock.
        client: queries the hub; it blocks, so use it only on the thread of ``asking`` and in verbs.
        types: the message types that the console knows.
        follower: the transforms.
        store: the maps and places.
        driving: the state of the gateway.
        pictures: images for the page.
        asking: a thread for queries.
        decoding: a thread that decodes messages.
    """

    host: Host
    config: Config
    client: Client
    types: Types
    follower: FrameFollower
    store: StoreFollower
    driving: DrivingFeed
    pictures: Pictures
    asking: SerialExecutor
    decoding: SerialExecutor


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """What a view adds to the console.

    Attributes:
        feeds: what pages may watch.
        factories: functions that create a feed from its name, by the name's prefix.
        verbs: what pages may call, by name.
        closing: functions that run when the console closes.
    """

    feeds: Sequence[Feed] = ()
    factories: Mapping[str, Make] = field(default_factory=dict)
    verbs: Mapping[str, PageVerb] = field(default_factory=dict)
    closing: Sequence[Callable[[], None]] = ()


def _nothing(_parts: Parts) -> Offer:
    return Offer()


@dataclass(frozen=True, slots=True, kw_only=True)
class View(Tab):
    """A view: its tab, its files, and what it adds to the console.

    Attributes:
        offer: creates the view's feeds and verbs, once per console.
    """

    offer: Callable[[Parts], Offer] = _nothing


def all_views() -> tuple[View, ...]:
    """Return all views, in the order of their tabs."""
    built_in: tuple[View, ...] = tuple(map(imported, VIEWS))
    return (*built_in, *registered(View, "view", (view.name for view in built_in)))

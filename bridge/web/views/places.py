"""The view Places: the maps and places of the store."""

from __future__ import annotations

from bridge.web.feeds.maps import StoreFeed
from bridge.web.verbs.map_files import MapFileVerbs
from bridge.web.verbs.places import PlaceVerbs
from bridge.web.views import Offer, Parts, View


def offer(parts: Parts) -> Offer:
    """Return the feeds of the store, and the verbs that change it."""
    store = parts.store
    return Offer(
        feeds=[
            StoreFeed("maps", store, lambda view: view.maps),
            StoreFeed("places", store, lambda view: view.places),
        ],
        verbs={**PlaceVerbs(*store.writing).verbs(), **MapFileVerbs(*store.writing).verbs()},
    )


VIEW = View(
    name="places",
    label="Places",
    icon='<path d="M12 21s-7-6.5-7-11.5a7 7 0 0 1 14 0C19 14.5 12 21 12 21z"/><circle cx="12" cy="9.5" r="2.5"/>',
    offer=offer,
)

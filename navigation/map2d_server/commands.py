"""Words for a person at ``yarp rpc``: which map is current, and to choose another."""

from __future__ import annotations

from typing import Any

from bridge.stores.errors import StoreError
from bridge.stores.kinds import MAP
from bridge.stores.store import Store
from navigation.map2d_server.outlets import CurrentMap
from yarp_compat.wire.values import Vocab

_HELP = ["current: the name of the current map", "use NAME: make a map of the store the current one", "maps: all names"]


class MapCommands:
    """Answers a Bottle of words; what it raises is the answer ``[fail]`` with the text."""

    def __init__(self, store: Store, current: CurrentMap) -> None:
        self._store, self._current = store, current

    def answer(self, words: list[Any]) -> list[Any]:
        """The answer to some words."""
        match [str(word) for word in words]:
            case ["current"]:
                return [self._current.choose()]
            case ["maps"]:
                return list(self._store.names(MAP))
            case ["use", name]:
                self._use(name)
                return [Vocab("ok")]
            case _:
                return [Vocab("many"), *_HELP]

    def _use(self, name: str) -> None:
        try:
            self._store.use_map(name)
        except StoreError as error:
            raise ValueError(str(error)) from error

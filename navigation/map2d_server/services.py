"""The services of map servers: those of ROS 1's map_server, and of nav2_map_server's map_server and map_saver."""

from __future__ import annotations

from collections.abc import Callable

from bridge.hub.endpoints.calls import CallError
from bridge.modules.host import Node
from bridge.modules.services import Answer
from bridge.stores.entry import StoreError
from bridge.stores.kinds import MAP
from bridge.stores.store import Store
from navigation.map2d_server.files import MapFiles
from navigation.map2d_server.publishers import MAP_TOPIC, AllMaps, CurrentMap
from navigation.maps.grid import turned
from navigation.messages import Message
from yarp_compat.dev.mapgrid import MapGrid2D

_SUCCESS, _NOT_THERE, _INVALID = 0, 1, 2
"""``result`` of LoadMap (`nav2_msgs/srv/LoadMap.srv`); ROS 1's knows the same numbers."""


class MapServices:
    """Serves the current map, and changes it; clients load from and save to ``files``."""

    def __init__(
        self, node: Node, store: Store, files: MapFiles, current: CurrentMap, maps: AllMaps, told: Callable[[str], None]
    ) -> None:
        self._store, self._files, self._current, self._maps = store, files, current, maps
        self._told = told
        node.server("/static_map", "nav_msgs/srv/GetMap", self._static_map)
        node.server("/map_server/map", "nav_msgs/srv/GetMap", self._get)
        node.server("/change_map", "nav_msgs/srv/LoadMap", self._load)
        node.server("/map_server/load_map", "nav2_msgs/srv/LoadMap", self._load)
        node.server("/map_saver/save_map", "nav2_msgs/srv/SaveMap", self._save)

    def _static_map(self, _request: Message, answer: Answer) -> None:
        message = self._current.message()
        answer(CallError("no map is current; choose one of the store") if message is None else {"map": message})

    def _get(self, _request: Message, answer: Answer) -> None:
        # a ROS 2 client would wait for ever for an answer to a call that failed
        message = self._current.message()
        answer({} if message is None else {"map": message})

    def _load(self, request: Message, answer: Answer) -> None:
        try:
            grid = self._used(str(request["map_url"]))
        except FileNotFoundError as error:
            self._told(f"LoadMap: {error}")
            answer({"result": _NOT_THERE})
        except (StoreError, ValueError, OSError) as error:
            self._told(f"LoadMap: {error}")
            answer({"result": _INVALID})
        else:
            answer({"map": self._current.message_of(grid), "result": _SUCCESS})

    def _used(self, wanted: str) -> MapGrid2D:
        """The map that a client wants, made the current one: one of the store, or of a file that is loaded now."""
        stored = self._store.get(MAP, wanted) if wanted in self._store.names(MAP) else None
        grid = self._files.load_map(wanted) if stored is None else stored
        self._store.use_map(grid.name)
        return turned(grid)

    def _save(self, request: Message, answer: Answer) -> None:
        try:
            topic = f"/{str(request['map_topic']).lstrip('/') or 'map'}"
            self._files.save_map(
                self._of_topic(topic),
                str(request["map_url"]),
                image=str(request["image_format"]),
                mode=str(request["map_mode"]),
                thresholds=(float(request["free_thresh"]), float(request["occupied_thresh"])),
            )
        except (StoreError, ValueError, OSError) as error:
            self._told(f"SaveMap: {error}")
            answer({"result": False})
        else:
            answer({"result": True})

    def _of_topic(self, topic: str) -> str:
        names = {other: name for name, other in self._maps.topics.items()} | {MAP_TOPIC: self._current.name}
        if not names.get(topic):
            raise ValueError(f"{topic} is none of the store's maps; those are {', '.join(sorted(names))}")
        return names[topic]

"""A map server's maps and places as Python's mappings: each operation is a call of the server."""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping
from typing import Any, Generic, TypeVar, cast

from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode, ReturnValue

T = TypeVar("T")


class Maps(MutableMapping[str, MapGrid2D]):
    """Maps by name: ``maps["office"]``. Names in a list come at once, a map when it is asked for.

    All raise `CallFailed` where the server refuses, `ConnectionError` and `TimeoutError` where it is away.
    """

    def __init__(self, remote: IMap2DMsgs) -> None:
        self._remote = remote

    def __getitem__(self, name: str) -> MapGrid2D:
        outcome, found = self._remote.get_map_RPC(name)
        return _there(outcome, name, found)

    def __setitem__(self, name: str, value: MapGrid2D) -> None:
        """Keep a map; it has its name in itself, so another one is an error."""
        if value.name != name:
            raise ValueError(f"the map's own name is {value.name!r}, not {name!r}")
        succeeded(self._remote.store_map_RPC(value))

    def __delitem__(self, name: str) -> None:
        _there(self._remote.remove_map_RPC(name), name, None)

    def __iter__(self) -> Iterator[str]:
        outcome, names = self._remote.get_map_names_RPC()
        succeeded(outcome)
        return iter(names)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def clear(self) -> None:
        """Forget all maps."""
        succeeded(self._remote.clear_all_maps_RPC())

    def clear_temporary_flags(self, name: str | None = None) -> None:
        """Take what is temporary out of a map, or of all."""
        if name is None:
            succeeded(self._remote.clear_all_maps_temporary_flags_RPC())
        else:
            _there(self._remote.clear_map_temporary_flags_RPC(name), name, None)

    def compress(self, enable: bool) -> None:
        """Have the server send maps compressed, or not."""
        succeeded(self._remote.enable_maps_compression_RPC(enable))

    def save(self, name: str, file_name: str) -> None:
        """Have the server write a map into a file of its own."""
        succeeded(self._remote.save_map_to_disk_RPC(name, file_name))

    def load(self, file_name: str) -> None:
        """Have the server read a map from a file of its own."""
        succeeded(self._remote.load_map_from_disk_RPC(file_name))

    def save_collection(self, file_name: str) -> None:
        """Have the server write all maps, and their list."""
        succeeded(self._remote.save_maps_collection_RPC(file_name))

    def load_collection(self, file_name: str) -> None:
        """Have the server read the maps of such a list."""
        succeeded(self._remote.load_maps_collection_RPC(file_name))

    def reload(self) -> None:
        """Have the server read the collection of its start again."""
        succeeded(self._remote.reload_maps_collection_RPC())


class Places(MutableMapping[str, T], Generic[T]):
    """Things of one kind by name: ``locations["kitchen"] = Map2DLocation("office", 1.0, 2.0, 90.0)``.

    Args:
        remote: the server.
        kind: ``object``, ``location``, ``area`` or ``path``.
    """

    def __init__(self, remote: IMap2DMsgs, kind: str) -> None:
        self._kind = kind
        self._call: Callable[[str], Callable[..., Any]] = lambda name: cast(
            "Callable[..., Any]", getattr(remote, f"{name}_RPC")
        )

    def __getitem__(self, name: str) -> T:
        outcome, found = self._call(f"get_{self._kind}")(name)
        return cast("T", _there(outcome, name, found))

    def __setitem__(self, name: str, value: T) -> None:
        succeeded(self._call(f"store_{self._kind}")(name, value))

    def __delitem__(self, name: str) -> None:
        _there(self._call(f"delete_{self._kind}")(name), name, None)

    def __iter__(self) -> Iterator[str]:
        outcome, names = self._call(f"get_{self._kind}s_list")()
        succeeded(outcome)
        return iter(names)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def everything(self) -> list[T]:
        """All of them in one call, in the order of their names."""
        outcome, found = self._call(f"get_all_{self._kind}s")()
        succeeded(outcome)
        return cast("list[T]", found)

    def rename(self, old: str, new: str) -> None:
        """Give one another name; raises `KeyError` where the old is not there, or the new one is."""
        _there(self._call(f"rename_{self._kind}")(old, new), old, None)

    def clear(self) -> None:
        """Forget all."""
        succeeded(self._call(f"clear_all_{self._kind}s")())


def succeeded(outcome: ReturnValue) -> None:
    """Raise `CallFailed` where a call did not succeed."""
    if not outcome:
        raise CallFailed(outcome.code, "the map server refused; its log says why")


def _there(outcome: ReturnValue, name: str, found: T) -> T:
    if outcome.code is ReturnCode.METHOD_FAILED:
        raise KeyError(name)
    succeeded(outcome)
    return found

"""A client of the store: reads and writes the replica of one daemon, over the hub."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from bridge.hub.endpoints.keyspace import KeySpace
from bridge.hub.errors import HubError
from bridge.hub.wire.version import WIRE
from bridge.stores.entry import StoreError, check_name, json_object
from bridge.stores.kinds import CURRENT, MAP, ValueKind
from bridge.stores.store import THE_MAP, Write, rename_writes
from bridge.stores.wire import check_wire, key_of, prefix

if TYPE_CHECKING:
    from bridge.client.session import Client

T = TypeVar("T")

_SECONDS = 10.0
_FIND_SECONDS = 2.0
_FIND_PERIOD = 0.05
_TRIES = 8
_ALIVE = "@sync/alive/*/*"


class StoreClient:
    """Reads and writes one replica, preferably ``daemon``'s; raises `StoreError` if none is on the hub within 2 s."""

    def __init__(self, space: KeySpace, daemon: str) -> None:
        self._space = space
        end = time.monotonic() + _FIND_SECONDS  # the daemon may have just started
        while not (tokens := space.tokens(_ALIVE)) and time.monotonic() < end:
            time.sleep(_FIND_PERIOD)
        copies = sorted((name != daemon, name, zid) for _, _, zid, name in (token.split("/", 3) for token in tokens))
        if not copies:
            raise StoreError(
                "no daemon on the hub has a store; set store.enabled to true in its configuration; if it is set,"
                " 'midspan status' reports why the store is not open"
            )
        _, self.daemon, self._zid = copies[0]

    @property
    def present(self) -> bool:
        """Whether the replica is on the hub; after a restart of its daemon, it has another session."""
        return bool(self._space.tokens(f"@sync/alive/{self._zid}/*"))

    def keys(self) -> set[tuple[str, str]]:
        """Return kind and name of every value."""
        return {(kind, name) for kind, name, _, _, size in self.digest() if size}

    def digest(self) -> list[list[Any]]:
        """Return kind, name, time, replica and size (0 if deleted) of every key, to compare with a later digest."""
        reply = json_object(self._ask("digest", "", json.dumps({"wire": WIRE}).encode())[0].body or b"{}")
        check_wire(reply)
        entries: list[list[Any]] = reply.get("entries", [])
        return sorted(entries, key=lambda entry: entry[:2])

    def names(self, kind: ValueKind[Any]) -> list[str]:
        """Return the names of a kind's values, sorted."""
        return sorted(name for other, name in self.keys() if other == kind.name)

    def get(self, kind: ValueKind[T], name: str) -> T | None:
        """Return a value, None if it does not exist."""
        return self._fetch(kind, [name] if check_name(name) in self.names(kind) else []).get(name)

    def all(self, kind: ValueKind[T]) -> dict[str, T]:
        """Return all values of a kind, sorted by name."""
        return self._fetch(kind, self.names(kind))

    def write(self, writes: Sequence[Write[Any]]) -> None:
        """Write and delete in one transaction; it is on the daemon's disk when this returns. Raises `StoreError`."""
        self._write(writes, {})

    def change(self, make: Callable[[], Sequence[Write[Any]]]) -> None:
        """Write what ``make`` returns, which it derives from the store's current content; raises `StoreError`.

        If another client changed one of the keys meanwhile, nothing is written and ``make`` is called again, up to 8
        times in all, so that no change is lost.
        """
        for _ in range(_TRIES):
            known = {f"{kind}/{name}": [ns, replica] for kind, name, ns, replica, _ in self.digest()}
            writes = make()
            keys = [f"{write.kind.name}/{write.name}" for write in writes]
            if not writes or self._write(writes, {key: known.get(key) for key in keys}):
                return
        raise StoreError("other clients keep changing the same keys; try again")

    def rename(self, kind: ValueKind[Any], old: str, new: str) -> None:
        """Rename a value; raises `StoreError` if the old name does not exist or the new one does."""
        self.change(lambda: rename_writes(self, kind, old, new))

    def _write(self, writes: Sequence[Write[Any]], stamps: Mapping[str, list[Any] | None]) -> bool:
        """Write; return False, without writing, if a key's stamp differs from ``stamps``."""
        bodies: list[bytes] = []
        heads: list[Mapping[str, Any]] = []
        for write in writes:
            key = f"{write.kind.name}/{check_name(write.name)}"
            if write.value is None:
                heads.append({"key": key, "size": None})
            else:
                bodies.append(write.kind.encode(write.name, write.value)[0])
                heads.append({"key": key, "size": len(bodies[-1])})
        head = json.dumps({"wire": WIRE, "writes": heads, **({"stamps": stamps} if stamps else {})}).encode()
        reply = self._ask("write", "", b"\n".join((head, b"".join(bodies))))[0].body
        return not json_object(reply or b"{}").get("stale")

    def current_map(self) -> str:
        """Return the name of the current map, "" if none was chosen."""
        return self.get(CURRENT, THE_MAP) or ""

    def use_map(self, name: str) -> None:
        """Choose the current map; raises `StoreError` if no map has that name."""
        names = self.names(MAP)
        if name not in names:
            raise StoreError(f"no map {name!r}; existing maps: {', '.join(names) or 'none'}")
        self.write([Write(CURRENT, THE_MAP, name)])

    def _fetch(self, kind: ValueKind[T], names: Sequence[str]) -> dict[str, T]:
        if not names:
            return {}
        keys = json.dumps({"wire": WIRE, "keys": [f"{kind.name}/{name}" for name in names]}).encode()
        values: dict[str, T] = {}
        under = f"@sync/fetch/{self._zid}/"
        for item in self._ask("fetch", "/**", keys):
            if item.body is not None:
                _, name = key_of(item.key.removeprefix(under))
                values[name] = kind.decode(name, item.body)
        return dict(sorted(values.items()))

    def _ask(self, verb: str, rest: str, body: bytes) -> list[Any]:
        try:
            answers = self._space.ask(f"@sync/{verb}/{self._zid}{rest}", body, _SECONDS)
        except HubError as err:
            raise StoreError(str(err)) from None
        if not answers:
            refused = "access between the machines may be denied (hub.open.trusted)"
            raise StoreError(f"the store of {self.daemon} did not answer; {refused}")
        return answers


def open_store(client: Client) -> StoreClient:
    """Return the store of the client's daemon, or else of another daemon; raises `StoreError` if the hub has none."""
    return StoreClient(client.hub.keyspace(prefix(client.config.hub.domain)), client.config.name)

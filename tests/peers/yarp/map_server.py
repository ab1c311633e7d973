"""A minimal map server that uses dictionaries."""

from __future__ import annotations

from typing import Any

from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.returnvalue import OK, CallFailed


class KeptMaps(IMap2DMsgs):
    """A map server that stores maps and places, and records the arguments of file methods in ``files``."""

    def __init__(self) -> None:
        super().__init__()
        self.kept: dict[str, dict[str, Any]] = {kind: {} for kind in ("map", "object", "location", "area", "path")}
        self.files: list[tuple[str, ...]] = []

    def __getattribute__(self, name: str) -> Any:
        if not name.endswith("_RPC"):
            return super().__getattribute__(name)
        parts = name.removesuffix("_RPC").split("_")
        kind = next((kind for kind in self.kept if kind in parts or f"{kind}s" in parts), "")
        if parts[0] in ("save", "load", "reload", "enable"):
            return lambda *arguments: self.filed(name, *arguments)
        verb = f"{parts[0]}_all" if "all" in parts else "names" if parts[-1] in ("list", "names") else parts[0]
        return lambda *arguments: getattr(self, verb)(self.kept[kind], *arguments)

    def filed(self, *arguments: Any) -> Any:
        self.files.append(arguments)
        return OK

    def store(self, kept: dict[str, Any], *arguments: Any) -> Any:
        kept[arguments[0] if len(arguments) == 2 else arguments[0].name] = arguments[-1]
        return OK

    def get(self, kept: dict[str, Any], name: str) -> Any:
        return OK, self.existing(kept, name)

    def names(self, kept: dict[str, Any]) -> Any:
        return OK, sorted(kept)

    def get_all(self, kept: dict[str, Any]) -> Any:
        return OK, [kept[name] for name in sorted(kept)]

    def rename(self, kept: dict[str, Any], old: str, new: str) -> Any:
        self.existing(kept, old)
        if new in kept:
            raise CallFailed(reason=f"{new} exists")
        kept[new] = kept.pop(old)
        return OK

    def delete(self, kept: dict[str, Any], name: str) -> Any:
        self.existing(kept, name)
        del kept[name]
        return OK

    remove = delete

    def clear(self, kept: dict[str, Any], name: str) -> Any:
        self.existing(kept, name).clearMapTemporaryFlags()
        return OK

    def clear_all(self, kept: dict[str, Any]) -> Any:
        kept.clear()
        return OK

    def existing(self, kept: dict[str, Any], name: str) -> Any:
        if name not in kept:
            raise CallFailed(reason=f"no {name}")
        return kept[name]

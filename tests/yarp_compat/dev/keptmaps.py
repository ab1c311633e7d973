"""A map server that keeps all in dictionaries, as simply as can be."""

from __future__ import annotations

from typing import Any

from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.returnvalue import OK, CallFailed


class KeptMaps(IMap2DMsgs):
    """Keeps maps and places; what it was asked of files is in ``files``."""

    def __init__(self) -> None:
        super().__init__()
        self.kept: dict[str, dict[str, Any]] = {kind: {} for kind in ("map", "object", "location", "area", "path")}
        self.files: list[tuple[str, ...]] = []

    def __getattribute__(self, name: str) -> Any:
        if not name.endswith("_RPC"):
            return super().__getattribute__(name)
        words = name.removesuffix("_RPC").split("_")
        kind = next((kind for kind in self.kept if kind in words or f"{kind}s" in words), "")
        if words[0] in ("save", "load", "reload", "enable"):
            return lambda *asked: self.filed(name, *asked)
        verb = f"{words[0]}_all" if "all" in words else "names" if words[-1] in ("list", "names") else words[0]
        return lambda *asked: getattr(self, verb)(self.kept[kind], *asked)

    def filed(self, *asked: Any) -> Any:
        self.files.append(asked)
        return OK

    def store(self, kept: dict[str, Any], *asked: Any) -> Any:
        kept[asked[0] if len(asked) == 2 else asked[0].name] = asked[-1]
        return OK

    def get(self, kept: dict[str, Any], name: str) -> Any:
        return OK, self.there(kept, name)

    def names(self, kept: dict[str, Any]) -> Any:
        return OK, sorted(kept)

    def get_all(self, kept: dict[str, Any]) -> Any:
        return OK, [kept[name] for name in sorted(kept)]

    def rename(self, kept: dict[str, Any], old: str, new: str) -> Any:
        self.there(kept, old)
        if new in kept:
            raise CallFailed(reason=f"there is a {new}")
        kept[new] = kept.pop(old)
        return OK

    def delete(self, kept: dict[str, Any], name: str) -> Any:
        self.there(kept, name)
        del kept[name]
        return OK

    remove = delete

    def clear(self, kept: dict[str, Any], name: str) -> Any:
        self.there(kept, name).clearMapTemporaryFlags()
        return OK

    def clear_all(self, kept: dict[str, Any]) -> Any:
        kept.clear()
        return OK

    def there(self, kept: dict[str, Any], name: str) -> Any:
        if name not in kept:
            raise CallFailed(reason=f"there is no {name}")
        return kept[name]

"""The versions of ROS 2 types: those of the releases, and those of the configuration's folders.

A release is a chain of folders: its own, with the definitions that differ from the previous release, then those of the
earlier releases. Types that a chain lacks come from the usual sources. Humble's endpoints announce no hash, so Humble's
versions are not listed by hash.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from threading import Lock

from bridge.messages.definitions.library import DefinitionLibrary
from bridge.messages.definitions.names import is_ros2_name, split_part
from bridge.messages.definitions.schema import Schema, World
from bridge.messages.definitions.sources import (
    DefinitionFolder,
    DefinitionSource,
    find_first,
    jazzy_sources,
    shipped_folder,
)
from bridge.messages.errors import MessageTypeError

RELEASES_FOLDER = Path(__file__).parent / "releases"

_CHAINS = {"jazzy": (), "kilted": ("kilted",), "lyrical": ("lyrical", "kilted")}
"""The folders of each release, the newest first; all releases build on Jazzy."""

INSTALLED = "this machine"
"""Label of a version that neither Midspan nor a configured folder has, only another package on this machine."""

_HASHLESS, _JAZZY = "humble", "jazzy"
_MAX_CACHED = 10_000


def _libraries(rest: Sequence[DefinitionSource]) -> dict[str, DefinitionLibrary]:
    """Return the definitions of each release that announces hashes; ``rest`` has those of Jazzy."""
    return {name: DefinitionLibrary(World.ROS2, [*_folders_of(name), *rest]) for name in _CHAINS}


def _folders_of(release: str) -> list[DefinitionSource]:
    return [shipped_folder(RELEASES_FOLDER / folder) for folder in _CHAINS[release]]


@cache
def _stored() -> frozenset[str]:
    """Return the names of all messages, services and actions in the folders of the releases."""
    return frozenset(f"{path.parts[-3]}/{path.parts[-2]}/{path.stem}" for path in RELEASES_FOLDER.glob("*/*/*/*.*"))


class ReleaseTypes:
    """The types of the releases as Midspan ships them, whatever is installed here. Safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._libraries = _libraries(jazzy_sources())
        self._hashes: dict[str, Mapping[str, str]] = {}

    def with_hash(self, name: str, type_hash: str) -> tuple[str, ...]:
        """Return the releases that have this version of a type; () if the type is the same in all, or unknown."""
        with self._lock:
            hashes = self._hashes.get(name)
            if hashes is None:
                if len(self._hashes) >= _MAX_CACHED:
                    self._hashes.clear()
                hashes = self._hashes[name] = self._hashes_of(name)
        return tuple(release for release, known in hashes.items() if known == type_hash)

    def _hashes_of(self, name: str) -> Mapping[str, str]:
        newest = _find(self._libraries["lyrical"], name)
        if newest is None or not any(split_part(nested)[0] in _stored() for nested in newest.types):
            return {}
        found = ((release, library, _find(library, name)) for release, library in self._libraries.items())
        return {release: library.fingerprint(schema) for release, library, schema in found if schema is not None}


class TypeVersions:
    """All known versions of ROS 2 types. Not thread-safe; the registry holds the lock.

    Args:
        installed: the types that this machine uses.
        folders: the configuration's folders, each of which may have its own version of a package.
        sources: sources of the installed types.
    """

    def __init__(
        self, installed: DefinitionLibrary, folders: Sequence[Path], sources: Sequence[DefinitionSource]
    ) -> None:
        self._installed = installed
        shipped = jazzy_sources()
        rest = [*shipped, *sources]
        self._shipped = {name: [*_folders_of(name), *shipped] for name in _CHAINS}
        own = {str(folder): [DefinitionFolder(folder, World.ROS2), *sources] for folder in folders}
        self._libraries = _libraries(rest) | {name: DefinitionLibrary(World.ROS2, own[name]) for name in own}
        hashless = [shipped_folder(RELEASES_FOLDER / _HASHLESS), *rest]
        self._hashless = DefinitionLibrary(World.ROS2, hashless)
        self._folders = bool(folders)
        self._versions: dict[str, Mapping[str, tuple[str, Schema]]] = {}

    def of(self, name: str) -> Mapping[str, tuple[str, Schema]]:
        """Return the versions of a type by hash, each with the first release or folder that has it, or `INSTALLED`."""
        if name not in self._versions:
            versions: dict[str, tuple[str, Schema]] = {}
            others: dict[str, tuple[str, Schema]] = {}
            for label, library in self._libraries.items() if self._varies(name) else ():
                schema = _find(library, name)
                if schema is not None:
                    has_it = label not in self._shipped or find_first(self._shipped[label], name, World.ROS2)
                    known = versions if has_it else others
                    known.setdefault(library.fingerprint(schema), (label if has_it else INSTALLED, schema))
            self._versions[name] = {**versions, **{key: other for key, other in others.items() if key not in versions}}
        return self._versions[name]

    def hashless(self, name: str) -> Schema | None:
        """Return Humble's version of a type; None if it is the same as Jazzy's."""
        humble = _find(self._hashless, name) if self._varies(name) else None
        jazzy = None if humble is None else _find(self._libraries["jazzy"], name)
        same = humble is None or (jazzy is not None and humble.types == jazzy.types)
        return None if same else humble

    def jazzy(self, name: str) -> Schema | None:
        """Return Jazzy's version of a type that has several versions, None for other types."""
        return next((schema for label, schema in self.of(name).values() if label == _JAZZY), None)

    def _varies(self, name: str) -> bool:
        """Whether a type or one that it nests may have several versions."""
        if not is_ros2_name(name):  # a plain DDS program may announce any name
            return False
        schema = _find(self._installed, name)
        names = (name,) if schema is None else schema.types
        return self._folders or any(split_part(nested)[0] in _stored() for nested in names)


def _find(library: DefinitionLibrary, name: str) -> Schema | None:
    try:
        return library.installed(name)
    except MessageTypeError:  # it nests a type that is missing here
        return None

"""All definitions of one world: those learned from the network or a bag, and those found on this machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from bridge.messages.definitions.hashes import md5_sum, rihs01
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name
from bridge.messages.definitions.parts import is_service, parse_announced
from bridge.messages.definitions.schema import Definition, Schema, World
from bridge.messages.definitions.sources import DefinitionSource, find_first
from bridge.messages.definitions.text import MAX_DEPTH, closure
from bridge.messages.errors import MessageTypeError

MAX_VARIANTS = 16  # maximum number of definitions stored for one learned name; the oldest is dropped first
MAX_NAMES = 10_000  # maximum number of learned names
MAX_LEARNED = 64 << 20  # maximum length of all learned definitions together, including dropped ones, in characters
MAX_NESTED = 2_000  # maximum number of types that one definition may nest


class DefinitionLibrary:
    """Schemas by name and fingerprint (md5 in ROS 1, RIHS01 in ROS 2). Not thread-safe; the registry holds the lock."""

    def __init__(self, world: World, sources: Sequence[DefinitionSource]) -> None:
        self.world = world
        self.derive: Callable[[str], Schema | None] = lambda _name: None
        """Derives a type that only the other world's definitions have; returns None if they lack it, too."""
        self.versions: Callable[[str], Mapping[str, tuple[str, Schema]]] = lambda _name: {}
        """Returns the versions of a type in other releases, by fingerprint."""
        self._deriving: list[str] = []
        self._sources = sources
        self._learned: dict[str, dict[str, Schema]] = {}
        self._nested: dict[str, Definition] = {}
        self._found: dict[str, Schema] = {}
        self._own: dict[str, Definition] = {}
        """Definitions on this machine that other types nest, read only once, like the schemas in ``_found``."""
        self._room = MAX_LEARNED

    def fingerprint(self, schema: Schema) -> str:
        """Return the schema's md5 or RIHS01 hash."""
        return md5_sum(schema) if self.world is World.ROS1 else rihs01(schema)

    def learn(self, name: str, text: str, announced: str = "") -> str:
        """Store a full definition from the network or a bag, and return its fingerprint; raises `MessageTypeError`."""
        definitions = parse_announced(text, name, self.world)
        if len(definitions) > MAX_NESTED:
            raise MessageTypeError(f"the definition of {name} nests more than {MAX_NESTED} types")
        schema = self._close(name, definitions)
        fingerprint = self.fingerprint(schema)
        if announced and announced != fingerprint:
            msg = f"the received definition of {name} has the fingerprint {fingerprint}, but {announced} was announced"
            raise MessageTypeError(msg, f"rebuild the publisher with the right version of {name.split('/')[0]}")
        if fingerprint in self._learned.get(name, {}):
            self._learned[name][fingerprint] = self._learned[name].pop(fingerprint)
            return fingerprint
        if len(self._learned) >= MAX_NAMES or len(text) > self._room:
            msg = f"the definition of {name} is not stored: too many definitions have been learned"
            raise MessageTypeError(msg, "restart the worker if the network's types are meant to change this often")
        self._room -= len(text)
        variants = self._learned.setdefault(name, {})
        variants[fingerprint] = schema
        if len(variants) > MAX_VARIANTS:
            del variants[next(iter(variants))]
        if len(self._nested) < MAX_NAMES:
            self._nested.update(definitions)
        return fingerprint

    def find(self, name: str, fingerprint: str = "", *, newest: bool = False) -> Schema | None:
        """Return the schema of ``name`` with a fingerprint ("" for any); None if no such definition is known.

        With ``newest`` and no fingerprint, the definition learned last is preferred to the installed one.
        """
        variants = self._learned.get(name, {})
        if fingerprint:
            if fingerprint in variants:
                return variants[fingerprint]
            schema = self.installed(name)
            if schema is not None and self.fingerprint(schema) == fingerprint:
                return schema
            version = self.versions(name).get(fingerprint)
            return self._empty(name, fingerprint) if version is None else version[1]
        last = next(reversed(variants.values()), None)
        if newest and last is not None:
            return last
        return self.installed(name) or last or self._from_nested(name)

    def fingerprints(self, name: str) -> list[str]:
        """Return the fingerprints of the learned definitions of ``name``, and of the installed one."""
        hashes = list(self._learned.get(name, {}))
        schema = self.installed(name)
        if schema is not None and (own_hash := self.fingerprint(schema)) not in hashes:
            hashes.append(own_hash)
        return hashes

    def names(self, package: str, kind: str = "msg") -> list[str]:
        """Return the names of a package's known messages, services (``srv``) or actions."""
        known = [name for source in self._sources for name in source.names(package, kind)]
        start = f"{package}/" if self.world is World.ROS1 and kind == "msg" else f"{package}/{kind}/"
        known += [name for name in self._learned if name.startswith(start)]
        return list(dict.fromkeys(known))

    def variants(self, name: str) -> list[Schema]:
        """Return all definitions of ``name``: the learned ones, the newest first, then the installed one."""
        learned = list(reversed(self._learned.get(name, {}).values()))
        other = self.installed(name) or (None if learned else self._from_nested(name))
        return learned if other is None else [*learned, other]

    def installed(self, name: str) -> Schema | None:
        """Return the schema of ``name`` as this machine's packages and folders define it."""
        if name not in self._found:
            definition = find_first(self._sources, name, self.world)
            if definition is None:
                return None
            self._found[name] = self._close(name, definition)
        return self._found[name]

    def _empty(self, name: str, fingerprint: str) -> Schema | None:
        """Return the schema of a type without fields and constants, if ``fingerprint`` identifies such a type.

        ROS 1's connection headers and ROS 2's tokens carry no text for such a type; the fingerprint defines it fully.
        """
        if self.world is World.ROS1:
            legal, text = is_ros1_name(name), ""
        else:
            legal = is_ros2_name(name)
            text = "---\n" if legal and is_service(name) else ""
        if not legal or fingerprint != self.fingerprint(self._close(name, parse_announced(text, name, self.world))):
            return None
        self.learn(name, text)
        return self._learned[name][fingerprint]

    def _from_nested(self, name: str) -> Schema | None:
        definition = self._nested.get(name)
        return None if definition is None else self._close(name, {name: definition})

    def _close(self, name: str, found: dict[str, Definition]) -> Schema:
        """Return the schema of ``name``; nested types that ``found`` lacks are looked up like any other type."""
        types = dict(found)
        waiting = [types[name]]
        seen = {name}
        while waiting:
            for nested in waiting.pop().nested_names():
                if nested in seen:
                    continue
                seen.add(nested)
                definition = types.get(nested) or self._own_definition(nested)
                if definition is not None:
                    types[nested] = definition
                    waiting.append(definition)
                elif (derived := self._derived(nested)) is not None:
                    types = {**derived.types, **types}
        return closure(types[name], types)

    def _derived(self, name: str) -> Schema | None:
        """Return a nested type that only the other world's definitions have, with all that it nests."""
        if name in self._deriving or len(self._deriving) > MAX_DEPTH:
            raise MessageTypeError(
                f"{name} cannot be used: its definitions for ROS 1 and ROS 2 nest each other endlessly"
            )
        self._deriving.append(name)
        try:
            return self.derive(name)
        finally:
            self._deriving.pop()

    def _own_definition(self, name: str) -> Definition | None:
        if name in self._found:
            return self._found[name].root
        if name not in self._own:
            definition = find_first(self._sources, name, self.world)
            if definition is None:
                return self._nested.get(name)
            self._own[name] = definition[name]
        return self._own[name]

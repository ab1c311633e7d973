"""Messages of ROS 1 and ROS 2: which stand for each other, and how their bytes get across."""

from __future__ import annotations

from collections.abc import Iterator

from bridge.messages.conversion import Conversion, SideType
from bridge.messages.definition import Schema, World
from bridge.messages.derive import derive_ros1, derive_ros2
from bridge.messages.errors import MessageTypeError
from bridge.messages.library import Library
from bridge.messages.names import is_ros1_name, is_ros2_name, legal_type
from bridge.messages.pairing import left_out, pair_types, says_the_same
from bridge.messages.rules import Rules
from bridge.messages.text import full_text
from bridge.messages.transcoder import cdr_to_ros1, ros1_to_cdr

ANY_MD5 = ("", "*")
"""What a ROS 1 endpoint announces that takes any definition."""


class Messages:
    """The registry's messages; the registry locks.

    Args:
        ros1: ROS 1's definitions.
        ros2: ROS 2's definitions.
        rules: mapping rules.
    """

    def __init__(self, ros1: Library, ros2: Library, rules: Rules) -> None:
        self.ros1, self.ros2, self.rules = ros1, ros2, rules
        self._converters: dict[tuple[str, ...], Conversion] = {}
        self._counterparts: dict[tuple[str, str], Schema] = {}

    def forget(self) -> None:
        """A new definition may change what stands for what."""
        self._counterparts.clear()

    def side(self, schema: Schema) -> SideType:
        """A message as its side, or the hub, names it."""
        library = self.ros1 if schema.world is World.ROS1 else self.ros2
        return SideType(schema.name, library.fingerprint(schema), full_text(schema))

    def conversion(self, source: Schema, target: Schema) -> Conversion:
        """How messages of one type become messages of its counterpart.

        Raises:
            MessageTypeError: the two are no pair.
        """
        sides = self.side(source), self.side(target)
        key = (*(side.name for side in sides), *(side.type_id for side in sides))
        if key not in self._converters:
            if source.world is World.ROS1:
                pairs = pair_types(source, target, self.rules)
                convert = ros1_to_cdr(source, target, pairs)
                self._converters[key] = Conversion(*sides, convert, left_out(pairs, self.rules))
            else:
                convert = cdr_to_ros1(source, target, pair_types(target, source, self.rules))
                self._converters[key] = Conversion(*sides, convert)
        return self._converters[key]

    def find_ros1(self, name: str, md5: str = "") -> Schema:
        """The ROS 1 message ``name``; where ROS 2 alone has it, the one derived from there.

        Raises:
            MessageTypeError: nothing is known of it, or it has another md5 here.
        """
        wanted = "" if md5 in ANY_MD5 else md5
        found = self.ros1.find(name, wanted, newest=True)
        if found is not None:
            return found
        if is_ros1_name(name):
            for candidate in self.rules.ros2_names(name):
                ros2 = self.ros2.find(candidate)
                derived = None if ros2 is None else self.to_ros1(ros2)
                if derived is not None and derived.name == name and wanted in ("", self.ros1.fingerprint(derived)):
                    return derived
        raise self._unknown(name, wanted, self.ros1, "md5")

    def find_ros2(self, name: str, type_hash: str = "") -> Schema:
        """The ROS 2 message ``name``; where ROS 1 alone has it, the one derived from there.

        Raises:
            MessageTypeError: nothing is known of it, or it has another hash here.
        """
        found = self.ros2.find(name, type_hash)
        if found is not None:
            return found
        if is_ros2_name(name):
            for ros1 in self._ros1_variants(name):
                ros2 = self.to_ros2(ros1)
                if ros2.name == name and type_hash in ("", self.ros2.fingerprint(ros2)):
                    return ros2
        raise self._unknown(name, type_hash, self.ros2, "hash")

    def _unknown(self, name: str, wanted: str, library: Library, word: str) -> MessageTypeError:
        world = library.world.value
        known = library.fingerprints(name)
        package = name.split("/")[0]
        if wanted and known:
            return MessageTypeError(
                f"{name} has the {word} {wanted} there but {' or '.join(known)} here: the definitions differ",
                f"use the same version of {package} on both sides",
            )
        return MessageTypeError(
            f"no definition of the {world} type {name} is known",
            f"install {package}, or put its .msg files into a folder that types.folders names",
        )

    def _ros1_variants(self, ros2_name: str) -> Iterator[Schema]:
        """All ROS 1 definitions that may stand for a ROS 2 name, the likeliest first."""
        package = ros2_name.split("/", 1)[0]
        names = self.rules.ros1_names(ros2_name)
        for name in names:
            yield from self.ros1.variants(name)
        for name in self.ros1.names(package):
            if name not in names and legal_type(name) == ros2_name:
                yield from self.ros1.variants(name)

    def to_ros2(self, ros1: Schema) -> Schema:
        """The ROS 2 type that stands for a ROS 1 type.

        It is one that is installed; else one that others use on the hub and that says the same, field for field; else
        it is derived.
        """
        key = (ros1.name, self.ros1.fingerprint(ros1))
        if key not in self._counterparts:
            self._counterparts[key] = self._match_ros2(ros1)
        return self._counterparts[key]

    def _match_ros2(self, ros1: Schema) -> Schema:
        names = self.rules.ros2_names(ros1.name)
        for name in names:
            found = self.ros2.installed(name)
            if found is not None:
                return found
        for name in names:
            for told in self.ros2.variants(name):
                if says_the_same(ros1, told, self.rules):
                    return told
        return derive_ros2(ros1, self.to_ros2)

    def to_ros1(self, ros2: Schema) -> Schema:
        """The ROS 1 type that stands for a ROS 2 type: announced by publishers, installed, else derived."""
        key = (ros2.name, self.ros2.fingerprint(ros2))
        if key not in self._counterparts:
            self._counterparts[key] = self._match_ros1(ros2, key[1])
        return self._counterparts[key]

    def _match_ros1(self, ros2: Schema, wanted: str) -> Schema:
        first: Schema | None = None
        for ros1 in self._ros1_variants(ros2.name):
            back = self.to_ros2(ros1)
            if back.name == ros2.name and self.ros2.fingerprint(back) == wanted:
                return ros1
            first = first or ros1
        return first or derive_ros1(ros2, self.to_ros1)

    def derivable(self, package: str) -> Iterator[Schema]:
        """ROS 2 types of a package that are made from ROS 1 types."""
        for name in self.ros1.names(package):
            ros1 = self.ros1.find(name, newest=True)
            if ros1 is None:
                continue
            try:
                ros2 = self.to_ros2(ros1)
            except MessageTypeError:
                continue
            if ros2.root.package == package:
                yield ros2

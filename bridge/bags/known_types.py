"""Selects the definition that decodes a bag's topic: the bag's, else the one known here, if it fits the messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path

from bridge.bags.bag import Bag, BagError, BagTopic
from bridge.bags.definitions import full_schema
from bridge.messages.definitions.hashes import rihs01
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name
from bridge.messages.definitions.schema import World
from bridge.messages.definitions.text import full_text
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.mapping.messages import ANY_MD5
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType

FOLDERS = "put the .msg files of the version that was recorded into a folder that types.folders names"
"""The cure for a bag without a matching definition."""

_CHECKED = 10
"""Number of messages of each topic that are checked."""

_PADDING = 3
"""Maximum number of bytes by which DDS pads a message to a multiple of four."""


def ros2_type(registry: Registry, topic: BagTopic) -> SideType:
    """Return the ROS 2 type of a topic: by the bag's own definition, else by its hash, else by its name.

    If the bag's definition does not have the bag's hash, the definition wins, because the messages were written with
    it. Raises `MessageTypeError` if the definition cannot be read and the bag has no hash; if the definition nests a
    type that is missing in it and differs here; and if no definition can be read and the type or its hash is
    unknown here.
    """
    name, type_hash = topic.type_name, topic.type_hash
    if topic.definition:
        try:
            learned = registry.learn_ros2(name, topic.definition)
        except MessageTypeError:
            if not type_hash:
                raise
        else:
            if type_hash not in ("", learned) and not _is_complete(topic):
                raise MessageTypeError(
                    f"a type that {name} nests is missing in the bag, and has changed since", FOLDERS
                )
            type_hash = learned
    schema = registry.schema(name, type_hash)
    return SideType(name, type_hash or rihs01(schema), full_text(schema))


def ros1_md5(registry: Registry, topic: BagTopic) -> str:
    """Return the md5 of the ROS 1 definition with which a topic is read; a bag's own definition wins over its md5.

    Python's rosbag does the same (rosbag/bag.py, ``_get_message_type``). Raises `MessageTypeError` if the definition
    cannot be read and its md5 is unknown here.
    """
    if not topic.definition:
        return topic.type_hash
    try:
        return registry.learn_ros1(topic.type_name, topic.definition)
    except MessageTypeError:
        if topic.type_hash in ANY_MD5:
            raise
        registry.ros1_schema(topic.type_name, topic.type_hash)
        return topic.type_hash


def typed(topic: BagTopic, path: Path) -> BagTopic:
    """Return the topic with its type as its world spells it; some writers of MCAP leave ``/msg/`` out, or add it."""
    if not topic.type_name:
        raise BagError(path, f"{topic.name} has no type: its channel has no schema")
    is_name = is_ros1_name if topic.world is World.ROS1 else is_ros2_name
    if is_name(topic.type_name):
        return topic
    if topic.world is World.ROS2 and is_ros1_name(topic.type_name):
        return replace(topic, type_name=topic.type_name.replace("/", "/msg/"))
    if topic.world is World.ROS1 and is_ros1_name(name := topic.type_name.replace("/msg/", "/", 1)):
        return replace(topic, type_name=name)
    raise BagError(path, f"{topic.name} has type {topic.type_name!r}, which is not a type of {topic.world.value}")


def _is_complete(topic: BagTopic) -> bool:
    """Return whether the bag defines the ROS 2 type of a topic and all types that it nests."""
    with suppress(MessageTypeError):
        return bool(topic.definition and full_schema(topic.type_name, topic.definition))
    return False


def misfits(bag: Bag, topics: Iterable[BagTopic], registry: Registry) -> dict[BagTopic, BagError]:
    """Return the topics whose first messages do not match the definition known here, with the error for each.

    This concerns topics for which the bag has neither a complete definition nor a hash, such as in bags of Foxy and
    Humble.
    """
    errors: dict[BagTopic, BagError] = {}
    for topic in topics:
        if topic.type_hash not in ANY_MD5 or (topic.definition and topic.world is World.ROS1):
            continue
        # an unknown type has no check; if the bag is damaged, its conversion reports that
        with suppress(MessageTypeError, BagError):
            known = typed(topic, bag.path)
            if _is_complete(known):
                continue
            check = _check(registry, known)
            try:
                for message in islice(bag.messages([topic]), min(topic.count, _CHECKED)):
                    check(message.data)
            except ConversionError as err:
                errors[topic] = _misfit(bag, topic, err)
    return errors


def _misfit(bag: Bag, topic: BagTopic, err: ConversionError) -> BagError:
    problem = (
        f"{topic.name} has type {topic.type_name}, of which the bag has no complete definition, and its messages do"
        f" not fit the definition known here: {err}"
    )
    return BagError(bag.path, problem, None, FOLDERS)


def _check(registry: Registry, topic: BagTopic) -> Callable[[bytes], object]:
    """Return a check of messages against the definition known here; raises `MessageTypeError` if it is unknown."""
    if topic.world is World.ROS1:
        return registry.ros1_to_hub(topic.type_name, topic.type_hash).convert or bytes
    check = registry.hub_check(topic.type_name, ros2_type(registry, topic).type_id)

    def strict(data: bytes) -> None:
        trailing = data[len(check(data)) :]
        if len(trailing) > _PADDING and any(trailing):
            problem = f"{len(trailing)} bytes are left over after the last field"
            raise ConversionError(f"bad {topic.type_name} message: {problem}")

    return strict

"""How a bag's messages become the hub's, and ROS 1's: by the conversions that the bridge itself uses.

A type is taken from the bag's own definition where it is not installed, or installed in another version.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bridge.bags.bag import BagError, BagTopic
from bridge.messages.definitions.schema import World
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, SideType


@dataclass(frozen=True, slots=True)
class TopicForm:
    """How a topic's messages look elsewhere.

    Attributes:
        type_name: as that world spells it.
        type_hash: ``RIHS01_...`` or md5; "" where nobody knows it.
        definition: the full definition, "" where nobody knows it.
        convert: makes a message's bytes; None where they are the same. Raises `ConversionError` for bad bytes.
        left_out: fields of ROS 1 that get lost.
    """

    type_name: str
    type_hash: str
    definition: str
    convert: Callable[[bytes], bytes] | None
    left_out: tuple[str, ...] = ()


def to_hub(registry: Registry, topic: BagTopic, path: Path = Path("bag")) -> TopicForm:
    """A topic's messages as the hub and ROS 2 have them; raises `BagError` naming a type that nothing stands for."""
    if topic.world is World.ROS1:
        try:
            conversion = registry.ros1_to_hub(topic.type_name, topic.type_hash, topic.definition)
        except MessageTypeError as err:
            raise _refusal(path, topic, err) from None
        return _form(conversion)
    known = _learn(registry, topic)
    if known is None:  # CDR can be handed on by who does not know it
        return TopicForm(topic.type_name, topic.type_hash, topic.definition, None)
    return TopicForm(topic.type_name, topic.type_hash or known.type_id, topic.definition or known.definition, None)


def to_ros1(registry: Registry, topic: BagTopic, path: Path = Path("bag")) -> TopicForm:
    """A topic's messages as ROS 1 has them; raises `BagError` naming a type that nothing stands for."""
    try:
        if topic.world is World.ROS1:
            registry.ros1_to_hub(topic.type_name, topic.type_hash, topic.definition)
            return TopicForm(topic.type_name, topic.type_hash, topic.definition, None)
        known = _learn(registry, topic)
        return _form(registry.hub_to_ros1(topic.type_name, "" if known is None else known.type_id))
    except MessageTypeError as err:
        raise _refusal(path, topic, err) from None


def _learn(registry: Registry, topic: BagTopic) -> SideType | None:
    """The ROS 2 type as the bag has it, None where it cannot be known."""
    with suppress(MessageTypeError):
        if topic.type_hash:
            registry.schema(topic.type_name, topic.type_hash)
            return SideType(topic.type_name, topic.type_hash, topic.definition)
    if topic.definition:
        with suppress(MessageTypeError):
            registry.learn_ros2(topic.type_name, topic.definition)
            if topic.type_hash:
                registry.schema(topic.type_name, topic.type_hash)
                return SideType(topic.type_name, topic.type_hash, topic.definition)
    with suppress(MessageTypeError):
        return registry.ros2(topic.type_name)
    return None


def _form(conversion: Conversion) -> TopicForm:
    target = conversion.target
    return TopicForm(target.name, target.type_id, target.definition, conversion.convert, conversion.left_out)


def _refusal(path: Path, topic: BagTopic, err: MessageTypeError) -> BagError:
    return BagError(path, f"{topic.name} has type {topic.type_name}, which cannot be converted: {err}", None, err.cure)

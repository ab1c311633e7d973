"""Converts a bag's topics to the hub's types or to ROS 1's, with the conversions that the bridge itself uses.

The bag's own definition of a type is used before the installed one, which may be missing or of another version.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from bridge.adapters.ros1.actions.states import TO_ROS1, Ros1State, text_of
from bridge.adapters.ros1.actions.wire import (
    ZERO,
    GoalId,
    GoalStatus,
    action_outcome,
    read_goal_states,
    read_with_uuid,
    statuses,
)
from bridge.adapters.ros1.names import hub_name
from bridge.bags.bag import BagError, BagTopic
from bridge.bags.definitions import full_schema, without_char
from bridge.bags.known_types import FOLDERS, ros1_md5, ros2_type, typed
from bridge.messages import actions
from bridge.messages.actions import GoalState
from bridge.messages.definitions.schema import World
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.messages import ANY_MD5
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion

_STATUSES = "actionlib_msgs/GoalStatusArray"
_FEEDBACK = actions.ENDINGS[actions.FEEDBACK]


@dataclass(frozen=True, slots=True)
class TopicForm:
    """A topic in the format of another file.

    Attributes:
        type_name: the type's name as that format spells it.
        type_hash: ``RIHS01_...`` or md5; "" if unknown.
        definition: the full definition, "" if unknown.
        convert: converts a message's bytes; None if they stay the same. Raises `ConversionError` for invalid bytes.
        left_out: ROS 1 fields that have no counterpart.
        name: the topic's name, "" if it stays the same.
        undefined: why no definition is known, with the cure; None if one is known, or if the bag has an unusable one.
    """

    type_name: str
    type_hash: str
    definition: str
    convert: Callable[[bytes], bytes] | None
    left_out: tuple[str, ...] = ()
    name: str = ""
    undefined: BagError | None = None


def to_hub(registry: Registry, topic: BagTopic, path: Path = Path("bag")) -> TopicForm:
    """Return a topic in the form of the hub and ROS 2; raises `BagError` for a type without a counterpart.

    A name that ROS 2 forbids becomes the name that the ROS 1 side uses on the hub (`bridge.adapters.ros1.names`).
    """
    topic = typed(topic, path)
    name = hub_name(topic.name)
    if topic.world is World.ROS1:
        try:
            conversion = registry.ros1_to_hub(topic.type_name, ros1_md5(registry, topic))
        except MessageTypeError as err:
            raise _refusal(path, topic, err) from None
        return replace(_form(conversion), name=name)
    try:
        known = ros2_type(registry, topic)
    except MessageTypeError as err:  # CDR can be copied although its type is unknown
        undefined = None if topic.definition else BagError(path, str(err), None, _cure(topic, err))
        return TopicForm(topic.type_name, topic.type_hash, topic.definition, None, name=name, undefined=undefined)
    return TopicForm(topic.type_name, known.type_id, known.definition, None, name=name)


def to_ros1(registry: Registry, topic: BagTopic, path: Path = Path("bag")) -> TopicForm:
    """Return a topic in the form of ROS 1; raises `BagError` for a type without a counterpart.

    Feedback and status of a ROS 2 action become those of actionlib, as the ROS 1 side publishes them.
    """
    topic = typed(topic, path)
    if topic.world is World.ROS2 and "/msg/" not in topic.type_name and not topic.type_name.endswith(_FEEDBACK):
        err = MessageTypeError("it is part of a service, and ROS 1 has no messages for the calls of services")
        raise _refusal(path, topic, err)
    try:
        if topic.world is World.ROS1:
            source = registry.ros1_to_hub(topic.type_name, ros1_md5(registry, topic)).source
            md5 = source.type_id if topic.type_hash in ANY_MD5 else topic.type_hash
            return TopicForm(topic.type_name, md5, topic.definition or source.definition, None)
        type_hash = ros2_type(registry, topic).type_id
        if topic.type_name == actions.STATUSES:
            return _statuses(registry, topic.name, type_hash)
        if topic.type_name.endswith(_FEEDBACK):
            return _feedback(registry, topic, type_hash)
        return _form(registry.hub_to_ros1(topic.type_name, type_hash))
    except MessageTypeError as err:
        raise _refusal(path, topic, err) from None


class FileTopics:
    """The topics and types of one file of ROS 2, whose readers support only one definition of each type."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._names: dict[str, str] = {}
        self._types: dict[str, tuple[object, str]] = {}

    def add(self, topic: BagTopic, form: TopicForm) -> None:
        """Add a topic; raises `BagError` if the file cannot hold it in addition to the earlier topics.

        If topics of different names would get the same name, the first one gets it, as on the hub. All topics must have
        the same definition of a type.
        """
        if (other := self._names.get(form.name, topic.name)) != topic.name:
            problem = f"{topic.name} would become {form.name}, as {other} does"
            raise BagError(self._path, problem, None, "leave one of the topics out with -x")
        types = _members(form)
        for name, members in types.items():
            known, other = self._types.get(name, (members, ""))
            if known != members:
                problem = f"{topic.name} has another definition of {name.split()[0]} than {other}"
                cure = "a .bag has room for both" if other == topic.name else "convert them into several files with -x"
                raise BagError(self._path, f"{problem}, but a file of ROS 2 has only one for each type", None, cure)
        self._names[form.name] = topic.name
        for name, members in types.items():
            self._types.setdefault(name, (members, topic.name))


def _members(form: TopicForm) -> dict[str, object]:
    """Return the fields of each type of a topic, and the hash of its own type."""
    members: dict[str, object] = {f"{form.type_name} (hash)": form.type_hash} if form.type_hash else {}
    if form.definition:
        with suppress(MessageTypeError):
            types = without_char(full_schema(form.type_name, form.definition)).types
            members |= {name: [(field.name, field.type) for field in types[name].fields] for name in types}
    return members


def _form(conversion: Conversion) -> TopicForm:
    target = conversion.target
    return TopicForm(target.name, target.type_id, target.definition, conversion.convert, conversion.left_out)


def _feedback(registry: Registry, topic: BagTopic, type_hash: str) -> TopicForm:
    """Return actionlib's form of a ROS 2 action's feedback. ROS 2's feedback has no stamp, so the stamps are zero."""
    convert = registry.hub_to_ros1(topic.type_name, type_hash).convert or bytes
    target = registry.ros1_action_feedback(registry.action_to_ros1(topic.type_name.removesuffix(_FEEDBACK)))

    def to_actionlib(data: bytes) -> bytes:
        goal, body = read_with_uuid(convert(data))
        status = GoalStatus(GoalId(ZERO, text_of(goal)), Ros1State.ACTIVE, "")
        return action_outcome(0, ZERO, status, body)

    return TopicForm(target.name, target.type_id, target.definition, to_actionlib, name=_actionlib_name(topic.name))


def _statuses(registry: Registry, name: str, type_hash: str) -> TopicForm:
    """Return actionlib's form of a ROS 2 action's status list."""
    convert = registry.hub_to_ros1(actions.STATUSES, type_hash).convert or bytes
    target = registry.ros1(_STATUSES)

    def to_actionlib(data: bytes) -> bytes:
        goals = [
            GoalStatus(GoalId(info.stamp, text_of(info.uuid)), TO_ROS1[GoalState.parse(state)], "")
            for info, state in read_goal_states(convert(data))
        ]
        return statuses(0, ZERO, goals)

    return TopicForm(target.name, target.type_id, target.definition, to_actionlib, name=_actionlib_name(name))


def _actionlib_name(name: str) -> str:
    action, part = actions.split(name)
    return f"{action}/{part}" if part else name


def _refusal(path: Path, topic: BagTopic, err: MessageTypeError) -> BagError:
    problem = f"{topic.name} has type {topic.type_name}, which cannot be converted: {err}"
    return BagError(path, problem, None, _cure(topic, err))


def _cure(topic: BagTopic, err: MessageTypeError) -> str:
    # without a definition, the version that was recorded is missing here, not on another machine
    return err.cure if topic.definition or topic.type_hash in ANY_MD5 else FOLDERS

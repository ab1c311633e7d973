"""Corresponding actions of ROS 1 and ROS 2, and the services and messages that they consist of.

The bridged parts are those of ROS 2: the services SendGoal and GetResult, and FeedbackMessage. The ROS 1 adapter has
the same parts with the same names in the ROS 1 serialization: ``move_base_msgs/action/MoveBase_SendGoal`` corresponds
to ``nav2_msgs/action/NavigateToPose_SendGoal``. These parts contain the goal, result and feedback of the ROS 1 action,
which are messages of actionlib (``move_base_msgs/MoveBaseGoal``), so connection headers may suffice to define them. The
ROS 1 adapter adds the text of actionlib's status as the first field of a result; this text corresponds to the result's
``error_msg`` in ROS 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bridge.messages.definitions.hashes import md5_sum, rihs01
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name, legal_type, split_part
from bridge.messages.definitions.parts import CONTENTS, actionlib_messages, generated_parts, with_status_text
from bridge.messages.definitions.schema import Definition, Schema, World
from bridge.messages.definitions.text import closure, full_text
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.fields import has_equal_fields
from bridge.messages.mapping.messages import MessageMapping, derive_ros1, derive_ros2, unknown_type
from bridge.messages.transcode.conversion import SideType

_UUID = "unique_identifier_msgs/msg/UUID"
_NEEDED = ("service_msgs/msg/ServiceEventInfo", _UUID)
_CONTENT_OF = {"SendGoal": "Goal", "GetResult": "Result", "FeedbackMessage": "Feedback"}

Types = dict[str, Definition]


@dataclass(frozen=True, slots=True)
class ActionTopicTypes:
    """The message types of a ROS 1 action's topics: ``pkg/NameActionGoal`` and so on."""

    goal: SideType
    result: SideType
    feedback: SideType


class ActionMapping:
    """The registry's actions; the registry holds the lock. Methods raise `MessageTypeError` for unmapped actions."""

    def __init__(self, messages: MessageMapping) -> None:
        self._messages = messages

    def ros2_name(self, action: str) -> str:
        """Return the ROS 2 action for a ROS 1 action: installed, or announced with an equal goal, or else derived."""
        names = self._messages.rules.ros2_names(action, "action")
        for name in names:
            if self._messages.ros2.installed(f"{name}_Goal") is not None:
                return name
        goal = self._ros1_content(action, "Goal")
        for name in names:
            rules, versions = self._messages.rules, self._announced(name, "SendGoal")
            if any(has_equal_fields(goal, announced, rules) for announced in versions):
                return name
        return legal_type(action, "action")

    def ros1_name(self, action: str) -> str:
        """Return the ROS 1 action for a ROS 2 action, ``pkg/action/Name``: a known action, else a derived one."""
        return next(self._known_ros1(action), action.replace("/action/", "/", 1))

    def topics(self, action: str) -> ActionTopicTypes:
        """Return the message types of a ROS 1 action's topics."""
        return ActionTopicTypes(*(self.topic(action, content) for content in CONTENTS["action"]))

    def topic(self, action: str, content: str) -> SideType:
        """Return the message of one of a ROS 1 action's topics; ``content`` is ``Goal``, ``Result`` or ``Feedback``."""
        wrapper = self._wrapper(action, content)
        return SideType(wrapper.name, md5_sum(wrapper), full_text(wrapper))

    def of_ros1(self, name: str) -> tuple[str, Types, Types]:
        """Return a ROS 1 part's name in ROS 2, and the part's definitions in ROS 1 and ROS 2.

        Both names have the form ``pkg/action/Name_SendGoal``.
        """
        base, part = _split(name, World.ROS1)
        action, content = base.replace("/action/", "/", 1), _CONTENT_OF[part]
        ros2_action = self.ros2_name(action)
        ros1 = self._ros1_content(action, content)
        ros2 = self._ros2_content(ros2_action, part, ros1)
        return f"{ros2_action}_{part}", self._ros1_types(base, part, ros1), self._ros2_types(ros2_action, ros2)

    def of_ros2(self, name: str, type_hash: str = "") -> tuple[str, Types, Types]:
        """Return a ROS 2 part's name in ROS 1, and the part's definitions in ROS 1 and ROS 2; see `of_ros1`."""
        action, part = _split(name, World.ROS2)
        content = _CONTENT_OF[part]
        root = self._messages.ros2.find(name, type_hash)
        if root is None:
            return self._derived(name, type_hash)
        if f"{action}_{content}" not in root.types:
            raise MessageTypeError(f"the definition of {name} on the hub contains no {content.lower()}")
        ros1_action = self.ros1_name(action)
        ros2 = root.sub(f"{action}_{content}")
        ros1 = self._messages.ros1.find(f"{ros1_action}{content}", newest=True) or derive_ros1(
            ros2, self._messages.to_ros1, f"{ros1_action}{content}"
        )
        base = ros1_action.replace("/", "/action/", 1)
        return f"{base}_{part}", self._ros1_types(base, part, ros1), dict(root.types)

    def _derived(self, name: str, type_hash: str) -> tuple[str, Types, Types]:
        """Return the same as `of_ros2`, for a part that is known only from ROS 1."""
        action, part = _split(name, World.ROS2)
        known = " or ".join(self._messages.ros2.fingerprints(name))
        for ros1_action in self._known_ros1(action):
            if self.ros2_name(ros1_action) != action:
                continue
            base = ros1_action.replace("/", "/action/", 1)
            _, ros1_types, ros2_types = self.of_ros1(f"{base}_{part}")
            derived_hash = rihs01(closure(ros2_types[name], ros2_types))
            if type_hash in ("", derived_hash):
                return f"{base}_{part}", ros1_types, ros2_types
            known = known or derived_hash
        raise unknown_type(name, World.ROS2, type_hash, known)

    def schema(self, name: str, type_hash: str = "") -> Schema:
        """Return a message of a ROS 2 action that is known only from ROS 1; a ``type_hash`` of "" means any."""
        action, known = split_part(name)[0], ""
        for ros1_action in self._known_ros1(action):
            if self.ros2_name(ros1_action) == action:
                types = self.derived(ros1_action)
                if name in types:
                    schema = closure(types[name], types)
                    known = rihs01(schema)
                    if type_hash in ("", known):
                        return schema
        raise unknown_type(name, World.ROS2, type_hash, known)

    def derived(self, action: str) -> Types:
        """Return the definitions of the ROS 2 action for a ROS 1 action, without parts that are unknown in ROS 1."""
        ros2_action = self.ros2_name(action)
        types: Types = {}
        for part, content in _CONTENT_OF.items():
            ros1 = self._find_ros1(action, content)
            if ros1 is not None:
                types |= self._ros2_types(ros2_action, self._ros2_content(ros2_action, part, ros1))
        return types

    def names(self, package: str) -> list[str]:
        """Return the complete ROS 2 actions of a package: installed, announced on the hub, or derived from ROS 1."""
        known = [split_part(name)[0] for name in self._messages.ros2.names(package, "action")]
        known += [legal_type(name, "action") for name in self._ros1_names(package)]
        return [name for name in dict.fromkeys(known) if name.startswith(f"{package}/") and self._is_complete(name)]

    def _is_complete(self, action: str) -> bool:
        if all(self._messages.ros2.find(f"{action}_{content}") is not None for content in CONTENTS["action"]):
            return True
        ros1 = next((name for name in self._known_ros1(action) if self.ros2_name(name) == action), "")
        return bool(ros1) and all(self._find_ros1(ros1, content) is not None for content in CONTENTS["action"])

    def _ros2_content(self, action: str, part: str, ros1: Schema) -> Schema:
        """Return a ROS 2 action's goal, result or feedback."""
        name = f"{action}_{_CONTENT_OF[part]}"
        installed = self._messages.ros2.installed(name)
        if installed is not None:
            return installed
        for announced in self._announced(action, part):
            if has_equal_fields(ros1, announced, self._messages.rules):
                return announced
        return derive_ros2(ros1, self._messages.to_ros2, name)

    def _announced(self, action: str, part: str) -> list[Schema]:
        """Return the goals, results or feedback messages in the definitions that are announced on the hub."""
        content = f"{action}_{_CONTENT_OF[part]}"
        return [root.sub(content) for root in self._messages.ros2.variants(f"{action}_{part}") if content in root.types]

    def _ros1_content(self, action: str, content: str) -> Schema:
        """Return a ROS 1 action's goal, result or feedback."""
        known = self._find_ros1(action, content)
        if known is not None:
            return known
        if is_ros1_name(action):
            for name in self._messages.rules.ros2_names(action, "action"):
                ros2 = self._messages.ros2.find(f"{name}_{content}")
                if ros2 is not None and self.ros1_name(name) == action:
                    return derive_ros1(ros2, self._messages.to_ros1, f"{action}{content}")
        base = action.replace("/", "/action/", 1)
        raise unknown_type(base if content == "Goal" else f"{base}_{content}", World.ROS1)

    def _find_ros1(self, action: str, content: str) -> Schema | None:
        return self._messages.ros1.find(f"{action}{content}", newest=True)

    def _known_ros1(self, action: str) -> Iterator[str]:
        """Yield the ROS 1 actions that may correspond to a ROS 2 action, the likeliest first."""
        names = self._messages.rules.ros1_names(action)
        others = self._ros1_names(action.split("/", 1)[0])
        names += [name for name in others if name not in names and legal_type(name, "action") == action]
        for name in names:
            if self._find_ros1(name, "Goal") is not None:
                yield name

    def _ros1_names(self, package: str) -> list[str]:
        """Return the possible actions of a ROS 1 package: all names with a goal, except wrappers of a goal."""
        known = dict.fromkeys(self._messages.ros1.names(package))
        goals = [name for name in known if name.endswith("Goal")]
        wrappers = {f"{name.removesuffix('Goal')}ActionGoal" for name in goals}
        return [name.removesuffix("Goal") for name in goals if name not in wrappers]

    def _ros1_types(self, base: str, part: str, content: Schema) -> Types:
        uuid = self._messages.ros2.installed(_UUID)
        assert uuid is not None  # rosbags' store has it
        types = with_status_text(content) if part == "GetResult" else content.types
        return {**generated_parts(base, World.ROS1), **self._messages.to_ros1(uuid).types, **types}

    def _ros2_types(self, action: str, content: Schema) -> Types:
        types = generated_parts(action, World.ROS2)
        for needed in _NEEDED:
            schema = self._messages.ros2.installed(needed)
            assert schema is not None  # rosbags' store has it
            types.update(schema.types)
        return {**types, **content.types}

    def _wrapper(self, action: str, content: str) -> Schema:
        """Return the message in which actionlib sends a goal, a result or feedback."""
        name = f"{action}Action{content}"
        wrapper = self._messages.ros1.find(name, newest=True)
        if wrapper is not None:
            return wrapper
        types = {**actionlib_messages(action), **self._ros1_content(action, content).types}
        for needed in types[name].nested_names():
            known = self._messages.ros1.installed(needed) if needed not in types else None
            types.update({} if known is None else known.types)
        return closure(types[name], types)


def _split(name: str, world: World) -> tuple[str, str]:
    """Split a name into the action, ``pkg/action/Name``, and the part."""
    base, _, part = name.rpartition("_")
    if not is_ros2_name(name) or part not in _CONTENT_OF:
        raise unknown_type(name, world)
    return base, part

"""The messages of services and actions: ``pkg/srv/Name_Request``, ``pkg/action/Name_FeedbackMessage`` ...

The parts are those of ``rosidl_parser.definition`` (jazzy): a service has request, response and event; an action has
goal, result, feedback, the services send_goal and get_result, and the feedback message. A service or an action is
described as a message that has all of these parts as fields, and its RIHS01 hash covers that message
(``rosidl_generator_type_description``).

The parts of ROS 1 services and actions have names of the same form here, unlike anything else in ROS 1. Only an
action's goal, result and feedback are ROS 1 messages, ``pkg/NameGoal`` and so on, as genaction.py of actionlib_msgs
creates them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from bridge.messages.definitions.names import split_part
from bridge.messages.definitions.schema import Definition, Field, FieldType, Schema, World
from bridge.messages.definitions.text import parse_definition, parse_full, split_parts
from bridge.messages.errors import MessageTypeError

CONTENTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
"""The parts that a file of either kind defines, in order."""

ACTION_SERVICES = ("SendGoal", "GetResult")  # the services whose types each action defines
STATUS_TEXT = "actionlib_status_text"
"""The field that the ROS 1 adapter adds at the beginning of an action's result: the text of actionlib's GoalStatus."""

CANCEL_GOAL = "action_msgs/srv/CancelGoal"  # the third service of every action; the ROS 1 adapter uses this name, too
_SERVICE = "{base}_Request request_message\n{base}_Response response_message\n{base}_Event event_message\n"
_EVENT = "service_msgs/ServiceEventInfo info\n{base}_Request[<=1] request\n{base}_Response[<=1] response\n"
_SENT = {
    "SendGoal_Request": "unique_identifier_msgs/UUID goal_id\n{content}Goal goal\n",
    "SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    "GetResult_Request": "unique_identifier_msgs/UUID goal_id\n",
    "GetResult_Response": "int8 status\n{content}Result result\n",
    "FeedbackMessage": "unique_identifier_msgs/UUID goal_id\n{content}Feedback feedback\n",
}
_MADE = {
    "srv": {"": _SERVICE, "Event": _EVENT},
    "action": {
        "": "{base}_Goal goal\n{base}_Result result\n{base}_Feedback feedback\n{base}_SendGoal send_goal_service\n"
        "{base}_GetResult get_result_service\n{base}_FeedbackMessage feedback_message\n",
        **_SENT,
        **{service: _SERVICE.replace("{base}", f"{{base}}_{service}") for service in ACTION_SERVICES},
        **{f"{service}_Event": _EVENT.replace("{base}", f"{{base}}_{service}") for service in ACTION_SERVICES},
    },
}
_ACTIONLIB = {
    "Action": "{content}ActionGoal action_goal\n{content}ActionResult action_result\n"
    "{content}ActionFeedback action_feedback\n",
    "ActionGoal": "Header header\nactionlib_msgs/GoalID goal_id\n{content}Goal goal\n",
    "ActionResult": "Header header\nactionlib_msgs/GoalStatus status\n{content}Result result\n",
    "ActionFeedback": "Header header\nactionlib_msgs/GoalStatus status\n{content}Feedback feedback\n",
}


def is_service(name: str) -> bool:
    """Whether a name of three parts is that of a service, which may be part of an action."""
    kind, part = name.split("/")[1], split_part(name)[1]
    return part == "" if kind == "srv" else kind == "action" and part in ACTION_SERVICES


def generated_parts(base: str, world: World) -> dict[str, Definition]:
    """Return the definitions of a service or action in addition to those in its file; there are no events in ROS 1."""
    kind = base.split("/")[1]
    templates = _MADE[kind] if world is World.ROS2 else _SENT
    texts = {f"{base}_{part}" if part else base: text for part, text in templates.items()}
    content = f"{base}_" if world is World.ROS2 else base.replace("/action/", "/", 1)
    return {
        name: parse_definition(text.format(base=base, content=content), name, world) for name, text in texts.items()
    }


def actionlib_messages(action: str) -> dict[str, Definition]:
    """Return the messages in which actionlib sends a goal, result and feedback (``move_base_msgs/MoveBase``)."""
    return {
        f"{action}{part}": parse_definition(text.format(content=action), f"{action}{part}", World.ROS1)
        for part, text in _ACTIONLIB.items()
    }


def with_status_text(result: Schema) -> dict[str, Definition]:
    """Return a ROS 1 action's result and all types that it nests, with the status text as the result's first field."""
    root = result.root
    text = Field(STATUS_TEXT, FieldType("string"))
    return {**result.types, root.name: replace(root, fields=(text, *root.fields), text="")}


def parse_announced(text: str, name: str, world: World) -> dict[str, Definition]:
    """Return the definitions in an announced text by name; raises `MessageTypeError`.

    The text of a ROS 2 service has a line ``---`` between request and response.
    """
    if world is World.ROS1 or not is_service(name):
        return parse_full(text, name, world)
    sections = split_parts(text)
    if len(sections) != 2:
        msg = f"the definition of the service {name} has {len(sections)} parts separated by '---' instead of 2"
        raise MessageTypeError(msg)
    definitions: dict[str, Definition] = {}
    for part, section in zip(CONTENTS["srv"], sections, strict=True):
        definitions = parse_full(section, f"{name}_{part}", world) | definitions
    for part_name, pattern in {name: _SERVICE, f"{name}_Event": _EVENT}.items():
        definitions[part_name] = parse_definition(pattern.format(base=name), part_name, world)
    return definitions


def base_of(name: str, world: World) -> str:
    """Return the service or action that a part belongs to: ``pkg/srv/Name`` for ``pkg/srv/Name_Request``."""
    # ROS 1 names may contain underscores
    return name.rpartition("_")[0] if world is World.ROS1 else split_part(name)[0]


def find_part(folder: Path, name: str, world: World = World.ROS2) -> dict[str, Definition] | None:
    """Return all messages of the service or action whose file is in ``folder``; None if ``name`` is missing.

    ``pkg/srv/Name_Request`` is the request, and ``pkg/srv/Name`` is the message that describes the whole service.
    """
    base = base_of(name, world)
    kind = name.split("/")[1]
    path = folder / f"{base.rpartition('/')[2]}.{kind}"
    if not path.is_file():
        return None
    sections = zip(CONTENTS[kind], read_sections(path, kind), strict=True)
    parts = {f"{base}_{part}": parse_definition(text, f"{base}_{part}", world) for part, text in sections}
    return with_generated_parts(parts, name, world)


def with_generated_parts(definitions: dict[str, Definition], name: str, world: World) -> dict[str, Definition] | None:
    """Return the definitions of a service's or action's file and those that ROS 2 adds; None if ``name`` is missing."""
    if world is World.ROS2:
        definitions = generated_parts(base_of(name, world), world) | definitions
    return definitions if name in definitions else None


def find_actionlib(folder: Path, name: str) -> dict[str, Definition] | None:
    """Return all ROS 1 messages of the ``.action`` file in ``folder`` that defines ``name``; None if no file does.

    Their names are ``pkg/NameGoal``, ``pkg/NameActionGoal`` and so on.
    """
    for part in (*_ACTIONLIB, *CONTENTS["action"]):
        action = name.removesuffix(part)
        path = folder / f"{action.rpartition('/')[2]}.action"
        if action != name and path.is_file():
            sections = zip(CONTENTS["action"], read_sections(path, "action"), strict=True)
            definitions = {
                f"{action}{part_suffix}": parse_definition(text, f"{action}{part_suffix}", World.ROS1)
                for part_suffix, text in sections
            }
            return definitions | actionlib_messages(action)
    return None


def actionlib_names(stems: Iterable[str]) -> list[str]:
    """Return the short names of the ROS 1 messages of ``.action`` files with these stems."""
    return [stem + part for stem in stems for part in (*CONTENTS["action"], *_ACTIONLIB)]


def read_sections(path: Path, kind: str) -> list[str]:
    """Return the texts of a service's or an action's parts; raises `MessageTypeError`.

    In a service only the first separator counts, as in genmsg.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as err:
        raise MessageTypeError(f"cannot read {path}: {err}") from None
    sections = split_parts(text)
    if kind == "srv" and len(sections) > 2:
        sections[1:] = ["".join(sections[1:])]
    if len(sections) != len(CONTENTS[kind]):
        raise MessageTypeError(f"{path} has {len(sections)} parts separated by '---' instead of {len(CONTENTS[kind])}")
    return sections

"""Messages that ROS 2 makes of services and actions: ``pkg/srv/Name_Request``, ``pkg/action/Name_FeedbackMessage`` ...

The parts are those of ``rosidl_parser.definition`` (jazzy): a service has request, response and event; an action has
goal, result, feedback, the services send_goal and get_result, and the feedback message.
"""

from __future__ import annotations

from pathlib import Path

from bridge.messages.definition import Definition, World
from bridge.messages.errors import MessageTypeError
from bridge.messages.parser import parse_definition, split_parts

_EVENT = "service_msgs/ServiceEventInfo info\n{base}_Request[<=1] request\n{base}_Response[<=1] response\n"
_ACTION_PARTS = {
    "SendGoal_Request": "unique_identifier_msgs/UUID goal_id\n{base}_Goal goal\n",
    "SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    "SendGoal_Event": _EVENT.replace("{base}", "{base}_SendGoal"),
    "GetResult_Request": "unique_identifier_msgs/UUID goal_id\n",
    "GetResult_Response": "int8 status\n{base}_Result result\n",
    "GetResult_Event": _EVENT.replace("{base}", "{base}_GetResult"),
    "FeedbackMessage": "unique_identifier_msgs/UUID goal_id\n{base}_Feedback feedback\n",
}


def find_part(folder: Path, name: str, short: str) -> dict[str, Definition] | None:
    """One message of a service or action whose file is in ``folder``; None where there is none.

    Args:
        folder: the package's ``srv`` or ``action`` folder.
        name: full name, ``pkg/srv/Name_Request``.
        short: the last part of the name.
    """
    package, kind, _ = name.split("/")
    base = short.split("_", 1)[0]
    part = short.removeprefix(base).removeprefix("_")
    path = folder / f"{base}.{kind}"
    if not part or not path.is_file():
        return None
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as err:
        msg = f"cannot read {path}: {err}"
        raise MessageTypeError(msg) from None
    sections = split_parts(text)
    own = ("Request", "Response") if kind == "srv" else ("Goal", "Result", "Feedback")
    if len(sections) != len(own):
        msg = f"{path} has {len(sections)} parts separated by '---' instead of {len(own)}"
        raise MessageTypeError(msg)
    if part in own:
        return {name: parse_definition(sections[own.index(part)], name, World.ROS2)}
    made = _ACTION_PARTS.get(part) if kind == "action" else _EVENT if part == "Event" else None
    if made is None:
        return None
    return {name: parse_definition(made.format(base=f"{package}/{kind}/{base}"), name, World.ROS2)}

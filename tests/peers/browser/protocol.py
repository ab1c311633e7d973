"""The console's protocol as types, with which the tests check every message, and the published JSON Schema.

``python -m tests.peers.browser.protocol > docs/operate/console_protocol.schema.json`` writes the schema.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, TypeAdapter, create_model

Name = Annotated[str, Field(min_length=1, max_length=255)]
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
Count = Annotated[int, Field(ge=0)]
Corner = Annotated[list[Number], Field(min_length=2, max_length=2)]
Points = list[float]
Run = Annotated[list[int | None], Field(min_length=4, max_length=5)]


class Model(BaseModel):
    """An object with these keys and no others."""

    model_config = ConfigDict(extra="forbid", strict=True)


class NoArgs(Model):
    """No arguments."""


class Pose(Model):
    x: Number
    y: Number
    theta: Number


# -- feeds -------------------------------------------------------------------------------------------------------------


class Robot(Model):
    pose: Pose
    footprint: list[Corner]


class OtherRobot(Model):
    name: str
    pose: Pose | None
    footprint: list[Corner] | None = None
    path: Points | None = None
    why: str | None = None


class OnMap(Model):
    """Points on the map: x, y, x, y, ..."""

    points: Points


class Obstacles(Model):
    points: Points
    size: float


class Layer(Model):
    origin: Pose
    size: float
    runs: list[list[float | None]]


State = Literal["idle", "preparing_before_move", "moving", "waiting_obstacle", "goal_reached", "aborted", "failing",
                "paused", "thinking", "error"]  # fmt: skip


class Driving(Model):
    state: State
    reason: str
    goal: Pose | None
    distance: float | None
    planner: str
    planners: list[str]


class Tiles(Model):
    size: Count
    tiles: list[list[str | None]]


class Map(Model):
    name: str
    width: Count
    height: Count
    resolution: float
    origin: Pose
    image: Tiles
    flags: Tiles | None


class Place(Pose):
    map: str


class Shape(Model):
    map: str
    points: list[Corner]


class Places(Model):
    locations: dict[str, Place]
    areas: dict[str, Shape]
    paths: dict[str, Shape]


class Patrol(Model):
    state: Literal["drives", "waits", "held", "ended"]
    places: list[str]
    at: Count
    round: Count
    wait: float
    why: str


class Maps(Model):
    names: list[str]
    current: str


class Worker(Model):
    daemon: str
    worker: str
    state: str | None
    text: str
    cpu: float | None
    rss: int | None
    restarts: int | None
    side: str | None


class Machine(Model):
    daemon: str
    name: str | None
    address: str | None
    trusted: bool | None


class Endpoint(Model):
    daemon: str
    way: str | None
    endpoint: str | None
    state: str | None
    reason: str | None
    cure: str | None
    machine: str | None
    since: float | None


class Route(Model):
    daemon: str
    side: str | None
    direction: str | None
    topic: str | None
    hub_topic: str | None
    type: str | None
    kind: str | None
    state: str | None
    rate: float | None
    error: str | None
    bytes_per_second: int
    dropped: int
    drops: dict[str, int] | None
    latency: float | None
    way: str | None
    why: str | None


class Refused(Model):
    side: str | None
    topic: str | None
    type: str | None
    reason: str | None
    cure: str | None


class Status(Model):
    workers: list[Worker]
    machines: list[Machine]
    endpoints: list[Endpoint]
    routes: list[Route]
    refused: list[Refused]


class Topic(Model):
    topic: str
    type: str
    publishers: Count
    subscribers: Count


class Service(Model):
    service: str
    type: str
    servers: Count
    clients: Count


class Message(Model):
    type: str
    message: dict[str, JsonValue]
    rate: float | None


class Picture(Model):
    type: str
    width: Count
    height: Count
    encoding: str
    frame: str
    range: list[float] | None
    image: Annotated[str, Field(pattern="^data:image/")]
    rate: float | None


class Frame(Model):
    name: str
    parent: str
    age: float | None
    rate: float | None
    parents: list[str]


class Position(Model):
    x: float
    y: float
    z: float


class Rotation(Position):
    w: float


class Angles(Model):
    roll: float
    pitch: float
    yaw: float


class FramePose(Model):
    position: Position
    rotation: Rotation
    angles: Angles
    age: float | None


class Log(Model):
    last: Count
    workers: list[str]


FEEDS: dict[str, Any] = {
    "robot": Robot, "robots": list[OtherRobot], "laser": OnMap, "path": OnMap, "obstacles": Obstacles,
    "layer": Layer,
    "driving": Driving, "map": Map, "places": Places, "patrol": Patrol, "maps": Maps, "status": Status,
    "topics": list[Topic], "frames": list[Frame], "log": Log, "services": list[Service],
}  # fmt: skip
PATTERNS: dict[str, Any] = {"^topic:/": Message, "^image:[0-9]+:/": Picture, "^pose:.+>.+": FramePose}


# -- verbs -------------------------------------------------------------------------------------------------------------


class Decision(Model):
    daemon: str
    side: str
    direction: str
    decision: str
    why: str
    cure: str
    users: list[str]


class Line(Model):
    n: Count
    time: float
    level: Literal["debug", "info", "warning", "error"]
    worker: str
    text: str


class Lines(Model):
    last: Count
    lines: list[Line]


class Finding(Model):
    check: str
    title: str
    result: Literal["ok", "warn", "fail", "skip"]
    seen: str
    cure: str


class Problem(Model):
    file: str
    line: int | None
    column: int | None
    key: str
    text: str


class ConfigText(Model):
    file: str | None
    text: str | None
    why: str
    problems: list[Problem]


class DefinedField(Model):
    name: str
    base: str
    shape: Literal["single", "array", "sequence"]
    length: Count
    bound: Count
    default: JsonValue


class Constant(Model):
    name: str
    base: str
    value: bool | int | float | str


class DefinedType(Model):
    fields: list[DefinedField]
    constants: list[Constant]


class Definition(Model):
    type: str
    root: str
    response: str | None = None
    types: dict[str, DefinedType]


class Painted(Model):
    changed: Count
    undo: list[Run]


class Imported(Model):
    done: bool
    maps: list[str]
    taken: list[Annotated[list[str], Field(min_length=2, max_length=2)]]


class Exported(Model):
    key: str
    file: str
    size: Count


_KIND = (Literal["location", "area", "path"], "location")
VERBS: dict[str, tuple[dict[str, Any], Any]] = {
    "goto": ({"x": Number, "y": Number, "theta": (Number, 0.0)}, str),
    "goto_place": ({"name": Name}, str),
    "patrol": (
        {"places": Annotated[list[Name], Field(min_length=2, max_length=50)],
         "wait": (Literal[0] | Annotated[float, Field(ge=1.0, le=3600.0)], 2.0)},
        str,
    ),
    "stop": ({}, str),
    "pause": ({}, str),
    "resume": ({}, str),
    "halt": ({}, str),
    "choose_planner": ({"name": Name}, str),
    "set_pose": ({"x": Number, "y": Number, "theta": Number}, str),
    "keep_place": ({"name": Name, "x": Number, "y": Number, "theta": Number, "replace": (bool, False)}, str),
    "keep_area": (
        {"name": Name, "points": Annotated[list[Corner], Field(min_length=3, max_length=500)],
         "replace": (bool, False)},
        str,
    ),
    "rename_place": ({"name": Name, "to": Name, "kind": _KIND}, str),
    "delete_place": ({"name": Name, "kind": _KIND}, str),
    "paint_flags": (
        {"map": Name, "size": Annotated[list[Count], Field(min_length=2, max_length=2)],
         "runs": Annotated[list[Run], Field(min_length=1, max_length=2000)]},
        Painted,
    ),
    "use_map": ({"name": Name}, str | None),
    "rename_map": ({"name": Name, "to": Name}, str),
    "upload": ({}, str),
    "upload_part": (
        {"key": Name, "file": Annotated[str, Field(min_length=1, max_length=200)], "at": Count,
         "data": Annotated[str, Field(max_length=48_000)]},
        Count,
    ),
    "import_map": ({"key": Name, "name": (Name, None), "replace": (bool, False), "use": (bool, False)}, Imported),
    "export_map": ({"name": Name}, Exported),
    "download_part": ({"key": Name, "at": Count}, str),
    "ping": ({}, None),
    "explain": ({"name": Name}, list[Decision]),
    "log": (
        {"after": (Count, 0), "level": (Literal["debug", "info", "warning", "error"], "debug"),
         "worker": (Annotated[str, Field(max_length=200)], ""), "text": (Annotated[str, Field(max_length=200)], "")},
        Lines,
    ),
    "doctor": ({}, list[Finding]),
    "config": ({}, ConfigText),
    "definition": ({"type": Name, "kind": (Literal["topic", "service"], "topic")}, Definition),
    "publish": ({"topic": Name, "type": Name, "message": dict[str, JsonValue]}, str),
    "call_service": ({"name": Name, "type": Name, "request": dict[str, JsonValue]}, dict[str, JsonValue]),
}  # fmt: skip
"""Each verb's arguments, optional ones with their default value, and its return value."""


# -- messages ----------------------------------------------------------------------------------------------------------


class Speed(Model):
    x: float
    y: float
    turn: float


class Hello(Model):
    op: Literal["hello"]
    daemon: str
    version: str
    role: Literal["watch", "drive"]
    who: str
    frame: str
    hold_seconds: float
    speed: Speed


class Done(Model):
    op: Literal["reply"]
    id: int
    ok: Literal[True]
    value: JsonValue


class Failed(Model):
    op: Literal["reply"]
    id: int
    ok: Literal[False]
    error: str


class Held(Model):
    op: Literal["held"]
    x: float
    y: float
    turn: float


class Error(Model):
    op: Literal["error"]
    error: str


class NoValue(Model):
    op: Literal["value"]
    feed: str
    n: Count
    value: None
    why: str


class Watch(Model):
    op: Literal["watch", "unwatch"]
    feed: str


class Took(Model):
    op: Literal["took"]
    feed: str
    n: int


class Hold(Model):
    op: Literal["hold"]
    x: float
    y: float
    turn: float


class Release(Model):
    op: Literal["release"]


def _title(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def _value(name: str, feed: Any, value: Any) -> type[Model]:
    keys: dict[str, Any] = {"op": Literal["value"], "feed": feed, "n": Count, "value": value}
    return create_model(f"{name}Value", __base__=Model, **keys)


def _args(verb: str) -> type[Model]:
    args = {key: kind if isinstance(kind, tuple) else (kind, ...) for key, kind in VERBS[verb][0].items()}
    fields: dict[str, Any] = args
    return create_model(f"{_title(verb)}Args", __base__=Model if args else NoArgs, **fields)


def _call(verb: str) -> type[Model]:
    args = _args(verb)
    needed = any(not isinstance(kind, tuple) for kind in VERBS[verb][0].values())
    kind: Any = args if needed else (args, Field(default_factory=args))
    keys: dict[str, Any] = {"op": Literal["call"], "id": int, "verb": Literal[verb], "args": kind}
    return create_model(f"{_title(verb)}Call", __base__=Model, **keys)


_VALUES = [_value(_title(name), Literal[name], value) for name, value in FEEDS.items()] + [
    _value(value.__name__, Annotated[str, Field(pattern=pattern)], value) for pattern, value in PATTERNS.items()
]
_CALLS = {verb: _call(verb) for verb in VERBS}


def _union(kinds: list[Any]) -> Any:
    union = kinds[0]
    for kind in kinds[1:]:
        union = union | kind
    return union


FROM_CONSOLE: TypeAdapter[Any] = TypeAdapter(_union([Hello, Done, Failed, Held, Error, NoValue, *_VALUES]))
FROM_PAGE: TypeAdapter[Any] = TypeAdapter(_union([Watch, Took, Hold, Release, *_CALLS.values()]))
_RESULTS: dict[str, TypeAdapter[Any]] = {verb: TypeAdapter(value) for verb, (_, value) in VERBS.items()}


def check_said(message: dict[str, Any]) -> None:
    """Raise `pydantic.ValidationError` if a message from the console violates the protocol."""
    FROM_CONSOLE.validate_python(message)


def check_done(verb: str, args: dict[str, Any], value: Any) -> None:
    """Check a successful call: its arguments and its value."""
    FROM_PAGE.validate_python({"op": "call", "id": 1, "verb": verb, "args": args})
    _RESULTS[verb].validate_python(value)


def schema() -> dict[str, Any]:
    """Return the JSON Schema of all messages. The console may add keys."""
    from_console, from_page = (adapter.json_schema() for adapter in (FROM_CONSOLE, FROM_PAGE))
    results = {f"{_title(verb)}Result": definition.json_schema() for verb, definition in _RESULTS.items()}
    defs: dict[str, Any] = {}
    for name, definition in results.items():
        from_console.setdefault("$defs", {}).update(definition.pop("$defs", {}))
        from_console["$defs"][name] = definition
    for name, definition in from_console.pop("$defs").items():
        defs[name] = _open(definition)
    defs.update(from_page.pop("$defs"))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "The console's protocol, midspan.console.1",
        "description": "A message is one of from_console or from_page. A call's value is the verb's ...Result.",
        "oneOf": [{"$ref": "#/$defs/from_console"}, {"$ref": "#/$defs/from_page"}],
        "$defs": {"from_console": from_console, "from_page": from_page, **defs},
    }


def _open(value: Any) -> Any:
    """Return a schema whose objects may have further keys."""
    if isinstance(value, dict):
        return {key: _open(item) for key, item in value.items() if (key, item) != ("additionalProperties", False)}
    return [_open(item) for item in value] if isinstance(value, list) else value


def text() -> str:
    """Return the content of the schema's file."""
    return json.dumps(schema(), indent=2) + "\n"


if __name__ == "__main__":
    print(text(), end="")

"""Definitions of types: texts from connection headers and the hub, names, files of mapping rules, IDL."""

from __future__ import annotations

from bridge.messages.errors import ConversionError, MessageTypeError
from tests.fuzz.target import Subject, Target, scratch, texts

_LINE = "=" * 80
_WORDS = texts(
    _LINE + "\nMSG: ", "\nMSG: a_msgs/B\n", "std_msgs/Header header\n", "float64[9] k\n", "string<=5[<=3] s\n",
    "[]", "[3]",
    "[<=3]", "<=7", "byte X=1\n", 'string S="a#b" # c\n', "time t\n", "duration d\n", "wstring w\n", "a_msgs/A a\n",
    "Header h\n",
    "bool b true\n", "int8[] n [1, 2]\n", "\r\n", "uint8[268435456] x\n", "builtin_interfaces/Time t\n",
    "a/msg/B b\n", "\x00",
)  # fmt: skip
_SEEDS = [
    "string data\n",
    "std_msgs/Header header\nuint32 height\nuint8[] data\nfloat64[36] covariance\n" + _LINE
    + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n",
    "int32 A=1\nstring B=text # not a comment\nbyte C=-1\na_msgs/B[] parts\n" + _LINE + "\nMSG: a_msgs/B\nfloat32 x\n",
    'string<=5 text "abc"\nint32[<=2] numbers [1, 2]\nfloat64[3] v [0.1, 0.2, 0.3]\nbool on true\nwstring w "x"\n',
    "B b\n" + _LINE + "\nMSG: a_msgs/B\nC c\n" + _LINE + "\nMSG: a_msgs/C\nint8 A=1\nint8 one\nint8[] more\n",
]  # fmt: skip


def _definition() -> Subject:
    """A full definition: parsed, written, parsed again, hashed and, for ROS 2 (first byte ``2``), compiled."""
    from bridge.messages.definitions.hashes import md5_sum, rihs01
    from bridge.messages.definitions.schema import World
    from bridge.messages.definitions.text import closure, full_text, parse_full
    from bridge.messages.transcode.compiler import compile_check

    names = {World.ROS1: "a_msgs/A", World.ROS2: "a_msgs/msg/A"}

    def parse(data: bytes) -> None:
        world = World.ROS2 if data[:1] == b"2" else World.ROS1
        definitions = parse_full(data[1:].decode(errors="replace"), names[world], world)
        schema = closure(definitions[names[world]], definitions)
        text = full_text(schema)
        again = parse_full(text, names[world], world)
        mark = rihs01 if world is World.ROS2 else md5_sum
        assert mark(closure(again[names[world]], again)) == mark(schema), text
        if world is World.ROS2:
            compile_check(schema).assemble()

    seeds = [world + text.encode() for text in _SEEDS for world in (b"1", b"2")]
    return Subject(parse, seeds, (MessageTypeError,), _WORDS)


def _header_type() -> Subject:
    """A ROS 1 publisher's type: a line with its name, a line with its md5, and the definition."""
    from bridge.messages.registry import Registry

    registry, since = Registry(), 0

    def parse(data: bytes) -> None:
        nonlocal registry, since
        if since % 300 == 0:
            registry = Registry()
        since += 1
        name, _, remainder = data.decode(errors="replace").partition("\n")
        md5, _, definition = remainder.partition("\n")
        conversion = registry.ros1_to_hub(name, md5, definition)
        assert conversion.convert is not None
        for message in (b"", bytes(64), b"\xff" * 64):
            try:
                conversion.convert(message)
            except ConversionError:
                continue

    seeds = texts(*(f"{name}\n*\n{text}" for text in _SEEDS for name in ("a_msgs/A", "std_msgs/String", "A_msgs/a_b")))
    return Subject(parse, seeds, (MessageTypeError,), [*_WORDS, b"*\n", b"992ce8a1687cec8c8bd883ec73ca41d1\n", b"\n"])


def _hub_type() -> Subject:
    """A type from a worker on the hub: its name and definition."""
    from bridge.messages.registry import Registry

    registry, since = Registry(), 0

    def parse(data: bytes) -> None:
        nonlocal registry, since
        if since % 300 == 0:
            registry = Registry()
        since += 1
        name, _, definition = data.decode(errors="replace").partition("\n")
        registry.learn_ros2(name, definition)
        convert = registry.hub_to_ros1(name).convert
        assert convert is not None
        for message in (b"\0\1\0\0", b"\0\1\0\0" + bytes(64), b"\0\1\0\0" + b"\xff" * 64):
            try:
                convert(message)
            except ConversionError:
                continue

    seeds = texts(*(f"{name}\n{text}" for text in _SEEDS for name in ("a_msgs/msg/A", "a_msgs/srv/A_Request")))
    return Subject(parse, seeds, (MessageTypeError,), _WORDS)


def _hub_service() -> Subject:
    """A service or part of an action from a worker on the hub: its name and definition."""
    from bridge.messages.registry import Registry

    registry, since = Registry(), 0

    def parse(data: bytes) -> None:
        nonlocal registry, since
        if since % 300 == 0:
            registry = Registry()
        since += 1
        name, _, definition = data.decode(errors="replace").partition("\n")
        registry.learn_ros2(name, definition)
        if name.endswith("_FeedbackMessage"):
            registry.hub_to_ros1(name)
            return
        conversion = registry.service_hub_to_ros1(name)
        assert conversion.request_to_side is not None
        registry.hub_service_check(name)
        for message in (b"\0\1\0\0", b"\0\1\0\0" + bytes(64), b"\0\1\0\0" + b"\xff" * 64):
            try:
                conversion.request_to_side(message)
            except ConversionError:
                continue

    line = "=" * 80
    uuid = f"{line}\nMSG: unique_identifier_msgs/UUID\nuint8[16] uuid\n"
    goal = f"{line}\nMSG: a_acts/action/A_Goal\nint32 order\n"
    seeds = texts(
        *(f"a_msgs/srv/A\n{text}---\n{text}" for text in _SEEDS),
        f"a_acts/action/A_SendGoal\nunique_identifier_msgs/UUID goal_id\na_acts/action/A_Goal goal\n{uuid}{goal}"
        "---\nbool accepted\nbuiltin_interfaces/Time stamp\n",
        "a_acts/action/A_FeedbackMessage\nunique_identifier_msgs/UUID goal_id\na_acts/action/A_Feedback feedback\n"
        f"{uuid}{line}\nMSG: a_acts/action/A_Feedback\nfloat64 way\n",
    )
    return Subject(parse, seeds, (MessageTypeError,), [*_WORDS, b"---\n", b"\n---\n", b"_Goal", b"_SendGoal"])


def _service_file() -> Subject:
    """``.srv`` and ``.action`` files; the first byte selects the kind and the part."""
    from bridge.messages.definitions.parts import find_part

    folder = scratch()
    names = ["a_msgs/srv/A_Request", "a_msgs/srv/A_Response", "a_msgs/srv/A_Event", "a_msgs/action/A_Goal",
             "a_msgs/action/A_FeedbackMessage", "a_msgs/action/A_GetResult_Response"]  # fmt: skip

    def parse(data: bytes) -> None:
        name = names[data[0] % len(names)] if data else names[0]
        kind = name.split("/")[1]
        (folder / f"A.{kind}").write_bytes(data[1:])
        assert find_part(folder, name) is not None

    seeds = [b"\0int64 a\nint64 b\n---\nint64 sum\n", b"\3int32 order\n---\nint32[] sequence\n---\nint32[] partial\n"]
    return Subject(parse, seeds, (MessageTypeError,), [*_WORDS, b"---\n", b"\n---\n"], largest=2048)


def _idl() -> Subject:
    """ROS 2's ``.idl`` files, which rosbags parses."""
    from bridge.messages.definitions.sources import parse_idl

    def parse(data: bytes) -> None:
        parse_idl(data.decode(errors="replace"), "a_msgs/msg/A")

    seeds = texts(
        "module a_msgs {\n  module msg {\n    struct A {\n"
        "      double x;\n      sequence<float, 3> y;\n    };\n  };\n};\n",
        '#include "b_msgs/msg/B.idl"\nmodule a_msgs { module msg {\n module A_Constants { const int32 N = 3; };\n'
        ' typedef double d__3[3];\n @verbatim(language="comment", text="x")\n'
        " struct A { b_msgs::msg::B b; d__3 v; string<5> s;"
        " @default(value=2) int16 n; };\n};};\n",
    )
    tokens = texts(
        "module", "struct A {", "};", "sequence<", ">", "@key", "typedef", "const", "::", "[3]", '"', "/*", "*/", "//"
    )
    return Subject(parse, seeds, (MessageTypeError,), tokens, largest=600)


def _mapping_rules() -> Subject:
    """Files of mapping rules: those of ros1_bridge, and those about versions."""
    from bridge.messages.mapping.rules import Rules
    from bridge.messages.mapping.version_rules import VersionRules

    file = scratch() / "rules.yaml"

    def parse(data: bytes) -> None:
        file.write_bytes(data)
        rules = Rules([file])
        rules.ros2_names("a_msgs/A")
        rules.ros1_names("b_msgs/msg/B")
        rules.fields("a_msgs/A", "b_msgs/msg/B")
        list(VersionRules([file]).fields("b_msgs/msg/B", "b_msgs/msg/B"))

    seeds = texts(
        "-\n  ros1_package_name: a_msgs\n  ros2_package_name: b_msgs\n",
        "- {ros1_package_name: a_msgs, ros1_message_name: A, ros2_package_name: b_msgs, ros2_message_name: B,\n"
        "   fields_1_to_2: {x: y, header.stamp: stamp}}\n",
        "- ros1_package_name: a\n  ros1_service_name: S\n  ros2_package_name: b\n  ros2_service_name: T\n"
        "  request_fields_1_to_2:\n    a: b\n",
        "- {message: b_msgs/msg/B, fields: {x: y.z}, defaults: {a: [1, 2.5, b]}}\n"
        "- {messages: [b_msgs/srv/B_Request, b_msgs/srv/C_Request], fields: {}}\n",
        "- {ros1_package_name: a, ros1_action_name: S, ros2_package_name: b, ros2_action_name: T,\n"
        "   goal_fields_1_to_2: {a: b}, result_fields_1_to_2: {}}\n",
    )
    tokens = texts(
        "- ",
        "&a ",
        "*a",
        "!!python/object:os.system ",
        "? ",
        ": ",
        "[",
        "{",
        "null",
        "<<: ",
        "\t",
        "--- ",
        "fields_1_to_2: ",
    )
    return Subject(parse, seeds, (MessageTypeError,), tokens, largest=1024)


def _any_type() -> Subject:
    """A definition, ``~``, and a message of the type, whose conversion is compiled and run."""
    from bridge.messages.json import from_json
    from bridge.messages.mapping.fields import pair_types
    from bridge.messages.mapping.rules import Rules
    from bridge.messages.registry import Registry
    from bridge.messages.transcode.compiler import compile_check, compile_pair
    from bridge.messages.transcode.conversion import make_vm
    from tests.fuzz.machines import guard
    from tests.messages.samples import sample

    rules = Rules()
    registry, since = Registry(), 0

    def parse(data: bytes) -> None:
        nonlocal registry, since
        if since % 300 == 0:
            registry = Registry()
        since += 1
        text, _, message = data.partition(b"~\n")
        registry.learn_ros1("a_msgs/A", text.decode(errors="replace"))
        ros1 = registry.ros1_schema("a_msgs/A")
        ros2 = registry._messages.to_ros2(ros1)
        table = pair_types(ros1, ros2, rules)
        to_ros2 = compile_pair(ros1, ros2, lambda a, b: table[a, b].fields)
        to_ros1 = compile_pair(
            ros2, ros1, lambda a, b: [(ros2_field, ros1_field) for ros1_field, ros2_field in table[b, a].fields]
        )
        guard(message)
        refusals: list[ConversionError] = []
        for program in (to_ros2, to_ros1, compile_check(ros2)):
            try:
                make_vm(program).convert(message)
            except ConversionError as err:
                refusals.append(err)
        if len(refusals) == 3:
            raise refusals[0]

    seeds = []
    for text in (seed for seed in _SEEDS if "wstring" not in seed):
        registry = Registry()
        conversion = registry.ros1_to_hub("a_msgs/A", "*", text)
        cdr = from_json(registry, conversion.target.name, sample(registry.schema(conversion.target.name)))
        convert = registry.hub_to_ros1(conversion.target.name).convert
        assert convert is not None
        seeds += [text.encode() + b"~\n" + message for message in (cdr, convert(cdr))]
    tokens = [*_WORDS, b"~\n", b"\0\1\0\0", b"\3\0\0\0", b"\0\0\0\0"]
    return Subject(parse, seeds, (MessageTypeError, ConversionError), tokens, 2048)


TARGETS = (
    Target("any_type", 4_000, _any_type),
    Target("definition", 12_000, _definition),
    Target("header_type", 3_000, _header_type),
    Target("hub_type", 3_000, _hub_type),
    Target("hub_service", 2_000, _hub_service),
    Target("service_file", 4_000, _service_file),
    Target("idl", 300, _idl),
    Target("mapping_rules", 1_500, _mapping_rules),
)

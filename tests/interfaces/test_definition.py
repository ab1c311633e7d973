"""The definitions that the builder accepts, and its errors for invalid ones."""

from __future__ import annotations

import pytest

from bridge.interfaces.definition import BuildError, read_package

FAULTS = [
    ("my_msgs", "msg/A.msg", "string name\nflaot32[ x", "my_msgs/msg/A.msg:2", "flaot32"),
    ("my_msgs", "msg/A.msg", "float32", "my_msgs/msg/A.msg:1", "neither"),
    ("my_msgs", "msg/A.msg", "\n# text\nflaot32 x", "my_msgs/msg/A.msg:3", "unknown type 'flaot32'"),
    ("my_msgs", "msg/A.msg", "time stamp", "my_msgs/msg/A.msg:1", "builtin_interfaces/Time"),
    ("my_msgs", "msg/A.msg", "float64 K", "my_msgs/msg/A.msg:1", "not a field's name"),
    ("my_msgs", "msg/A.msg", "float64 a__b", "my_msgs/msg/A.msg:1", "not a field's name"),
    ("my_msgs", "msg/A.msg", "int8 a\nint8 a", "my_msgs/msg/A.msg:2", "twice"),
    ("my_msgs", "msg/A.msg", "int8 low=1", "my_msgs/msg/A.msg:1", "constant's name"),
    ("my_msgs", "msg/A.msg", "int8[2] LOW=1", "my_msgs/msg/A.msg:1", "constant cannot be of type 'int8[2]'"),
    ("my_msgs", "msg/A.msg", "string<=2 LOW='a'", "my_msgs/msg/A.msg:1", "constant cannot be of type 'string<=2'"),
    ("my_msgs", "msg/A.msg", "int8<=3 a", "my_msgs/msg/A.msg:1", "only strings"),
    ("my_msgs", "msg/A.msg", "int8[0] a", "my_msgs/msg/A.msg:1", "not a type"),
    ("my_msgs", "msg/A.msg", "string A=a\\\\", "my_msgs/msg/A.msg:1", "backslash"),
    ("my_msgs", "msg/A.msg", "int8 a \u0663", "my_msgs/msg/A.msg:1", "not plain ASCII"),
    ("my_msgs", "msg/A.msg", 'int8 a\nstring b "x\\ny"', "my_msgs/msg/A.msg:2", "control character"),
    ("my_msgs", "msg/A.msg", 'string[] a ["x", "x\\ny"]', "my_msgs/msg/A.msg:1", "control character"),
    ("my_msgs", "msg/A.msg", 'string a "a"b"', "my_msgs/msg/A.msg:1", "a quote without a backslash"),
    ("my_msgs", "msg/A.msg", 'string a "\\u00e4"', "my_msgs/msg/A.msg:1", "misreads the escapes"),
    ("my_msgs", "msg/A.msg", "string[] a x, y", "my_msgs/msg/A.msg:1", "list in brackets"),
    ("my_msgs", "msg/A.msg", "string A=a\\\\b", "my_msgs/msg/A.msg:1", "misreads its backslash"),
    ("my_msgs", "msg/A.msg", "int8 a\n" * 200_000, "", "more than 1000000 characters"),
    ("my_msgs", "srv/A.srv", "int8 a", "my_msgs/srv/A.srv", "lines '---' is 0; a .srv file must have 1"),
    ("my_msgs", "action/A.action", "---", "my_msgs/action/A.action", "lines '---' is 1; a .action file must have 2"),
    ("my_msgs", "msg/a_b.msg", "int8 a", "", "CamelCase"),
    ("my_msgs", "srv/A.msg", "int8 a", "", "CamelCase"),
    ("my_msgs", "../A.msg", "int8 a", "", "CamelCase"),
    ("My-msgs", "msg/A.msg", "int8 a", "", "not a ROS 2 package name"),
]


@pytest.mark.parametrize(("package", "path", "text", "where", "word"), FAULTS, ids=[fault[4] for fault in FAULTS])
def test_a_fault_is_named_with_its_place(package: str, path: str, text: str, where: str, word: str) -> None:
    with pytest.raises(BuildError) as caught:
        read_package(package, {path: text})
    assert caught.value.where == where
    assert word in str(caught.value)


def test_a_package_without_definitions_is_refused() -> None:
    with pytest.raises(BuildError, match="no definitions"):
        read_package("my_msgs", {})


def test_type_names_get_their_package_and_comments_are_replaced() -> None:
    # the comment on the constant keeps rosidl's parser from merging equal constants of two parts
    text = "# hi\n  Other[<=2]   others # mine\nstd_msgs/msg/Header header\nstring<=4 s 'x'\nint8 A=1\n"
    (definition,) = read_package("my_msgs", {"msg/A.msg": text})
    assert definition.bare.splitlines() == [
        "my_msgs/Other[<=2] others",
        "std_msgs/Header header",
        "string<=4 s 'x'",
        "int8 A=1  # part 1",
    ]
    assert [(r.package, r.name, r.line) for r in definition.references] == [
        ("my_msgs", "Other", 2),
        ("std_msgs", "Header", 3),
    ]
    assert definition.needs == {"std_msgs"}
    assert definition.text == text


def test_services_and_actions_need_the_packages_of_their_implicit_fields() -> None:
    service, action = read_package("my_msgs", {"srv/A.srv": "int8 a\n---\nint8 a", "action/A.action": "---\n---"})[::-1]
    assert service.needs == {"builtin_interfaces", "service_msgs"}
    assert action.needs >= {"action_msgs", "unique_identifier_msgs"}

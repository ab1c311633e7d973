"""The text form of Bottles."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from tests.yarp_compat.portables import PORTABLES
from tests.yarp_compat.wire.content import bottles, typed
from yarp_compat.os.data.bottle import Value
from yarp_compat.wire import tags, text
from yarp_compat.wire.binary import decode
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, is_complete, plain_text, to_text, value_text
from yarp_compat.wire.values import Float32, Group, Int8, Int64, Vocab, Vocab64, entries_of, vocab32, vocab64

MEASURED = (Path(__file__).parents[1] / "data" / "portables.txt").read_text(encoding="utf-8")
PRINTED = re.findall(r"text: (.*)\n(Bottle .*) \(\d+ B\)", MEASURED)
PARSED = re.findall(r"PARSE <(.*)>\n((?:    \[\d+\] code=\d+ <[^>]*>\n)+)", MEASURED)


@pytest.mark.parametrize(("printed", "name"), PRINTED, ids=[name for _, name in PRINTED])
def test_text_is_printed_as_by_real_yarp(printed: str, name: str) -> None:
    values = decode(PORTABLES[name], Profile.YARP4)
    assert to_text(values) == printed
    assert to_text(from_text(printed)) == printed


def test_all_measurements_are_tested() -> None:
    assert len(PRINTED) == 22
    assert len(PARSED) == MEASURED.count("PARSE") == 5


@pytest.mark.parametrize(("given_text", "recorded"), PARSED, ids=[given_text for given_text, _ in PARSED])
def test_text_is_parsed_as_by_real_yarp(given_text: str, recorded: str) -> None:
    expected = re.findall(r"code=(\d+) <([^>]*)>", recorded)
    values = [Value.of(value) for value in from_text(given_text)]
    assert [(str(value.getCode(Profile.YARP4)), value.toString()) for value in values] == expected


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("+", 0), ("--", "--"), ("-.", 0.0), (".", "."), ("..", ".."), ("1-2", 1), ("2026-11-20", 2026), ("1.5-2", 0.0),
        ("010", 8), ("08", 0), ("0x", 0), ("-0x1F", -31), ("0xFFFFFFFF", 2**32 - 1), ("0x1FFFFFFFF", "0x1FFFFFFFF"),
        ("0x1.8", 1.5), ("x1", "x1"), ("e5", "e5"), ("1e", 0.0), ("1e400", math.inf), ("1E3", 1000.0), ("+inf", "+inf"),
        ("-nan", "-nan"), ("infinity", "infinity"), ("1_000", "1_000"), ("٣", "٣"), ("0xg", "0xg"), ("+-1", "+-1"),
        ("9" * 5000, 2**63 - 1), ("-" + "9" * 5000, -(2**63)), ("0x" + "0" * 9, "0x" + "0" * 9), ("2147483648", 2**31),
        ("-9223372036854775808", -(2**63)), ("-9223372036854775809", -(2**63)), ("1.", 1.0), ("True", "True"),
        ("[]", False), ("[1]", True), ("[abcdefghij]", Vocab64("abcdefgh")), ("[x]y", Vocab("x]")), ("{}", b""),
        ("{256 -1 x 1.5 true [a] (1)}", b"\0\xff\0\x011a\0"), ("(a b)c", ["a"]), ('"a"b', 'a"'), ('a"b c"d', 'a"b c"d'),
        (r"\(", "("), (r"\ a", " a"), (r'"\n\r\0\t\\\""', '\n\r\0t\\"'), (r"tr\ue", True), ('"true"', "true"),
        ('"null"', "null"), (r"nul\l", "null"), ("'x'", "'x'"), ("(((1) 2) 3)", [[[1], 2], 3]), ("(,)", []),
    ],
)  # fmt: skip
def test_unusual_numbers_are_parsed_as_in_yarp(word: str, value: Any) -> None:
    """The rules are those of `yarp/os/impl/BottleImpl.cpp` and C's number functions; measured ones are tested above."""
    assert typed(from_text(word)) == typed([value])
    assert typed(from_text(f" x,{word}\t y")) == typed(["x", value, "y"])


@pytest.mark.parametrize("lost", ["(a b", '"a b', "a) b", "{1 2", "x\\", "(a) b)", "", " ,\t\n\r", '"a\\"'])
def test_unclosed_parts_are_dropped(lost: str) -> None:
    values = from_text("first " + lost)
    assert values[0] == "first"
    assert len(values) <= 2
    assert "lost" not in from_text(lost + " lost") or lost in ("", " ,\t\n\r")


@pytest.mark.parametrize(
    ("line", "whole"),
    [
        ('a (b c) {1} "x"', True), ("(a", False), ("a) (", True), ("{1", False), ('"a', False), ('a\\"', True),
        ("", True), ('"(" ")"', True), ('"a\\"', False),
    ],
)  # fmt: skip
def test_unclosed_text_continues_in_the_next_line(line: str, whole: bool) -> None:
    assert is_complete(line) is whole


def test_subclasses_are_printed_as_their_base() -> None:
    assert to_text([Float32(0.1), np.float32(0.5), np.arange(2), (1, 2), Int8(3)]) == (
        "0.100000001490116119385 0.5 (0 1) (1 2) 3"
    )
    assert to_text([{"b": ([1], [2]), "a": (), "c": Group(x=1)}]) == "((a) (b (1) (2)) (c (x 1)))"
    assert to_text([1e21, 1e22, -0.0, 1e-5, 123456789.0]) == "1e+21 1e+22 -0.0 1.0000000000000000818e-05 123456789.0"
    for wrong in (None, object(), {1: 2}, Float32(1e300)):
        with pytest.raises(WireError):
            to_text([wrong])


def test_one_value_is_printed_plain_or_quoted() -> None:
    values = ["a b", Vocab("set"), [1, ["x y"]], b"\x01\x02", 1.5, True, {"k": 1}]
    assert [plain_text(value) for value in values] == ["a b", "set", '1 ("x y")', "1 2", "1.5", "true", "(k 1)"]
    assert value_text("a b") == '"a b"'
    assert plain_text("") == ""


def test_word_null_is_parsed_as_a_vocab() -> None:
    assert to_text(["null"]) == "null"
    assert typed(from_text("null")) == typed([Vocab("null")])


@given(values=bottles)
def test_values_survive_the_text_form(values: list[Any]) -> None:
    printed = to_text(values)
    assume("null" not in printed)  # YARP prints that word unquoted, and parses it as a vocab
    back = from_text(printed)
    assert typed(back) == typed([_without_types(value) for value in values])
    assert to_text(back) == printed
    assert is_complete(printed)


@given(line=st.text(st.sampled_from('ab1.-x0e+ ,\t\n"\\(){}[]é\0'), max_size=40))
@example(line='"\\')
@example(line="a\\ b")
def test_any_text_is_split_like_character_by_character(line: str) -> None:
    """Compare the words with those of the same rules applied to one character after another."""
    assert text.split_words(line)[0] == _slowly_split(line)
    values = from_text(line)
    assert typed(values) == typed(text.TextReader(line).values(line, 0))
    assert isinstance(to_text(values), str)


def test_nesting_of_lists_is_limited() -> None:
    values: list[Any] = []
    for _ in range(tags.MAX_DEPTH):
        values = [values]
    assert from_text(to_text(values)) == values
    for deep in ("(" * 10**6 + ")" * 10**6, "{(" * 1000 + ")}" * 1000):
        with pytest.raises(WireError, match="nested deeper"):
            from_text(deep)
    with pytest.raises(WireError, match="nested deeper"):
        to_text([values])


def test_work_for_a_text_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text, "LARGEST_WORK", 1000)
    assert from_text("(1) " * 1000)[0] == [1]
    with pytest.raises(WireError, match="too deep for its length"):
        from_text("(((((((" + "1 " * 500 + "))))))x)")


def test_long_numbers_are_parsed_quickly() -> None:
    for number in ("1" * 10**6, "0." + "1" * 10**6, "1e" + "9" * 10**6, "+" * 10**6, "0" * 10**6, "-0x" + "0" * 10**6):
        assert len(from_text(number)) == 1


def _without_types(value: Any) -> Any:
    """Remove the types that the text form does not show."""
    if isinstance(value, bool):
        return value
    if isinstance(value, Vocab):
        wire = str(value).encode()
        return vocab32(_number(wire, 4)) if len(wire) <= 4 else vocab64(_number(wire[:8], 8))
    if isinstance(value, int):
        return int(value)
    if isinstance(value, Float32):
        return float(text.rounded(value))
    if isinstance(value, dict):
        return [_without_types(entry) for entry in entries_of(value)]
    return [_without_types(item) for item in value] if isinstance(value, (list, tuple)) else value


def _number(data: bytes, size: int) -> int:
    return int.from_bytes(data.ljust(size, b"\0"), "little", signed=True)


def _slowly_split(line: str) -> list[str]:
    tokens, token = [], ""
    escaped = quoted = False
    level = {"(": 0, "{": 0}
    for char in line + " ":
        if escaped:
            token, escaped = token + char, False
        elif char in " \t\n\r," and (not token or not (quoted or any(level.values()))):
            tokens += [token] if token else []
            token = ""
        else:
            token += char
            escaped = char == "\\"
            quoted ^= char == '"'
            if not quoted and char in "(){}":
                level["(" if char in "()" else "{"] += 1 if char in "({" else -1
    return tokens


def test_text_form_shows_some_types() -> None:
    assert typed(from_text("5 5000000000 [set] [setmap]")) == typed(
        [5, Int64(5000000000), Vocab("set"), Vocab("setmap")]
    )

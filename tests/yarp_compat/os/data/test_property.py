"""Property and Stamp: keys and values from texts, command lines and files."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from tests.yarp_compat.portables import PORTABLES
from yarp_compat.os import config_text
from yarp_compat.os.data.bottle import Bottle, Property, Value
from yarp_compat.os.data.stamp import Stamp
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile


def measured() -> Property:
    property_ = Property()
    property_.put("n", 3)
    property_.put("f", 0.5)
    property_.put("device", "x")
    property_.addGroup("GRP").put("z", 1)
    return property_


def test_a_property_has_the_text_and_bytes_of_real_yarp() -> None:
    property_ = measured()
    assert property_.toString() == "(GRP (z 1)) (device x) (f 0.5) (n 3)"
    assert property_.to_bytes(Profile.YARP4) == PORTABLES["Property"]
    assert Property.from_bytes(PORTABLES["Property"]) == property_
    assert Property(property_.toString()) == property_ == Property(property_)


def test_values_are_put_and_found() -> None:
    property_ = measured()
    property_.put("v", Value.makeVocab32("set"))
    property_.put("list", Value.makeList("1 2"))
    property_.put("flag", True)
    property_.put("n", 4)
    assert property_.find("n").asInt32() == 4
    assert property_.find("v").isVocab32()
    assert property_.find("list").asList() == [1, 2]
    assert property_.find("flag").isInt32()
    assert property_.find("GRP").toString() == "z 1"
    assert property_.findGroup("GRP").find("z").asInt32() == 1
    assert property_.findGroup("n").toString() == "n 4"
    assert property_.find("no").isNull()
    assert property_.findGroup("no").isNull()
    assert property_.check("n")
    assert property_.check("no", Value(5)).asInt32() == 5
    property_.unput("n")
    property_.unput("n")
    assert not property_.check("n")
    property_.clear()
    assert property_.toString() == ""


def test_group_is_changed_in_place() -> None:
    property_ = Property()
    group = property_.addGroup("G")
    group.put("a", 1)
    assert property_.find("G").toString() == "a 1"
    group.put("b", 2)
    group.addGroup("H").put("c", 3)
    assert property_.toString() == "(G (H (c 3)) (a 1) (b 2))"


def test_a_property_is_a_mapping_in_python() -> None:
    property_ = Property({"rate": 10, "names": ["a", "b"], "G": (["x", 1], ["y", 2])})
    assert property_.toString() == "(G (x 1) (y 2)) (names (a b)) (rate 10)"
    assert property_["rate"] == 10
    property_["on"] = True
    del property_["names"]
    assert dict(property_) == {"rate": 10, "G": (["x", 1], ["y", 2]), "on": True}
    assert ("rate" in property_, property_.get("no", 7), len(property_)) == (True, 7, 3)
    assert repr(Property("(a 1)")) == "Property('(a 1)')"
    with pytest.raises(WireError):
        property_["wrong"] = object()


def test_a_received_property_has_the_values_of_its_text() -> None:
    """YARP's Property is converted to text, so small ints and four-byte floats become ordinary ints and floats."""
    wire = Bottle("((a 1) (b 2)) x (n 5 6) (e)").to_bytes()
    received = Property.from_bytes(wire)
    assert received.toString() == "((a 1) (b 2)) (e) (n 5 6)"
    assert received.find("n").asInt32() == 5
    with pytest.raises(WireError):
        received.from_wire(b"nothing")
    assert received.check("n")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--name", "/x", "--rate", "5"], "(name /x) (rate 5)"),
        (["--flag", "--neg", "-5", "--f", "1.5"], "(f 1.5) (flag) (neg -5)"),
        (["lost", "--list", "(1 2)", "three"], "(list (1 2) three)"),
        (["--text", "two words", "--path", "C:\\dir"], '(path "C:\\\\dir") (text "two words")'),
        (["--empty", ""], '(empty "")'),
        (["--G::a", "1", "--G::b::c", "2", "3", "--plain", "4"], "(G (a 1) (b (c 2 3))) (plain 4)"),
        (["--G::a", "1", "--G::a", "2"], "(G (a 2))"),
        (["--a", "1", "--", "lost", "too", "--b", "2"], "(a 1) (b 2)"),
        (["--", "lost"], ""),
        (["---x", "3", "---y", "4"], '("-y" 4) (0 3)'),  # YARP parses -x as a number, like 0x
        (["--[a]", "1", "--b::c", "2"], "([a] 1) (b (c 2))"),
        (["--[a]", "1", "--a::c", "2"], "([a] 1 (c 2))"),
        (["--a::a", "1", "--a::a", "2"], "(a (a 1) (a 2))"),  # the key a finds the group's own name first
        (["--5", "x", "--[set]", "y"], "(5 x) ([set] y)"),
        (["--::b", "1", "--a::", "2", "--5", "lost"], '("" (b 1)) (a 2)'),
    ],
)
def test_options_of_a_command_line_become_keys_and_groups(arguments: list[str], expected: str) -> None:
    property_ = Property("(old 1)")
    property_.fromCommand(["program", *arguments])
    assert property_.toString() == Property(expected).toString()
    property_.fromCommand(["--more", "1"], skipFirst=False, wipe=False)
    assert property_.check("more")
    assert len(property_) == len(Property(expected)) + 1


def test_arguments_in_one_text_and_a_url_are_parsed() -> None:
    property_ = Property()
    property_.fromArguments('--name "/my port" --n 5')
    assert property_.toString() == '(n 5) (name "/my port")'
    property_.fromQuery("http://host:1/page?a=1+2&b=%2Fx%20y&c=", wipe=True)
    assert property_.toString() == '(a "1 2") (b "/x y")'


FILE = """
// a comment
name /robot      // and one after a value
rate = 20        # another
list (1 2
 3)
text "two words // no comment"
home $Y1_HOME/x
twice ${Y1_HOME}y $(Y1_HOME)z
known $rate
odd a#b

[GENERAL]
period 0.02
url "http://x#y"
escaped a\\$b

[PARTS left]
k 1
[PARTS right]
k 2
[GENERAL]
more 1
[]
late 1
"""


def test_a_configuration_file_is_read_as_by_yarp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("Y1_HOME", "/home/y")
    file = tmp_path / "robot.ini"
    file.write_text(FILE)
    property_ = Property("(old 1)")
    assert property_.fromConfigFile(str(file))
    assert property_.find("name").asString() == "/robot"
    assert property_.find("rate").asInt32() == 20
    assert property_.find("list").asList() == [1, 2, 3]
    assert property_.find("text").asString() == "two words // no comment"
    assert property_.find("home").asString() == "/home/y/x"
    assert property_.findGroup("twice").toString() == 'twice "/home/yy" "/home/yz"'
    assert property_.find("known").asInt32() == 20
    assert property_.find("odd").asString() == "a#b"
    assert property_.findGroup("GENERAL").find("period").asFloat64() == 0.02
    assert property_.findGroup("GENERAL").find("url").asString() == "http://x#y"
    assert property_.findGroup("GENERAL").find("escaped").asString() == "a$b"
    assert property_.findGroup("GENERAL").find("more").asInt32() == 1
    assert property_.findGroup("PARTS").toString() == "PARTS left right"
    assert [property_.findGroup(part).find("k").asInt32() for part in ("left", "right")] == [1, 2]
    assert property_.find("late").asInt32() == 1
    assert not property_.check("old")
    assert property_.fromConfigFile(str(file), wipe=False)
    assert property_.fromConfigFile(str(file), False)
    assert property_.findGroup("PARTS").toString() == "PARTS left right left right left right"


def test_windows_line_ends_and_the_callers_values_are_read() -> None:
    property_ = Property()
    property_.fromConfig("a 1\r\n[G]\r\nb $X\r\n", Property("(X 5)"))
    assert property_.toString() == "(G (b 5)) (a 1)"
    property_.fromConfig("a 2\nunclosed (1 2", wipe=False)
    assert property_.find("a").asInt32() == 2


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("k 1 \\\n2 3\n", "(k 1 2 3)"),
        ("k 1 \\\r\n  2 \\\r\n3\r\nb 1", "(b 1) (k 1 2 3)"),
        ("k 1\\\n2", "(k 12)"),
        ("k 1 \\\\\nb 2", '(b 2) (k 1 "\\\\")'),  # an escaped backslash does not continue the line
        ("k (1 \\\n2)", "(k (1 2))"),
        ('k "a \\\nb"', '(k "a b")'),
        ("[G] \\\n\nx 1", "(G (x 1))"),
        ("k 1 # no \\\nb 2", "(k 1)"),  # the comment continues on the next line, too
        ("k 1 \\", "(k 1)"),
    ],
)
def test_backslash_at_the_end_joins_lines(text: str, printed: str) -> None:
    """`InputStream::readLine` of YARP 3.9.1 to 4.0 does this."""
    property_ = Property()
    property_.fromConfig(text)
    assert property_.toString() == printed


def test_file_is_read_identically_on_every_system(tmp_path: Path) -> None:
    file = tmp_path / "robot.ini"
    file.write_bytes("name caf\u00e9 \\\r\n 2\r\nb 1\rc\n".encode())
    property_ = Property()
    assert property_.fromConfigFile(str(file))
    assert property_.toString() == '(b "1c") (name "caf\u00e9" 2)'


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("()", "()"),
        ("(a (b 1)) ()", "() (a (b 1))"),
        ("() (() 2)", "(() 2)"),
        ('(() 1) ("" 2)', '("" 2)'),
        ("([a] 1)", "([a] 1)"),
        ("([a] 1) (a 2)", "(a 2)"),
        ("(a 1) ([a] 2)", "([a] 2)"),
    ],
)
def test_keys_that_are_not_strings_keep_their_type(text: str, printed: str) -> None:
    """Of two keys with the same text, the last one counts, and its type is kept."""
    property_ = Property(text)
    assert property_.toString() == printed
    property_.fromString("(a 3)", False)
    assert property_.findGroup("a").toString() == "a 3"
    property_["a"] = 4
    assert Property(property_.toString()).toString() == property_.toString()


def test_unclosed_line_at_the_end_of_a_file_is_used_unchanged() -> None:
    """As in YARP 3.12.3, comments on that line are not removed, and no group begins."""
    property_ = Property()
    property_.fromConfig(" 3)\nname /x // c\n#\n[G]\n(x 1) 2")
    assert property_.toString() == '("3)name /x // c#[G](x")'


def test_keys_that_are_numbers_stay_numbers() -> None:
    property_ = Property()
    property_.fromConfig("5 x\n[G]\n7 y\n5 z\n")
    assert property_.toString() == "(5 x) (G (7 y) (5 z))"
    assert property_.findGroup("5").get(0).isInt32()
    assert property_.find("5").asString() == "x"
    property_.put("5", 1)
    assert property_.find("5").asInt32() == 1
    assert Property(property_).toString() == property_.toString()


def test_included_files_become_keys_and_groups(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "more.ini").write_text('a 1\n[G]\nb 2\n[include "deep.ini"]\n')
    (tmp_path / "sub" / "deep.ini").write_text("deep 1\n")
    file = tmp_path / "main.ini"
    file.write_text('x 1\n[include "sub/more.ini"]\n[include SUB "sub/more.ini"]\n[include KIND TWO "sub/more.ini"]\n')
    property_ = Property()
    assert property_.fromConfigFile(str(file))
    inner = "(G (b 2)) (a 1) (deep 1)"
    assert property_ == Property(f"{inner} (x 1) (SUB {inner}) (TWO {inner}) (KIND TWO)")
    assert property_.findGroup("SUB").findGroup("G").find("b").asInt32() == 2


def test_a_folder_of_files_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.ini").write_text("[G]\nx 1\n")
    (tmp_path / "b.ini").write_text("y 2\n")
    (tmp_path / "c.txt").write_text("z 3\n")
    property_ = Property()
    assert property_.fromConfigDir(str(tmp_path))
    assert property_.toString() == "(G (x 1)) (y 2)"
    assert property_.fromConfigDir(str(tmp_path), "FILES")
    names = [str(tmp_path / name) for name in ("a.ini", "b.ini")]
    assert list(property_.findGroup("FILES")) == ["FILES", *names]
    assert property_.findGroup(names[1]).find("y").asInt32() == 2


def test_missing_files_and_recursive_includes_are_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    property_ = Property("(old 1)")
    assert not property_.fromConfigFile(str(tmp_path / "none.ini"))
    assert not property_.fromConfigDir(str(tmp_path / "none"), "X")
    assert property_.check("old")
    assert "cannot read" in caplog.text
    (tmp_path / "self.ini").write_text('n 1\n[include "self.ini"]\n')
    assert property_.fromConfigFile(str(tmp_path / "self.ini"))
    assert f"more than {config_text.DEEPEST} deep" in caplog.text
    assert property_.find("n").asInt32() == 1


def test_a_stamp_is_written_read_and_updated() -> None:
    stamp = Stamp(5, 123.5)
    assert (stamp.getCount(), stamp.getTime(), stamp.isValid()) == (5, 123.5, True)
    assert stamp.to_bytes(Profile.YARP4) == PORTABLES["Stamp"]
    assert Stamp.from_bytes(PORTABLES["Stamp"]) == stamp
    for profile in Profile:
        assert Stamp.from_bytes(stamp.to_bytes(profile)) == stamp
        assert Stamp.from_bytes(Bottle("7 1.5 frame").to_bytes(profile)) == Stamp(7, 1.5)
    before = time.time()
    stamp.update()
    assert stamp.getCount() == 6
    assert before <= stamp.getTime() <= time.time()
    last = Stamp(stamp.getMaxCount(), 1.0)
    last.update(2.0)
    assert tuple(last) == (0, 2.0)
    fresh = Stamp()
    assert not fresh.isValid()
    fresh.update(1.0)
    assert fresh == Stamp(0, 1.0)


def test_a_stamp_is_read_from_and_written_to_an_envelope() -> None:
    assert Stamp(3580, 1795143618.02289).to_text() == "3580 1795143618.02289"
    stamp = Stamp()
    stamp.from_text("3580 1795143618.02289")
    assert stamp == Stamp(3580, 1795143618.02289)
    stamp.from_text("7 1e3\r\n")
    assert stamp == Stamp(7, 1000.0)
    for wrong in ("", "x 1", "1", "99999999999 1", "1 x", "(1 2)"):
        with pytest.raises(WireError, match="invalid stamp"):
            stamp.from_text(wrong)
        assert not stamp.isValid()
    for wrong in ("1", "1 2 3 4", "1.5 2", "1 2.0 3"):
        with pytest.raises(WireError):
            Stamp.from_bytes(Bottle(wrong).to_bytes())


def test_each_key_has_the_file_and_line_of_its_text(tmp_path: Path) -> None:
    (tmp_path / "inner.ini").write_text("deep 1\n[SUB]\nleaf 2 // comment\n")
    main = tmp_path / "main.ini"
    main.write_text(
        "name = x\n\n[A] # group\nlist (1\n 2)\nafter 3\n"
        '[include "inner.ini"]\n[include B "inner.ini"]\nlast 4\nafter 5\n'
    )
    entries: dict[str, Any] = {}
    places: config_text.Places = {}
    assert config_text.read_file(str(main), entries, None, wipe=True, places=places)
    inner = str(tmp_path / "inner.ini")
    assert {keys: place.line for keys, place in places.items() if place.file == str(main)} == {
        ("name",): 1, ("A",): 3, ("A", "list"): 4, ("A", "after"): 6, ("last",): 9, ("after",): 10,
    }  # fmt: skip
    assert {keys: place.line for keys, place in places.items() if place.file == inner} == {
        ("deep",): 1, ("SUB",): 2, ("SUB", "leaf"): 3, ("B", "deep"): 1, ("B", "SUB"): 2, ("B", "SUB", "leaf"): 3,
    }  # fmt: skip

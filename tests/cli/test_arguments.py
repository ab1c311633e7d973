"""Arguments that start with a minus sign: numbers and points are values, wherever a verb accepts them."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
from pathlib import Path
from typing import Any

import pytest

from bridge.cli.main import VERBS, build_parser, main
from tests.cli.test_main import leaves, verbs_of

NEGATIVE = ("-1.6", "-1.6,0.9", "-.5", "-2e-3", "-1.6,0.9,-0.5", "-inf")


def values(*words: str) -> Any:
    """Parse words with a verb's parser."""
    return build_parser([words[0]]).parse_args(list(words))


def test_points_of_a_polygon_with_and_without_equals() -> None:
    corners = [[-1.6, 0.9], [2.0, -1.0], [-0.5, -3.0]]
    for points in (["--points", "-1.6,0.9", "2,-1", "-.5,-3"], ["--points=-1.6,0.9", "2,-1", "-.5,-3"]):
        for arguments in (["house", *points], [*points, "--flag=keep-out"], ["--flag", "keep-out", "house", *points]):
            assert values("map", "edit-flags", *arguments).points == corners


def test_points_that_are_abbreviated_or_single() -> None:
    assert values("map", "edit-flags", "--poi=-1.6,0.9", "-2,1").points == [[-1.6, 0.9], [-2.0, 1.0]]
    for arguments in (["--circle", "-1.6,0.9,0.5"], ["--circle=-1.6,0.9,0.5"]):
        assert values("map", "edit-flags", *arguments).circle == [-1.6, 0.9, 0.5]


def test_negative_numbers_are_values_and_not_options() -> None:
    assert values("goto", "-1.6e0", "-.9", "-90").where == ["-1.6e0", "-.9", "-90"]
    assert values("goto", "--frame", "odom", "-1.6", "2").where == ["-1.6", "2"]
    assert values("location", "add", "dock", "-1.5", "-2e-1", "-90").pose == [-1.5, -0.2, -90.0]
    assert values("topic", "pub", "/height", "std_msgs/Float32", "-1.5").message == "-1.5"
    assert values("map", "show", "--layer", "-1e-1").layer == -0.1


def test_unknown_options_are_errors(capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["goto", "kitchen", "-z"], ["goto", "kitchen", "--1"], ["map", "edit-flags", "--pints=1,1"]):
        with pytest.raises(SystemExit) as ended:
            values(*command)
        assert ended.value.code == 2
        assert "unrecognized arguments" in capsys.readouterr().err


def test_negative_times_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        values("topic", "pub", "/said", "std_msgs/String", "--settle", "-1")
    assert ended.value.code == 2
    assert "'-1' is not a time" in capsys.readouterr().err


def test_after_two_dashes_nothing_is_an_option() -> None:
    assert values("record", "--", "--topics=/scan").topics == ["--topics=/scan"]


def of_verb(verb: str) -> list[argparse.ArgumentParser]:
    """Return the parsers of a verb and its subverbs."""
    return leaves(verbs_of(build_parser([verb]))[0].choices[verb])


@pytest.mark.parametrize("verb", VERBS)
def test_each_option_with_a_value_accepts_what_starts_like_a_negative_number(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The option may refuse the value with its own message; it must not be reported as missing or unknown."""
    for parser in of_verb(verb):
        for action in parser._actions:
            if not action.option_strings or action.nargs == 0:
                continue
            option, more = action.option_strings[-1], int(action.nargs or 1) - 1 if str(action.nargs).isdigit() else 0
            for value in NEGATIVE:
                for arguments in ([option, value, *[value] * more], [f"{option}={value}", *[value] * more]):
                    try:
                        parser.parse_known_args(arguments)
                    except SystemExit:
                        error = capsys.readouterr().err.splitlines()[-1]
                        assert "expected" not in error, (parser.prog, arguments, error)
                        assert "unrecognized" not in error, (parser.prog, arguments, error)


def error_of(*words: str) -> str:
    """Return the last line of the error for a command line with wrong usage."""
    printed = io.StringIO()
    with contextlib.redirect_stderr(printed), pytest.raises(SystemExit) as ended:
        main(list(words))
    assert ended.value.code == 2
    assert printed.getvalue().startswith("usage: midspan")
    return printed.getvalue().splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "where", "meant"),
    [
        (["stauts"], "midspan: error: unknown command 'stauts'", "status"),
        (["STATUS"], "midspan: error: unknown command 'STATUS'", "status"),
        (["--debug", "exlpain", "/scan"], "midspan: error: unknown command 'exlpain'", "explain"),
        (["echo", "/scan"], "midspan: error: unknown command 'echo'", "topic"),
        (["topic", "ecoh", "/scan"], "midspan topic: error: unknown command 'ecoh'", "echo"),
        (["map", "edit-flag"], "midspan map: error: unknown command 'edit-flag'", "edit-flags"),
        (["yarp", "nmae", "get"], "midspan yarp: error: unknown command 'nmae'", "name"),
        (["status", "--jsn"], "midspan status: error: unrecognized arguments: --jsn", "--json"),
        (["topic", "echo", "/x", "--timout=3"], "midspan topic echo: error: unrecognized", "--timeout"),
        (["--versoin"], "midspan: error: unrecognized arguments: --versoin", "--version"),
        (
            ["location", "list", "--kind", "locaton"],
            "midspan location list: error: argument --kind: invalid",
            "location",
        ),
        (["completion", "bsh"], "midspan completion: error: argument shell: invalid choice: 'bsh'", "bash"),
    ],
)
def test_a_misspelled_verb_option_or_choice_has_its_nearest_name(words: list[str], where: str, meant: str) -> None:
    error = error_of(*words)
    assert error.startswith(where)
    assert re.search(rf"\. Did you mean ([\w-]+, )*{meant}\b", error), error


def test_the_error_has_no_hint_without_a_similar_name() -> None:
    assert error_of("zzz") == "midspan: error: unknown command 'zzz'. 'midspan --help' lists all commands."
    for command in (["status", "--zzz"], ["goto", "kitchen", "-z"], ["status", "extra"], ["topic"]):
        assert "Did you mean" not in error_of(*command)


@pytest.mark.parametrize("verb", VERBS)
def test_each_verb_with_a_configuration_has_its_short_option(verb: str) -> None:
    for parser in of_verb(verb):
        option = parser._option_string_actions.get("--config")
        assert option is parser._option_string_actions.get("-c"), parser.prog


def test_every_command_accepts_the_short_option_of_the_configuration() -> None:
    for command in (["status"], ["run"], ["worker", "ros1"], ["topic", "list"], ["demo"], ["bag", "convert", "a", "b"]):
        for short in (["-c", "my.yaml"], ["-cmy.yaml"]):
            assert values(*command, *short).config == values(*command, "--config", "my.yaml").config == Path("my.yaml")


@pytest.mark.parametrize("words", [["-c", "x.yaml"], ["--config", "x.yaml"], ["--config=x.yaml"]], ids=" ".join)
def test_the_error_for_an_option_before_the_verb_names_its_place(words: list[str]) -> None:
    option = words[0].partition("=")[0]
    assert error_of(*words, "status").endswith(
        f"error: {option} belongs after the command: 'midspan status {option} ...'"
    )


def test_an_unknown_option_without_a_verb_gets_a_hint() -> None:
    assert error_of("--verbose").endswith("unrecognized arguments: --verbose. Did you mean --version?")


@pytest.mark.parametrize(("word", "first"), [("Status", "status"), ("TOPIC", "topic"), ("Config", "config")])
def test_the_verb_itself_is_the_first_proposal(word: str, first: str) -> None:
    assert re.search(rf"Did you mean {first}[,?]", error_of(word))


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (
            ["--router", "localhost:7447"],
            "--router: 'localhost:7447' is not a zenoh endpoint; give protocol and address",
        ),
        (["--router", "tcp/robot1"], "--router: 'tcp/robot1' has no port from 0 to 65535; write it like tcp/robot1:"),
        (["--hub-domain", "500"], "--hub-domain: 500 is not a domain from 0 to 232"),
        (["--hub-domain", "-1"], "--hub-domain: -1 is not a domain from 0 to 232"),
        (["--hub-domain", "lab"], "--hub-domain: 'lab' is not a domain from 0 to 232"),
    ],
)
def test_invalid_hub_options_are_reported(words: list[str], problem: str) -> None:
    assert problem in error_of("status", *words)


@pytest.mark.parametrize(
    "words",
    [
        ["goto", "kitchen", "--timeout"],
        ["dock", "--timeout"],
        ["waypoints", "kitchen", "--timeout"],
        ["map", "explore", "--seconds"],
        ["nav", "startup", "--timeout"],
        ["action", "send", "/a", "--timeout"],
        ["service", "call", "/a", "--timeout"],
        ["topic", "hz", "/a", "--duration"],
        ["tf", "monitor", "--interval"],
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("time", ["nan", "-3", "0", "inf", "soon"])
def test_invalid_times_are_refused_before_anything_is_sent(words: list[str], time: str) -> None:
    assert f"{words[-1]}: {time} is not above 0 and at most 9e+09" in error_of(*words, time)


@pytest.mark.parametrize("time", ["nan", "-1"])
def test_halt_refuses_invalid_times(time: str) -> None:
    assert "is not a time" in error_of("halt", "--seconds", time)
    assert values("halt", "--seconds", "0").seconds == 0.0

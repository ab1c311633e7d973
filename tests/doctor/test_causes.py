"""Lines with the same cause become one line that names everything affected."""

from __future__ import annotations

import pytest

from bridge.doctor.causes import cause, grouped, shared
from bridge.doctor.check import Finding, fail, merged, ok, warn


def test_one_cause_for_twenty_topics_is_one_line() -> None:
    texts = [f"/t{number}: its publisher /move_base does not announce its type: refused" for number in range(20)]
    assert grouped(texts) == [f"{texts[0]} (the same for /t1, /t2, /t3, /t4, /t5 and 14 more)"]


@pytest.mark.parametrize(
    ("texts", "line"),
    [
        (["/a: /n gets nothing: reliable"] * 3, "/a: /n gets nothing: reliable"),
        (["/a: /n gets nothing: x", "/a: /m gets nothing: x"], "/a: /n gets nothing: x (the same for /m)"),
        (["/a: /n is deaf", "/b: /m is deaf", "/b: /o is deaf"], "/a: /n is deaf (the same for /b)"),
        (
            ["/a: no answer of http://robot:40123/", "/a: no answer of http://robot:40124/"],
            "/a: no answer of http://robot:40123/ (the same for http://robot:40124/)",
        ),
        (["parameter /a/b: too long", "parameter /c: too long"], "parameter /a/b: too long (the same for /c)"),
        (["goals to /go.", "goals to /stop."], "goals to /go. (the same for /stop)"),
    ],
)
def test_problems_with_the_same_cause_are_one_line(texts: list[str], line: str) -> None:
    assert grouped(texts) == [line]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("/a: unknown type std_msgs/Odd", "/a: unknown type std_msgs/Even"),
        ("/a: it asks for reliable", "/a: it asks for transient local"),
        ("the disk is full", "the disk is read-only"),
    ],
)
def test_other_causes_stay_apart(one: str, other: str) -> None:
    assert cause(one) != cause(other)
    assert grouped([one, other]) == [one, other]


def test_causes_of_several_owners() -> None:
    full = "the state folder /var/lib/midspan: no space left on device"
    finding = shared({"ros1": [full, "/a: odd"], "ros2": [full], "yarp": ["its own"], "zenoh": ["/b: odd"]})
    assert list(finding.values()) == [(full, ["ros1", "ros2"]), ("/a: odd (the same for /b)", ["ros1", "zenoh"])]


def test_findings_of_one_cause_and_cure_are_merged() -> None:
    findings: list[Finding] = [fail(f"/t{number}: odd_msgs is unknown", "install odd_msgs") for number in range(8)]
    findings += [fail("/u: odd_msgs is unknown", "ask its author"), warn("/v: odd_msgs is unknown", "install odd_msgs")]
    findings += [ok("/a is fine"), ok("/b is fine")]
    assert [finding.seen for finding in merged(findings)] == [
        "/t0: odd_msgs is unknown (the same for /t1, /t2, /t3, /t4, /t5 and 2 more)",
        "/u: odd_msgs is unknown",
        "/v: odd_msgs is unknown",
        "/a is fine",
        "/b is fine",
    ]


def test_a_glob_is_not_the_name_that_it_stands_for() -> None:
    texts = ["the rule for /** denies it", "the rule for /camera* denies it", "the rule for /laser* denies it"]
    assert grouped(texts) == [texts[0], f"{texts[1]} (the same for /laser)"]

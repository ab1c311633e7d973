"""Packages of interface definitions that are built for ROS 2."""

from __future__ import annotations

from bridge.interfaces.definition import BuildError
from tests.fuzz.target import Subject, Target, texts


def _package() -> Subject:
    """A package's definition: a line with its name, a line with its path, and the text."""
    from bridge.interfaces.definition import read_package

    def parse(data: bytes) -> None:
        name, _, remainder = data.decode(errors="replace").partition("\n")
        path, _, text = remainder.partition("\n")
        for definition in read_package(name, {path: text}):
            assert definition.bare.isascii()

    seeds = texts(
        "a_msgs\nmsg/A.msg\nstd_msgs/Header header # c\nfloat64[3] v\nstring<=5 s\nint8 A=1\nB[] parts\n",
        "a_msgs\nsrv/A.srv\nint64 a\n---\nint64 sum\n",
        "a_msgs\naction/A.action\nint64 a\n---\nint64 b\n---\nint64 c\n",
    )
    tokens = texts(
        "---\n",
        "#",
        "=",
        "[<=3]",
        "<=3",
        "a_msgs/msg/B b\n",
        "time t\n",
        "int8 B=2\n",
        "../",
        "/",
        ".msg",
        "\x00",
        "\u2028",
        "A" * 40,
        "A_" * 20,
        "a_" * 20,
    )
    return Subject(parse, seeds, (BuildError,), tokens)


TARGETS = (Target("package", 15_000, _package),)

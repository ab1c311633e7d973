"""Administrative and one-letter commands, with YARP's answers."""

from __future__ import annotations

import os
import socket
from typing import Any

import pytest

from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from yarp_compat.ports import admin
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.text import from_text, to_text


def ask(port: PortCore, text: str) -> str:
    """Return the answer to a command; both are in text form."""
    return to_text(admin.answer(port, from_text(text)))


def type_lines(port: PortCore, *lines: str) -> str:
    """Return a port's answer to lines typed in telnet."""
    with socket.create_connection((port.contact.host, port.contact.port)) as sock:
        sock.settimeout(10)
        sock.sendall("".join(f"{line}\r\n" for line in ("CONNECT me", *lines, "q")).encode())
        answer = b""
        while part := sock.recv(4096):
            answer += part
    return answer.decode().removeprefix("Welcome me\r\n")


def test_commands_connect_and_disconnect(make_port: MakePort) -> None:
    reader, writer = make_port("/r"), make_port("/w")
    assert ask(writer, '[add] "tcp://r"') == '0 "Added connection from /w to tcp://r\\r\\n"'
    assert ask(writer, "[add] /r fast_tcp") == '0 "Added connection from /w to fast_tcp://r\\r\\n"'
    assert ask(writer, "[list] [out]") == '"/r"'
    assert ask(writer, "[list]") == '"/r"'
    assert ask(writer, "list out") == '"/r"', "strings are accepted as vocabs"
    assert ask(writer, "[list] [in]") == ""
    assert ask(writer, "[list] [out] /r") == '(from "/w") (to "/r") (carrier fast_tcp)'
    assert ask(writer, "[list] [out] /other") == ""
    until(lambda: [r.carrier for r in reader.inputs()] == ["fast_tcp"], "the reader has a fast_tcp connection")
    assert ask(reader, "[list] [in] /w") == '(from "/w") (to "/r") (carrier fast_tcp)'
    assert ask(writer, "[del] /r") == '0 "Removed connection from /w to /r\\r\\n"'
    assert ask(writer, "[add] udp://r") == '0 "Added connection from /w to udp://r\\r\\n"'
    assert ask(writer, "[list] [out] /r") == '(from "/w") (to "/r") (carrier udp) (connectionless 1)'
    until(lambda: [r.carrier for r in reader.inputs()] == ["udp"], "the reader has a udp connection")
    assert ask(reader, "[del] /w") == '0 "Removing connection from /w to /r\\r\\n"'
    assert ask(reader, "[del] /w") == (
        '-1 "Could not find an outgoing connection to /w\\r\\nCould not find an incoming connection from /w\\r\\n"'
    )
    assert ask(writer, "[add] /nowhere") == '-1 "Do not know how to connect to /nowhere\\r\\n"'


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("[ver]", "[ver] 1 2 3"),
        ("", '[fail] "send [help] for list of valid commands"'),
        ("[foo]", '[fail] "send [help] for list of valid commands"'),
        ("(1 2) 3", '[fail] "send [help] for list of valid commands"'),
        ("[prop]", '[fail] "property action not known"'),
        ("[prop] [set]", "[fail]"),
        ("[prop] [get] /unknown", '[fail] "cannot find any connection to/from /unknown"'),
        ("[prop] [set] /unknown 1", "[fail]"),
        ("[atch] [out] x", '[fail] "this port does not support portmonitor plug-ins: it is not a C++ program"'),
        ("[atch]", '[fail] "attach command must be followed by [out] or [in]"'),
        ("[dtch] [in]", "[fail]"),
        ("[dtch]", '[fail] "detach command must be followed by [out] or [in]"'),
        ("[set] [out]", '-1 "target port is not specified.\\r\\n"'),
        ("[get] [in] /other", '-1 "Could not find an incoming connection from /other\\r\\n"'),
        ("[set] [out] /other (a 1)", '-1 "Could not find an incoming connection to /other\\r\\n"'),
        ("[get] [out] /r", '[fail] "No port modifier is attached to the output"'),
        ("[set] [out] /other2 (a 1)", '0 "Configured connection to /other2\\r\\n"'),
        ("[prop] [set] /other2 (sched ((priority 1)))", "[ok]"),
    ],
)
def test_commands_have_yarps_answers(make_port: MakePort, command: str, answer: str) -> None:
    port = make_port("/r")
    make_port("/other2")
    port.add_output("/other2")
    assert ask(port, command) == answer


def test_properties_are_set_and_listed(make_port: MakePort) -> None:
    port = make_port("/r")
    assert ask(port, "[prop] [get]") == ""
    assert ask(port, "[prop] [set] color blue") == "[ok]"
    assert ask(port, "[prop] [set] size (1 2)") == "[ok]"
    assert ask(port, "[prop] [get] color") == "blue"
    assert ask(port, "[prop] [get]") == "(color blue) (size (1 2))"
    assert ask(port, "[prop] [get] none") == ""


@pytest.mark.parametrize(
    ("requested", "tos"),
    [("(tos 32)", 32), ("(dscp AF41)", 136), ("(dscp 10)", 40), ("(priority HIGH)", 144), ("(priority NORM)", 0)],
)
@pytest.mark.parametrize("carrier", ["tcp", "udp"])
def test_the_type_of_service_of_a_connection_is_set_and_read(
    make_port: MakePort, carrier: str, requested: str, tos: int
) -> None:
    reader, writer = make_port("/r"), make_port("/w")
    writer.add_output(f"{carrier}://r")
    until(lambda: reader.inputs(), "the reader is connected")
    for port, other in ((writer, "/r"), (reader, "/w")):
        assert ask(port, f"[prop] [set] {other} (sched ((priority -1) (policy -1))) (qos ({requested}))") == "[ok]"
        assert ask(port, f"[prop] [get] {other}").endswith(f"(qos ((tos {tos})))")
    assert ask(writer, "[prop] [set] /r (sched ()) (qos ((tos 256)))") == "[fail]"
    assert ask(writer, "[prop] [set] /r (qos ((priority NONSENSE)))") == "[ok]"


def test_properties_are_bounded(make_port: MakePort) -> None:
    port = make_port("/r")
    answers = [ask(port, f"[prop] [set] k{i} {i}") for i in range(admin.MOST_PROPERTIES + 1)]
    assert answers[-2:] == ["[ok]", "[fail]"]
    assert ask(port, "[prop] [set] k0 again") == "[ok]"


def test_port_describes_itself(make_port: MakePort) -> None:
    port = make_port("/r", type_name="yarp/vector", rpc=True)
    sections: dict[str, Any] = {k: v for k, v in admin.answer(port, from_text("[prop] [get] /r"))}  # noqa: C416
    assert list(sections) == ["sched", "process", "platform", "port"]
    assert sections["port"] == {"is_input": 1, "is_output": 1, "is_rpc": 1, "type": "yarp/vector"}
    assert sections["process"]["pid"] == os.getpid()
    assert set(sections["process"]) == {"arguments", "name", "pid", "policy", "priority"}
    assert sections["platform"]["hostname"] == "127.0.0.1"


def test_port_describes_a_connection(make_port: MakePort) -> None:
    make_port("/w")
    port = make_port("/r")
    port.add_output("/w")
    text = to_text(admin.answer(port, from_text("[prop] [get] /w")))
    assert text.startswith("(sched ((policy 0) (priority 0) (tid ")
    assert text.endswith(")) (qos ((tos 0)))")


def test_one_letter_commands_are_answered_as_by_yarp(make_port: MakePort) -> None:
    writer, reader = make_port("/w"), make_port("/r")
    assert type_lines(writer, "/r") == "Added connection from /w to /r\r\n"
    until(lambda: not writer.inputs(), "the querying client has left")
    assert type_lines(writer, "*") == (
        f"This is /w at tcp://127.0.0.1:{writer.contact.port}/\r\n"
        "There is an output connection from /w to /r using tcp\r\n"
        "There is an input connection from me to /w using text\r\n"
    )
    assert type_lines(writer, "!/r") == "Removed connection from /w to /r\r\n"
    assert type_lines(writer, "!/r") == "Could not find an outgoing connection to /r\r\n"
    writer.add_output("/r")
    until(reader.inputs, "the reader is connected")
    assert type_lines(reader, "~/w") == "Removing connection from /w to /r\r\n"
    assert type_lines(reader, "?").startswith(
        "This is a YARP port.  Here are the commands it responds to:\r\n*       Gives"
    )
    assert type_lines(reader, "x").startswith(
        "Port command not understood.\r\nType d to send data to the port's owner.\r\n"
    )
    assert type_lines(reader, "i").startswith("Port command not understood."), "a process cannot be ended remotely"


def test_reader_reverses_its_connection(make_port: MakePort) -> None:
    """``r``: the client receives the port's messages, as text and in binary."""
    from yarp_compat.wire import framing
    from yarp_compat.wire.binary import encode
    from yarp_compat.wire.profile import Profile

    port = make_port("/w")
    content = encode(["a", 1], Profile.YARP3)
    with socket.create_connection((port.contact.host, port.contact.port)) as sock:
        sock.settimeout(10)
        sock.sendall(b"CONNECT me\r\nr\r\n")
        until(port.outputs, "the port has an output")
        port.write(content)
        received = b""
        while len(received) < 20:
            received += sock.recv(100)
        assert received == b"Welcome me\r\nD\r\na 1\r\n"
    until(lambda: not port.outputs(), "the end of the connection is detected")
    with socket.create_connection((port.contact.host, port.contact.port)) as sock:
        sock.settimeout(10)
        sock.sendall(b"YA\xe4\x1e\0\0RP\x03\0\0\0me\0" + framing.words("r"))
        until(port.outputs, "the port has an output")
        port.write(content)
        expected = framing.prefix(len(content)) + content
        received = b""
        while len(received) < 16 + len(expected):
            received += sock.recv(1000)
        assert received[8:] == framing.ACK + expected

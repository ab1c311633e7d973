"""Regression tests for fuzzing findings, with shortened inputs."""

from __future__ import annotations

import contextlib
import xmlrpc.client
from typing import Any

import pytest

from tests.fuzz.target import Subject
from tests.fuzz.targets import TARGETS


def _state(answers: Any) -> bytes:
    return xmlrpc.client.dumps((answers,), methodresponse=True, allow_none=True).encode()


FOUND = [
    ("definition", b'2string<=5 t"""'),
    ("definition", b'2string<=5 t "\\x"'),
    ("definition", b'2string t "a", "b"'),
    ("header_type", b"std_msgs/g\n\n" + b"u" * 300 + b" e"),
    ("xmlrpc", b"<bigdecimal></bigdecimal>"),
    ("http", b"HTTP/1. 200\n \nContent-Length:18446744073709551616\n\n="),
    ("http", b"HTTP/1. 200\n \nContent-Length:94967296\n\n<"),
    ("node_uri", b"http://\x00"),
    ("node_uri", b"p://["),
    ("ros1_ledger", b"[" * 3000),
    ("ros2_prefixes", b"\x9f"),
    ("lock", b'{"pid":1e999,"machine":"","owner":""}'),
    ("lock", b"[" * 3000),
    ("ros1_ledger", b'{"last": {"owner": "", "daemon": "", "node": "/a", "uri": "\\ud800", "pid": 1}}'),
    ("package", b"a_msgs\nmsg/A.msg\nint8 " + b"A" * 60 + b"a=1"),
    ("from_json", b'1{"data":"\xc6\x85"}'),
    ("topic_pub", b"? {a: b}"),
    ("http", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n-5\r\n<a>"),
    ("token", b"@ros2_lv/0/c/:/0/MS/%/%/t/9/d::msg::dds_::S_/*/::,:,:,0:,,"),
    ("mapping_rules", b"[" * 1000),
    ("yarp_pages", b"GET /[weba/b?1&.\n\n"),
    ("ros1_bridge", b"- 5"),
    ("config", b"name: &a x\nlog: &a {level: debug}"),
    ("record", b'{"id":"","daemon":"","seq":7,"acks":{"":1e999},"crew":[],"process":"","role":null,"carries":[]}'),
    ("header_type", b"s/g\n\nbyte C=4!"),
    ("master_graph", _state([[[1, "", [["/chatter", "/a", "/b"]]]] * 6])),
    ("master_graph", _state([[[1, "", [None, [], []]]] * 6])),
    ("master_graph", _state([[], 5, {}, [[1, "", 3]], [], []])),
    ("status", b'[{"routes": [{"latency_ms": {"p99": ' + b"9" * 400 + b"}}]}]"),
    ("control", b"[" * 3000),
    ("qos", b"::,:828372036,8547792233720365807:,:,,"),
    ("ros1_requests", bytes(4 * 2000)),
    ("tcpros_frames", b"\5\0\0\0hello"),
]


@pytest.mark.parametrize(("name", "content"), FOUND, ids=[f"{n}-{k}" for k, (n, _) in enumerate(FOUND)])
def test_earlier_findings_stay_fixed(name: str, content: bytes) -> None:
    assert_promises_kept(TARGETS[name].make(), content)


def assert_promises_kept(subject: Subject, content: bytes) -> None:
    """Run a target's parser, which asserts its promises itself and raises only documented errors."""
    with contextlib.suppress(*subject.refuses):
        subject.parse(content)

"""Bottles: bytes in both dialects, fragmented replies, texts, stamps, files and command lines."""

from __future__ import annotations

from typing import Any

from tests.fuzz.target import Subject, Target, scratch, texts
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Float32, Int8, Int16, Int64, Vocab, Vocab64

_VALUES: list[list[Any]] = [
    [], [1.5, 2.5], [Float32(1.5)], ["a", "b"], [b"ab", b""], [True, Vocab("set")], [Int8(1)] * 3, [Vocab64("setmap")],
    [7, {"x": 1, "G": (["a", 1], ["b", "c"])}, [[], [1, [2, "z"]]], Int16(3), Int64(4), Float32(0.5), 2.5, "é", b"\0"],
]  # fmt: skip
_BINARY_WORDS = [
    bytes.fromhex(hex_code)
    for hex_code in (
        "00010000", "01010000", "04010000", "0a010000", "14010000", "80010000", "12010000", "20010000", "00030000",
        "00020000", "0a000000", "14000000", "80000000", "12000000", "11000000", "40000000", "ffffff7f", "ffffffff",
        "00000080", "0001000001000000" * 150, "00010000010000000003000000010000" * 80, "594100000000 5250",
    )
]  # fmt: skip


def _bottles() -> list[bytes]:
    from yarp_compat.wire.binary import encode

    return [encode(values, profile) for values in _VALUES for profile in Profile]


def _binary() -> Subject:
    """A whole Bottle of either profile; accepted ones are written, read as equal, and printed."""
    from yarp_compat.wire.binary import decode, decode_arrays, encode
    from yarp_compat.wire.reply import recognize
    from yarp_compat.wire.text import to_text

    def parse(data: bytes) -> None:
        values = decode(data)
        recognized = recognize(data)
        profile = recognized or Profile.YARP3
        values = decode(data, profile)
        wire = encode(values, profile)
        assert encode(decode(wire, profile), profile) == wire
        assert len(wire) <= len(data)
        decode_arrays(data, profile)
        to_text(values)

    return Subject(parse, _bottles(), (WireError,), _BINARY_WORDS, largest=4096)


def _reply() -> Subject:
    """A fragmented reply, whose end and profile are detected; the first byte sets the fragments."""
    from yarp_compat.wire.binary import decode_prefix
    from yarp_compat.wire.reply import ReplyReader

    def parse(data: bytes) -> None:
        step, stream = (data[0] % 32) + 1 if data else 1, data[1:]
        known = ReplyReader(Profile.YARP4, limit=4096)
        unknown = ReplyReader(acked=bool(step & 1), limit=4096)
        end = None
        for reader in (known, unknown):
            for size in (*range(step, len(stream), step), len(stream)):
                try:
                    end = reader.end(stream[:size])
                    break
                except Incomplete:
                    continue
            if reader is known and end is not None:
                assert end <= len(stream)
                assert decode_prefix(stream, Profile.YARP4)[1] == end

    seeds = [bytes([cut]) + wire + b"YA\0\0\0\0RP" for cut, wire in enumerate(_bottles())]
    return Subject(parse, seeds, (WireError,), _BINARY_WORDS, largest=4096)


def _text() -> Subject:
    """A Bottle's text; it is printed, and encoded to equal bytes."""
    from yarp_compat.wire.binary import decode, encode
    from yarp_compat.wire.text import TextReader, from_text, is_complete, to_text

    def parse(data: bytes) -> None:
        line = data.decode(errors="surrogateescape")
        values = from_text(line)
        assert len(line) > 1000 or to_text(values) == to_text(TextReader(line).values(line, 0))
        is_complete(line)
        wire = encode(values, Profile.YARP4)
        # compared as bytes, because there may be escapes between the bytes of one character
        back = to_text(decode(wire, Profile.YARP4))
        assert back.encode(errors="surrogateescape") == to_text(values).encode(errors="surrogateescape")

    seeds = texts(
        '1 2.0 -3 +4 0x1F 007 1e3 .5 5. inf nan -inf true false null [set] [setmap] {1 2} (a (b c)) "q s" a,b',
        "abc\\ def",
        "3000000000 99999999999999999999 1.2.3 - (k v) (k2 5)",
        "\"a\\nb\" 'x y' hello,world",
        '(a b)c d) (e "f\\" {1} g',
    )
    tokens = texts(
        "(" * 300, ")" * 300, "{(" * 200, '"', "\\", "\\0", "[", "]", "{", "}", ",", "\t", "\r\n", "0x", "1e", "-", "+",
        "..", "9" * 300, "1e999", "nan", "true", "null", "\0", "é",
    )  # fmt: skip
    return Subject(parse, seeds, (WireError,), [*tokens, b"\xff", b"\xed\xa0\x80"], largest=4096)


def _stamp() -> Subject:
    """A stamp as an envelope and as a message."""
    from yarp_compat.os.data.stamp import Stamp

    def parse(data: bytes) -> None:
        stamp = Stamp()
        if data[:1] == b"\0":
            stamp.from_wire(data)
        else:
            stamp.from_text(data.decode(errors="surrogateescape"))
        again = Stamp()
        again.from_text(stamp.to_text())
        assert again.getCount() == stamp.getCount()

    seeds = [
        *texts("5 123.5", "-1 0", "7 1795143618.02289"),
        Stamp(5, 1.5).to_bytes(),
        Stamp(5, 1.5).to_bytes(Profile.YARP4),
    ]
    return Subject(
        parse, seeds, (WireError,), [*texts("1e999", "nan", "9" * 400, "-", "\0"), *_BINARY_WORDS], largest=256
    )


def _property() -> Subject:
    """A configuration file's text, a message or a command line; the first byte selects which."""
    from yarp_compat.os.data.bottle import Property

    folder = scratch()
    (folder / "self.ini").write_text('n 1\n[include "self.ini"]\n')

    def parse(data: bytes) -> None:
        line = data[1:].decode(errors="surrogateescape")
        properties = Property()
        if data[:1] == b"f":
            properties.fromConfig(line.replace("INI", str(folder / "self.ini")))
        elif data[:1] == b"c":
            properties.fromCommand(line.split("\0"))
            properties.fromArguments(line, wipe=False)
            properties.fromQuery(line, wipe=False)
        else:
            properties.from_wire(data[1:])
        for key in properties:
            properties.find(key)
            properties.findGroup(key)
        assert Property(properties.toString()).toString() == properties.toString()

    seeds = [
        b'f// comment\nname /x # y\nlist (1 2\n 3)\n[G]\nk = v\nhome $HOME/x\n[LIST part]\nk 1\n[include S "INI"]\n',
        b"cprogram\0--name\0/x\0--G::a::b\0-5\0--text\0two words",
        b"m" + Property("(a 1) (G (b 2))").to_bytes(),
    ]
    tokens = texts(
        "[", "]", "$", "${", "$(", "\\", "#", "//", '"', "\n", "=", "include ", "import a b", "--", "::", "INI", "("
    )
    return Subject(parse, seeds, (WireError,), [*tokens, *_BINARY_WORDS], largest=512)


TARGETS = (
    Target("bottle_bytes", 40_000, _binary),
    Target("bottle_reply", 20_000, _reply),
    Target("bottle_text", 25_000, _text),
    Target("stamp", 10_000, _stamp),
    Target("property", 8_000, _property),
)

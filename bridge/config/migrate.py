"""Brings the text of an older configuration file to today's keys, with its comments.

A file says its format by ``version``. Until format 1 no file said any, so one that says none may be of any age: it is
read as today's, and what only older ones had is an error that names ``midspan config migrate``.

What goes stays in the file as a comment, and so do the comments around it: the text is edited where YAML's parser says
that a key stands, and is otherwise left as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from yaml.nodes import CollectionNode, MappingNode, Node, ScalarNode

from bridge.config.document import ConfigError, Document, KeyPath, Problem, Yaml12Loader, key_text, parse
from bridge.config.model import FORMAT
from bridge.config.sections.section import is_loopback, same_port

COMMAND = "midspan config migrate"

_INDOORS, _BESIDE = "tcp/127.0.0.1:7447", "tcp/127.0.0.1:7448"
_LISTEN, _OPEN, _TLS = ("hub", "listen"), ("hub", "open"), ("transport", "link", "tls")
_ROUTER_TLS: KeyPath = ("hub", "router_zenoh", *_TLS)
_CERTIFICATES = {"ca": "root_ca_certificate", "certificate": "listen_certificate", "key": "listen_private_key"}

REMOVED: dict[KeyPath, str] = {
    ("ros2", "build"): "message packages are built wherever there is a compiler",
}
"""Keys that older files have, and why none took their place."""


def too_new(document: Document) -> Problem | None:
    """What is said of a file whose format this Midspan does not know, None where it does."""
    data = document.data
    version = data.get("version") if isinstance(data, dict) else None
    if isinstance(version, bool) or not isinstance(version, int) or version <= FORMAT:
        return None
    text = f"this file is of format {version}, and this Midspan reads up to {FORMAT}; update Midspan"
    return document.problem(("version",), f"{text}, or use the file from before the update")


@dataclass
class Migration:
    """What became of a file's text: ``done`` and ``left`` say in words what changed, and what is left to people."""

    text: str
    done: list[str] = field(default_factory=list)
    left: list[Problem] = field(default_factory=list)


def migrate(text: str, file: Path) -> Migration:
    """Bring a file's text to today's format; raises `ConfigError` where it is no YAML, or of a format to come."""
    document = parse(file, text)
    if document.data is not None and not isinstance(document.data, dict):
        raise ConfigError([document.problem((), "must be a map of sections, for example 'hub:'")])
    if newer := too_new(document):
        raise ConfigError([newer])
    migration = Migration(text)
    for path, why in REMOVED.items():
        if path in document.keys:
            _replace(migration, document, path, f"{key_text(path)} is gone: {why}")
    _open_door(migration, document)
    if ("version",) not in document.keys:
        migration.text = _with_version(migration.text)
        migration.done.append(f"version is {FORMAT}")
    return migration


def _open_door(migration: Migration, document: Document) -> None:
    """A router that listened to other machines is a door of its own since, with names of who may command."""
    data = document.data
    listen = _value(data, _LISTEN)
    if not isinstance(listen, str) or "/" not in listen or is_loopback(listen):
        return
    if _OPEN in document.keys:
        text = "is open to other machines; add it to 'hub.open.listen', and leave this one out"
        migration.left.append(document.problem(_LISTEN, text))
        return
    tls = _value(data, _ROUTER_TLS)
    files = {key: tls[old] for key, old in _CERTIFICATES.items() if old in tls} if isinstance(tls, dict) else {}
    words = "".join(f", {key}: {_quoted(value)}" for key, value in files.items())
    door = [f"open: {{listen: [{_quoted(listen)}]{words}}}"]
    done = "hub.listen is hub.open.listen"
    if same_port(listen, _INDOORS):  # other machines connect to it, and go on to
        door.append(f"listen: {_BESIDE}")
        done += f"; this machine's own programs join at {_BESIDE}"
    if not _replace(migration, document, _LISTEN, done, *door):
        return
    if listen.startswith(("tls/", "quic/")):
        for section in ("router_zenoh", "zenoh"):
            path = "hub", section, *_TLS
            if isinstance(_value(data, path), dict):
                why = f"{key_text(path)} is gone: only the door speaks TLS, with files of its own"
                _replace(migration, document, _alone(data, path), why)
    text = "says no more who may command; 'hub.open.trusted' names the machines, see docs/operate/security.md"
    migration.left.append(document.problem(_LISTEN, text))


def _quoted(value: object) -> str:
    return "'{}'".format(str(value).replace("'", "''"))


def _value(data: Any, path: KeyPath) -> Any:
    for part in path:
        data = data.get(part) if isinstance(data, dict) else None
    return data


def _alone(data: Any, path: KeyPath) -> KeyPath:
    """The outermost map, but for sections, in which there is nothing but this part."""
    while len(path) > 2 and len(_value(data, path[:-1])) == 1:
        path = path[:-1]
    return path


def _with_version(text: str) -> str:
    """With ``version`` as the first key."""
    line = f"version: {FORMAT}\n"
    root = Yaml12Loader(text).get_single_node()
    if not isinstance(root, MappingNode):
        return f"{text.rstrip()}\n{line}".lstrip()
    if root.flow_style:
        at = root.start_mark.index + 1
        return f"{text[:at]}version: {FORMAT}{', ' if root.value else ''}{text[at:]}"
    at = root.start_mark.index
    before = re.search(r"\n[ \t]*\n((?:[ \t]*#.*\n)*)\Z", text[:at])  # the comment of the first key stays with it
    at = before.start(1) if before else at
    return text[:at] + line + text[at:]


# Edits of one pair


def _replace(migration: Migration, document: Document, path: KeyPath, done: str, *instead: str) -> bool:
    """Take a pair out, and note it; False where the text cannot be edited, as where others refer to the value."""
    try:
        text = _edited(migration.text, path, instead)
        parse(document.file, text)
    except ConfigError:
        migration.left.append(document.problem(path, f"{done}; it is in the way of an anchor, take it out by hand"))
        return False
    migration.text = text
    migration.done.append(done)
    return True


def _edited(text: str, path: KeyPath, instead: tuple[str, ...]) -> str:
    """With a pair as a comment, after what stands instead; in braces, where no comment ends, it is left out."""
    around, key, value = _pair(text, path)
    start = key.start_mark.index
    end = start + len(text[start : _end(key, value)].rstrip())
    if around.flow_style:
        if not instead:
            comma = re.compile(r"\s*,[ \t]*").match(text, end)
            before = re.search(r"\s*,\s*\Z", text[:start])
            start, end = (start, comma.end()) if comma else (before.start() if before else start, end)
        return text[:start] + ", ".join(instead) + text[end:]
    indent = " " * key.start_mark.column
    first, *rest = text[start:end].split("\n")
    gone = [f"# {first}", *(f"# {line[len(indent) :]}" for line in rest)]
    return text[:start] + f"\n{indent}".join([*instead, *gone]) + text[end:]


def _pair(text: str, path: KeyPath) -> tuple[MappingNode, Node, Node]:
    """The map around a pair, its key and its value."""
    node: Any = Yaml12Loader(text).get_single_node()
    for part in path:
        around = node
        key, node = next(pair for pair in around.value if pair[0].value == part)
    return around, key, node


def _end(key: Node, value: Node) -> int:
    """Where a pair ends: a block's own end is behind the comments that follow it."""
    return max(at for at in (key.end_mark.index, *_ends(value)) if at >= key.end_mark.index)


def _ends(node: Node) -> Iterator[int]:
    if isinstance(node, ScalarNode) or (isinstance(node, CollectionNode) and node.flow_style):
        yield node.end_mark.index
        return
    for child in node.value:
        for part in child if isinstance(child, tuple) else (child,):
            yield from _ends(part)

"""Updates an older configuration file to the current keys, and keeps its comments.

``version`` is the format of a file. Files before format 1 have no version, so a file without a version may be of any
age. Such a file is read in the current format; a key that only older formats had is an error, which names ``midspan
config migrate``.

Removed keys become comments (inside braces they are deleted), and existing comments stay: the text is edited at the
positions that YAML's parser gives for the keys, and is otherwise unchanged. The round trip of ruamel.yaml (0.19) would
rewrite indents, spacing, line ends and scalars, and drop the comments in flow lists and before ``---``.
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

_DEFAULT_LISTEN, _SECOND_LISTEN = "tcp/127.0.0.1:7447", "tcp/127.0.0.1:7448"
_LISTEN, _OPEN, _TLS = ("hub", "listen"), ("hub", "open"), ("transport", "link", "tls")
_ROUTER_TLS: KeyPath = ("hub", "router_zenoh", *_TLS)
_CERTIFICATES = {"ca": "root_ca_certificate", "certificate": "listen_certificate", "key": "listen_private_key"}

REMOVED: dict[KeyPath, str] = {
    ("ros2", "build"): "message packages are built wherever there is a compiler",
}
"""Keys of older files without a replacement, and the reasons."""


def too_new(document: Document) -> Problem | None:
    """Return a problem if the file has a newer format than this Midspan reads, else None."""
    data = document.data
    version = data.get("version") if isinstance(data, dict) else None
    if isinstance(version, bool) or not isinstance(version, int) or version <= FORMAT:
        return None
    text = f"this file has format {version}, and this Midspan reads up to {FORMAT}; update Midspan"
    return document.problem(("version",), f"{text}, or use the file from before the update")


@dataclass
class Migration:
    """The result of a migration: the text, the changes (``done``), and the remaining problems (``left``)."""

    text: str
    done: list[str] = field(default_factory=list)
    left: list[Problem] = field(default_factory=list)


def migrate(text: str, file: Path) -> Migration:
    """Migrate a file's text to the current format; raises `ConfigError` if it is not YAML, or has a newer format."""
    document = parse(file, text)
    if document.data is not None and not isinstance(document.data, dict):
        raise ConfigError([document.problem((), "must be a map of sections, for example 'hub:'")])
    if newer := too_new(document):
        raise ConfigError([newer])
    migration = Migration(text)
    for path, reason in REMOVED.items():
        if path in document.keys:
            _replace(migration, document, path, f"{key_text(path)} was removed: {reason}")
    _move_listener(migration, document)
    if ("version",) not in document.keys:
        _add_version(migration, document)
    return migration


def _move_listener(migration: Migration, document: Document) -> None:
    """Move a router's listener for other machines to ``hub.open``, which also names the trusted machines."""
    data = document.data
    listen = _value(data, _LISTEN)
    if not isinstance(listen, str) or "/" not in listen or is_loopback(listen):
        return
    if _OPEN in document.keys:
        text = "is open to other machines; add it to 'hub.open.listen', and remove it here"
        migration.left.append(document.problem(_LISTEN, text))
        return
    tls = _value(data, _ROUTER_TLS)
    files = {key: tls[old] for key, old in _CERTIFICATES.items() if tls.get(old)} if isinstance(tls, dict) else {}
    keys = "".join(f", {key}: {_quoted(value)}" for key, value in files.items())
    moved = [f"open: {{listen: [{_quoted(listen)}]{keys}}}"]
    done = "moved hub.listen to hub.open.listen"
    if same_port(listen, _DEFAULT_LISTEN):  # other machines already connect to this port, so it stays theirs
        moved.append(f"listen: {_SECOND_LISTEN}")
        done += f"; this machine's own programs join at {_SECOND_LISTEN}"
    if not _replace(migration, document, _LISTEN, done, *moved):
        return
    if listen.startswith(("tls/", "quic/")):
        for section in ("router_zenoh", "zenoh"):
            path = "hub", section, *_TLS
            if isinstance(_value(data, path), dict):
                reason = f"{key_text(path)} was removed: only hub.open uses TLS, with its own files"
                _replace(migration, document, _outermost_single(data, path), reason)
    text = (
        "no longer decides who may send commands; list the trusted machines in 'hub.open.trusted'"
        " (docs/operate/security.md)"
    )
    migration.left.append(document.problem(_LISTEN, text))


def _quoted(value: object) -> str:
    return "'{}'".format(str(value).replace("'", "''"))


def _value(data: Any, path: KeyPath) -> Any:
    for part in path:
        data = data.get(part) if isinstance(data, dict) else None
    return data


def _outermost_single(data: Any, path: KeyPath) -> KeyPath:
    """Return the path of the outermost map, below section level, that contains nothing but this key."""
    while len(path) > 2 and len(_value(data, path[:-1])) == 1:
        path = path[:-1]
    return path


def _add_version(migration: Migration, document: Document) -> None:
    text = _with_version(migration.text)
    try:
        parse(document.file, text)
    except ConfigError as err:
        reason = f"{COMMAND} cannot add it ({err.problems[0].text}); add 'version: {FORMAT}' by hand"
        migration.left.append(document.problem(("version",), reason))
        return
    migration.text = text
    migration.done.append(f"set version to {FORMAT}")


def _with_version(text: str) -> str:
    """Return the text with ``version`` as the first key."""
    line = f"version: {FORMAT}\n"
    root = Yaml12Loader(text).get_single_node()
    if not isinstance(root, MappingNode):
        return f"{text.rstrip()}\n{line}".lstrip()
    if root.flow_style:
        at = root.start_mark.index + 1
        return f"{text[:at]}version: {FORMAT}{', ' if root.value else ''}{text[at:]}"
    column = root.start_mark.column
    at = root.start_mark.index - column
    before = re.search(r"\n[ \t]*\n((?:[ \t]*#.*\n)*)\Z", text[:at])  # the comment of the first key stays with it
    at = before.start(1) if before else at
    return text[:at] + " " * column + line + text[at:]


# Edits of one pair


def _replace(migration: Migration, document: Document, path: KeyPath, done: str, *instead: str) -> bool:
    """Replace a key-value pair and record the change.

    Return False if the edited text is invalid, for example because an anchor was removed.
    """
    try:
        text = _edited(migration.text, path, instead)
        parse(document.file, text)
    except ConfigError as err:
        reason = f"{COMMAND} cannot edit this ({err.problems[0].text}); edit it by hand: {done}"
        migration.left.append(document.problem(path, reason))
        return False
    migration.text = text
    migration.done.append(done)
    return True


def _edited(text: str, path: KeyPath, instead: tuple[str, ...]) -> str:
    """Return the text with the pair replaced; the old pair becomes a comment below, or is deleted within braces."""
    parent, key, value = _pair(text, path)
    start = key.start_mark.index
    end = start + len(text[start : _end(key, value)].rstrip())
    if parent.flow_style:
        if not instead:
            comma = re.compile(r"\s*,[ \t]*").match(text, end)
            before = re.search(r"\s*,\s*\Z", text[:start])
            start, end = (start, comma.end()) if comma else (before.start() if before else start, end)
        return text[:start] + ", ".join(instead) + text[end:]
    indent = " " * key.start_mark.column
    first, *lines = text[start:end].split("\n")
    removed = [f"# {first}", *(f"# {line[len(indent) :]}" for line in lines)]
    return text[:start] + f"\n{indent}".join([*instead, *removed]) + text[end:]


def _pair(text: str, path: KeyPath) -> tuple[MappingNode, Node, Node]:
    """Return the map that contains a pair, its key and its value."""
    node: Any = Yaml12Loader(text).get_single_node()
    for part in path:
        parent = node
        key, node = next(pair for pair in parent.value if pair[0].value == part)
    return parent, key, node


def _end(key: Node, value: Node) -> int:
    """Return the end of a pair without the comments after it, which YAML counts as part of a block."""
    return max(at for at in (key.end_mark.index, *_ends(value)) if at >= key.end_mark.index)


def _ends(node: Node) -> Iterator[int]:
    if isinstance(node, ScalarNode) or (isinstance(node, CollectionNode) and node.flow_style):
        yield node.end_mark.index
        return
    for child in node.value:
        for part in child if isinstance(child, tuple) else (child,):
            yield from _ends(part)

"""Files with zenoh settings, and the files that zenoh settings name, such as certificates."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from bridge.config.document import ConfigError, KeyPath, Problem, key_text, read, text_of
from bridge.config.zenoh_values import Tree, texts

_DEEPEST = 100
"""Maximum depth of nested brackets in a JSON5 file; zenoh's parser needs stack space for each."""

_TLS: KeyPath = ("transport", "link", "tls")
_FILES = re.compile(r"(?:_certificate|_private_key|_file)$")


def files_in(tree: Tree) -> Iterator[tuple[KeyPath, str]]:
    """Yield the files that zenoh reads when it opens a session, with their keys' paths."""
    for path, text in texts(tree.get("transport"), ("transport",)):
        if _FILES.search(str(path[-1])):
            yield path, text


def files_of(settings: Tree | Path | None) -> Iterator[Path]:
    """Yield the file of checked zenoh settings, if they are in one, and the files that the settings name."""
    if isinstance(settings, Path):
        yield settings
    for _, text in files_in(_tree(settings)):
        yield Path(text)


def tls_files(settings: Tree | Path | None) -> Iterator[tuple[Path, Path | None, Path | None]]:
    """Yield the authority's certificate, a certificate and its key, for each role in which checked settings use TLS."""
    names = {path[-1]: Path(text) for path, text in files_in(_tree(settings)) if path[:-1] == _TLS}
    ca = names.get("root_ca_certificate")
    for role in ("listen", "connect"):
        certificate, key = names.get(f"{role}_certificate"), names.get(f"{role}_private_key")
        pair = (certificate, key) if certificate and key else (None, None)
        if any_certificate := ca or certificate:
            yield any_certificate, *pair


def _tree(settings: Tree | Path | None) -> Tree:
    return _content(settings) if isinstance(settings, Path) else settings or {}


def _content(file: Path) -> Tree:
    if importlib.util.find_spec("zenoh") is None:
        return {}
    try:
        tree = read(file).data if file.suffix in (".yaml", ".yml") else json5(file, text_of(file), ())
    except ConfigError:  # it has changed since it was checked
        return {}
    return tree if isinstance(tree, dict) else {}


def json5(file: Path, text: str, section: KeyPath) -> Any:
    """Parse the text of a JSON5 file; raises `ConfigError`."""
    config, key = zenoh_package().Config, key_text(section)
    if _depth(text) > _DEEPEST:
        raise ConfigError([Problem(file, 0, 0, key, f"has more than {_DEEPEST} nested brackets")])
    reason = refusal(partial(config.from_json5, text))
    if place := re.search(r"--> (\d+):(\d+)", reason):
        expected = re.search(r"= (.*)", reason)
        detail = f"{expected[1] if expected else 'an error'}; check commas, quotes and brackets from here on"
        raise ConfigError([Problem(file, int(place[1]), int(place[2]), key, f"not valid JSON5: {detail}")])
    # zenoh accepts any value for `metadata`, and returns all its keys, including those that it would ignore elsewhere
    wrapped = f'{{"metadata": {text}\n}}'
    if reason := refusal(partial(config.from_json5, wrapped)):
        raise ConfigError([Problem(file, 0, 0, key, f"zenoh refuses it: {reason}")])
    return json.loads(config.from_json5(wrapped).get_json("metadata"))


def _depth(text: str) -> int:
    deepest = depth = 0
    for bracket in re.findall(r"[\[\]{}]", text):
        depth += 1 if bracket in "[{" else -1
        deepest = max(deepest, depth)
    return deepest


def zenoh_package() -> Any:
    """Import zenoh, which only zenoh settings need."""
    import zenoh

    return zenoh


def refusal(parse: Any) -> str:
    """Return why zenoh refuses a configuration, "" if zenoh accepts it."""
    try:
        parse()
    except zenoh_package().ZError as err:
        return str(err).partition(" at /")[0]  # without the location in zenoh's source code
    return ""

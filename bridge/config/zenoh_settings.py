"""Checks the zenoh settings in Midspan's configuration with zenoh's own parser, before a session opens with them."""

from __future__ import annotations

import difflib
import importlib.util
import json
import re
import stat
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.config.document import ConfigError, Document, KeyPath, Place, Problem, key_text, read, text_of
from bridge.config.sections.section import is_loopback, not_one_of, zenoh_destination, zenoh_endpoint
from bridge.config.zenoh_effects import DIALECTS, OPEN, ROUTER, WORKERS, Flaw, unusable
from bridge.config.zenoh_files import files_in, json5, refusal, zenoh_package
from bridge.config.zenoh_plugins import replacement
from bridge.config.zenoh_values import Tree, changed, texts

if TYPE_CHECKING:
    from bridge.config.model import Config

_SESSIONS: tuple[KeyPath, ...] = (WORKERS, DIALECTS)
_ROUTERS: tuple[KeyPath, ...] = (ROUTER, OPEN)

_MOST = 20
"""Maximum number of problems that are reported for one zenoh configuration."""

_LEGACY: tuple[KeyPath, ...] = (("routing", "peer"), ("routing", "router", "peers_failover_brokering"))
"""Keys of zenoh before 1.10 that the parser still accepts but ignores; files for rmw_zenoh contain them."""


def zenoh_problems(document: Document, config: Config) -> list[Problem]:
    """Return the problems of all zenoh configurations; ``document`` is the file that ``config`` was loaded from."""
    problems: list[Problem] = []
    if importlib.util.find_spec("zenoh") is None:  # a system without zenoh has no hub either
        return problems
    inline = _with_files(config)
    for section in (*_SESSIONS, *_ROUTERS):
        settings: Any = config
        for part in section:
            settings = getattr(settings, str(part))
        if isinstance(settings, Path):
            problems += _of_file(settings, section, inline)
        elif settings:
            flaws = _of_tree(settings, section, inline)
            problems += [document.problem((*section, *path), text, at_key=True) for path, text in flaws]
    return problems


def _with_files(config: Config) -> Config:
    """Return the configuration with the contents of the hub's files of zenoh settings, as far as zenoh reads them."""
    read: dict[str, Tree] = {}
    for name in ("zenoh", "router_zenoh"):
        if isinstance(file := getattr(config.hub, name), Path):
            read[name] = {}
            with suppress(zenoh_package().ZError):
                tree = json.loads(str(zenoh_package().Config.from_file(str(file))))
                read[name] = changed(tree, json.loads(str(zenoh_package().Config())))
    return config.model_copy(update={"hub": config.hub.model_copy(update=read)}) if read else config


def _of_file(file: Path, section: KeyPath, config: Config) -> list[Problem]:
    try:
        if file.suffix in (".yaml", ".yml"):
            document = read(file)
            tree, place = document.data, partial(_place_in_document, document)
        else:
            text = text_of(file)
            tree, place = json5(file, text, section), partial(_place_in_text, text)
    except ConfigError as err:
        return list(err.problems)
    flaws = _of_tree({} if tree is None else tree, section, config, in_file=True)
    if not flaws:
        reason = refusal(partial(zenoh_package().Config.from_file, str(file)))
        flaws = [((), f"zenoh cannot read the file: {reason}")] if reason else []
    return [Problem(file, *place(path), key_text((*section, *path)), text) for path, text in flaws]


def _place_in_document(document: Document, path: KeyPath) -> Place:
    problem = document.problem(path, "", at_key=True)
    return Place(problem.line, problem.column)


def _place_in_text(text: str, path: KeyPath) -> Place:
    """Return the place of a key that occurs once in a JSON5 text, else line 0."""
    names = [part for part in path if isinstance(part, str)]
    hits = list(re.finditer(rf"(?<![\w$])[\"']?{re.escape(names[-1])}[\"']?\s*:", text)) if names else []
    if len(hits) != 1:
        return Place(0, 0)
    start = hits[0].start()
    return Place(text.count("\n", 0, start) + 1, start - text.rfind("\n", 0, start))


def _of_tree(tree: Any, section: KeyPath, config: Config, *, in_file: bool = False) -> list[Flaw]:
    if not isinstance(tree, dict):
        return [((), "must be a map, for example {mode: client}")]
    plugins = tree.get("plugins")
    flaws: list[Flaw] = [
        (("plugins", name), replacement(name, settings if isinstance(settings, dict) else {}))
        for name, settings in (plugins.items() if isinstance(plugins, dict) else ())
    ]
    tree = {key: value for key, value in tree.items() if not (key == "plugins" and flaws)}
    tree, refused = _accepted(tree)
    flaws += refused
    flaws += [flaw for flaw in _ignored(tree) if not any(path[: len(flaw[0])] == flaw[0] for path, _ in refused)]
    flaws += _bad_endpoints(tree, local=section == ROUTER)
    flaws += _missing_files(tree)
    flaws += [] if flaws else _bad_dictionary(tree)
    flaws += [] if flaws else _bad_references(tree)
    if not flaws:
        # `bridge.hub.zenoh_config.make_config` does the same
        tree = changed(tree, json.loads(str(zenoh_package().Config()))) if in_file else tree
        flaws += unusable(tree, section, config)
    if section in _ROUTERS and tree.get("mode", "router") != "router":
        flaws.append((("mode",), f"the mode of the daemon's router is 'router', not {tree['mode']!r}; leave it out"))
    if section == WORKERS and tree.get("id"):
        flaws.append((("id",), "all sessions would have this id, and only one could join; leave it out"))
    return flaws[:_MOST]


# -- zenoh's parser ----------------------------------------------------------------------------------------------------


def _refused(tree: Tree) -> str:
    return refusal(partial(zenoh_package().Config.from_json5, json.dumps(tree)))


def _accepted(tree: Tree) -> tuple[Tree, list[Flaw]]:
    """Return the part of a configuration that zenoh accepts, and what is wrong with the rest."""
    flaws: list[Flaw] = []
    while (reason := _refused(tree)) and len(flaws) < _MOST:
        path = _culprit(tree, reason)
        flaws.append((path, _explained(_value_at(tree, path), path, reason)))
        if not path:
            return {}, flaws
        # an item of a list may be invalid without its wrong key, so the whole item is removed
        items = [number for number, part in enumerate(path, 1) if isinstance(part, int)]
        tree = _without(tree, path[: items[0]] if items else path)
    return tree, flaws


def _culprit(tree: Tree, reason: str) -> KeyPath:
    """Return the path of the smallest part that zenoh refuses for this reason."""
    path: KeyPath = ()
    while (part := _refused_part(tree, path, reason)) is not None:
        path = (*path, part)
    return path


def _refused_part(tree: Tree, path: KeyPath, reason: str) -> str | int | None:
    node = _value_at(tree, path)
    if isinstance(node, dict):
        for key in node:
            if _refused(_without(tree, (*path, key))) not in (reason, f"missing field `{key}`"):
                return str(key)
    elif isinstance(node, list) and _refused(_with(tree, path, [])) != reason:
        for index, item in enumerate(node):
            if _refused(_with(tree, path, [item])) == reason:
                return index
    return None


def _value_at(tree: Any, path: KeyPath) -> Any:
    for part in path:
        tree = tree[part]
    return tree


def _with(tree: Any, path: KeyPath, value: Any) -> Any:
    """Return a copy of the tree with another value at a path; the copy shares all other values."""
    if not path:
        return value
    copied = tree.copy()
    copied[path[0]] = _with(tree[path[0]], path[1:], value)
    return copied


def _without(tree: Tree, path: KeyPath) -> Tree:
    parent = _value_at(tree, path[:-1]).copy()
    del parent[path[-1]]
    shortened: Tree = _with(tree, path[:-1], parent)
    return shortened


def _explained(value: Any, path: KeyPath, reason: str) -> str:
    known = re.findall(r"`([^`]+)`", reason.partition("expected")[2])
    if reason.startswith("unknown field ") and path:
        return _unknown(str(path[-1]), known)
    if reason.startswith("unknown variant ") and isinstance(value, str):
        return not_one_of(value, known)
    return f"zenoh refuses it: {' '.join(reason.split()).rstrip('.')}"


def _unknown(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"zenoh has no key {name!r} here" + (f"; did you mean {near[0]!r}?" if near else f": {', '.join(known)}")


def _ignored(tree: Tree) -> Iterator[Flaw]:
    """Yield the keys that zenoh's parser ignores, lists that must be maps, and numbers that are out of range."""
    config = zenoh_package().Config.from_json5(json.dumps(tree))
    for path, value, known in _differences(tree, json.loads(str(config)), ()):
        if isinstance(value, list) and isinstance(known, dict):
            yield path, "must be a map, not a list"
        elif not isinstance(known, dict):
            yield path, f"zenoh reads {value} as {known}; the value is out of range"
        elif path not in _LEGACY and refusal(partial(config.get_json, "/".join(map(str, path)))):
            unknown = _unknown(str(path[-1]), list(known))
            yield path, unknown if known else "zenoh ignores it; check the spelling of all its keys"


def _differences(given: Any, read: Any, path: KeyPath) -> Iterator[tuple[KeyPath, Any, Any]]:
    """Yield each lost key with its known siblings, and each list or number with the different value that was read."""
    if isinstance(given, dict):
        known = read if isinstance(read, dict) else {}
        for key, value in given.items():
            if key in known:
                yield from _differences(value, known[key], (*path, key))
            else:
                yield (*path, key), value, known
    elif isinstance(given, list) and isinstance(read, list) and len(given) == len(read):
        for index, (value, other) in enumerate(zip(given, read, strict=True)):
            yield from _differences(value, other, (*path, index))
    else:
        number = isinstance(given, int | float) and isinstance(read, int | float)
        if (number and given != read) or (isinstance(given, list) and isinstance(read, dict)):
            yield path, given, read


# -- what the parser does not check ------------------------------------------------------------------------------------


def _bad_endpoints(tree: Tree, *, local: bool) -> Iterator[Flaw]:
    for part, check in (("listen", zenoh_endpoint), ("connect", zenoh_destination)):
        section = tree.get(part)
        for path, text in texts(section.get("endpoints") if isinstance(section, dict) else None, (part, "endpoints")):
            try:
                check(text)
                if local and not is_loopback(text):
                    yield path, f"{text} is open to other machines, which may join only through hub.open"
            except ValueError as err:
                yield path, str(err)


def _missing_files(tree: Tree) -> Iterator[Flaw]:
    """Yield the absolute paths in ``transport`` that do not exist or are folders.

    Relative paths are not checked: they depend on the worker's working directory.
    """
    for path, text in files_in(tree):
        if Path(text).is_absolute():
            try:
                if stat.S_ISDIR(Path(text).stat().st_mode):
                    yield path, f"{text} is a folder, not a file"
            except (FileNotFoundError, NotADirectoryError, ValueError):
                yield path, f"no such file: {text}"
            except OSError:  # the file may exist, but this user may not look into its folder
                continue


def _bad_dictionary(tree: Tree) -> Iterator[Flaw]:
    """Yield the first line of the dictionary of users that is not ``user:password``; it is not shown, it is secret."""
    path = ("transport", "auth", "usrpwd", "dictionary_file")
    file: Any = tree
    for part in path:
        file = (file or {}).get(part)
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines() if file and Path(file).is_absolute() else []
    except UnicodeDecodeError:
        yield path, f"{file} is not a text in UTF-8"
        return
    except OSError:  # the worker's user may be able to read it
        return
    for number, line in enumerate(lines, 1):
        user, _, password = line.partition(":")
        if line.strip() and not (user.strip() and password.strip()):
            yield path, f"{file}: line {number} is not 'user:password'"
            return


_ITEMS: tuple[KeyPath, ...] = (
    *(("access_control", part) for part in ("rules", "subjects", "policies")),
    ("downsampling",),
    ("low_pass_filter",),
    ("qos", "network"),
)
"""Lists whose items have an ``id`` that is unique in the list."""


def _bad_references(tree: Tree) -> Iterator[Flaw]:
    """Yield the errors that zenoh finds only when it opens a session: in ids, references to ids, and options.

    ``tree`` is a configuration that the parser accepts.
    """
    ids: dict[KeyPath, set[str]] = {path: set() for path in _ITEMS}
    for path in _ITEMS:
        for index, item in enumerate(_list(tree, path)):
            name = item.get("id")
            if name in ids[path]:
                yield (*path, index, "id"), f"{name!r} is also the id of an earlier item; give each item its own"
            elif isinstance(name, str):
                ids[path].add(name)
    for index, policy in enumerate(_list(tree, ("access_control", "policies"))):
        for part in ("rules", "subjects"):
            for name in policy.get(part) or ():
                if name not in ids["access_control", part]:
                    yield ("access_control", "policies", index, part), f"no {part[:-1]} has the id {name!r}"
    access = tree.get("access_control") or {}
    absent = [part for part in ("rules", "subjects", "policies") if access.get(part) is None]
    if access.get("enabled") and absent:
        yield ("access_control",), f"has no {' and no '.join(absent)}; zenoh needs all three lists"
    unicast = (tree.get("transport") or {}).get("unicast") or {}
    if unicast.get("lowlatency") and (unicast.get("qos") or {}).get("enabled", True):
        yield ("transport", "unicast", "lowlatency"), "zenoh also needs 'qos: {enabled: false}' in this section"
    multicast = (tree.get("scouting") or {}).get("multicast") or {}
    if (multicast.get("ttl") or 0) > 255:
        yield ("scouting", "multicast", "ttl"), f"{multicast['ttl']} is not from 0 to 255"


def _list(tree: Tree, path: KeyPath) -> list[dict[str, Any]]:
    node: Any = tree
    for part in path:
        node = node.get(part) if isinstance(node, dict) else None
    return [item for item in node if isinstance(item, dict)] if isinstance(node, list) else []

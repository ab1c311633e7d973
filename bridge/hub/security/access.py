"""Access rights of other machines on the hub: zenoh's access rules for the external listener.

A machine with a trusted name may do everything. Any other machine that may join (a guest) may subscribe, query stored
values and states, reply, and publish everything except commands (`bridge.config.rules`).

zenoh denies a key if the rule's expression includes it, but not if they only intersect: ``**`` would pass a rule that
denies ``*/cmd_vel/**``, and a put on ``**`` reaches every subscription. So these rules only allow. A guest may publish
on expressions that do not intersect any command's key, because their types end differently from those of commands.
"""

from __future__ import annotations

import string
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from bridge.config.rules import EVERY, commands
from bridge.config.sections.hub import OpenSection
from bridge.config.sections.routing import RoutingSection
from bridge.hub.endpoints.services import abandon_key
from bridge.hub.graph.tokens import ADMIN_SPACE, MIDSPAN_SPACE
from bridge.hub.wire.buffers import CPU_GROUP
from bridge.hub.wire.keys import NO_HASH, dds_type_name, hash_chunk

ANYBODY = "*"
"""The entry in the list of trusted names that stands for every machine that may join."""

_CACHES = "**/@adv/**"
_STORE = "midspan/store"
_SPACES = ("**", _CACHES, abandon_key("**"), f"{_STORE}/*/@sync/**", f"{ADMIN_SPACE}/**", f"{MIDSPAN_SPACE}/**")
"""Expressions for all keys; ``**`` alone does not match chunks that begin with ``@``."""

_LISTENING = ("declare_subscriber", "liveliness_query", "declare_liveliness_subscriber")
_EVERYTHING = ("put", "delete", "query", "reply", "declare_queryable", "liveliness_token", *_LISTENING)

_HASHES = ("RIHS01_$*", hash_chunk(NO_HASH))
"""Last parts of keys: a type's hash, or Humble's text for a missing hash."""

_GOAL = "Goal_"
"""Endings of goal and cancel types: MoveBaseActionGoal_, NavigateToPose_SendGoal_, CancelGoal_."""

QUESTIONS = (
    *(f"*/**/$*::srv::dds_::{verb}$*/{end}" for verb in ("Get", "List", "Describe") for end in _HASHES),
    *(f"*/**/$*::action::dds_::$*_GetResult_/{end}" for end in _HASHES),
)
"""Keys of services that change nothing: Get, List and Describe services, and the results of actions."""

_TOKENS = (
    *(space for space in _SPACES if not space.startswith(MIDSPAN_SPACE)),
    f"{MIDSPAN_SPACE}/external/*",
    *(f"{MIDSPAN_SPACE}/*/{kind}/**" for kind in ("wire", "origin", "member", "velocity", "relay", "near")),
)
"""Keys on which a guest may announce itself: all but ``driver``, with which it would lock out those who may drive."""

_READING = (f"{_STORE}/**", f"{_STORE}/*/@sync/digest/**", f"{_STORE}/*/@sync/fetch/**")
"""Stored values (`bridge.stores`): every machine that may join can read them, but only trusted ones can change them."""

_ANSWERS = tuple(f"*/**/$*::{middle}::dds_::$*/{end}" for middle in ("srv", "action") for end in _HASHES)
"""Keys on which a server may reply to its clients, including replies to goal requests."""

_TYPE_LETTERS = string.ascii_letters + string.digits + "_:"
_NAME_LETTERS = string.ascii_letters + string.digits + "_-."


def access_control(section: OpenSection, routing: RoutingSection, loopback: Sequence[str]) -> dict[str, Any]:
    """Return the ``access_control`` of the external listener's zenoh configuration.

    The routing rules may define additional commands. ``loopback`` lists this machine's loopback interfaces, which are
    used only without TLS.
    """
    local = {"interfaces": list(loopback)} if section.insecure else {"link_protocols": ["tcp", "unixsock-stream"]}
    others: dict[str, Any] = {} if section.insecure else {"link_protocols": ["tls", "quic"]}
    names = [name for name in section.trusted if name != ANYBODY]
    subjects = [{"id": "here", **local}, {"id": "others", **others}]
    masters = ["here", *(["others"] if ANYBODY in section.trusted else [])]
    if names:
        subjects.append({"id": "trusted", "cert_common_names": names, **others})
        masters.append("trusted")
    control = f"{MIDSPAN_SPACE}/**"
    harmless = harmless_keys(commands(routing))
    guest = [
        _rule("hear", "egress", _EVERYTHING, _SPACES),
        _rule("join", "ingress", _LISTENING, _SPACES),
        _rule("announce", "ingress", ("liveliness_token",), _TOKENS),
        _rule("say", "ingress", ("put", "reply"), (*harmless, *buffered_keys(harmless), control)),
        _rule("answer", "ingress", ("reply",), _ANSWERS),
        # a publisher that is queried for a latched command could reply on any key
        _rule("keep", "ingress", ("put", "declare_queryable"), [f"{key}/@adv/**" for key in harmless]),
        _rule("serve", "ingress", ("declare_queryable",), ("**", control)),
        _rule("ask", "ingress", ("query",), (*QUESTIONS, *_READING, _CACHES, control)),
    ]
    everything = [_rule(f"everything {flow}", flow, _EVERYTHING, _SPACES) for flow in ("ingress", "egress")]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [*everything, *guest],
        "subjects": subjects,
        "policies": [
            {"rules": [rule["id"] for rule in everything], "subjects": masters},
            {"rules": [rule["id"] for rule in guest], "subjects": ["others"]},
        ],
    }


def harmless_keys(commanding: Mapping[str, Iterable[str]]) -> list[str]:
    """Return key expressions that cover all samples except commands, for types that are spelled as in ROS.

    ``commanding`` maps the types of commands to the last parts of their topics' names (words that may end in ``*``).
    """
    types = {type_name: dds_type_name(type_name) for type_name in commanding}
    endings = {_GOAL, *(f":{name.rpartition(':')[2]}" for name in types.values())}
    chunks = list(not_ending("_", endings))
    for type_name, parts in commanding.items():
        if EVERY not in parts:
            chunks += [f"{chunk}/{types[type_name]}" for chunk in not_beginning("", parts)]
    return [f"*/**/{chunk}/{end}" for end in _HASHES for chunk in chunks]


def buffered_keys(keys: Iterable[str]) -> list[str]:
    """Return the key expressions on which Lyrical's publishers send samples of types with buffers, for those of keys.

    See `bridge.hub.wire.buffers`; releases without hashes have no buffers.
    """
    hashed = [key for key in keys if not key.endswith(hash_chunk(NO_HASH))]
    return [f"{key}/{tail}" for key in hashed for tail in (CPU_GROUP, "_buf/*")]


def not_ending(tail: str, endings: Iterable[str]) -> Iterator[str]:
    """Yield expressions for the chunks that end with ``tail``, but not with any of the (longer) endings."""
    longer = {ending for ending in endings if ending.endswith(tail)}
    if tail in longer:
        return
    before = {ending[-len(tail) - 1] for ending in longer}
    yield from (f"$*{letter}{tail}" for letter in _TYPE_LETTERS if letter not in before)
    for letter in sorted(before):
        yield from not_ending(letter + tail, longer)


def not_beginning(head: str, words: Iterable[str]) -> Iterator[str]:
    """Yield expressions for the chunks that begin with ``head``, but match none of the words (some end in ``*``)."""
    longer = {text for text in words if text.startswith(head)}
    if f"{head}*" in longer:
        return
    if head and head not in longer:
        yield head
    after = {text[len(head)] for text in longer if len(text) > len(head)}
    yield from (f"{head}{letter}{'$*'}" for letter in _NAME_LETTERS if letter not in after)
    for letter in sorted(after):
        yield from not_beginning(head + letter, longer)


def _rule(name: str, flow: str, messages: Iterable[str], keys: Iterable[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}

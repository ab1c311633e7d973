"""What machines may do on the hub: zenoh's access rules for the door.

A machine of the trusted names may do everything. Any other that has a certificate may listen, ask what is kept and how
things are, answer, and say everything but commands (`bridge.config.rules`).

zenoh refuses a key where a rule's expression includes it, not where the two meet: ``**`` would pass a rule that denies
``*/cmd_vel/**``, and a put on ``**`` reaches every subscription. So nothing is denied here. What a guest may say is a
list of expressions none of which meets a command's key: types that end like no command's, letter by letter.
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
from bridge.hub.wire.keys import dds_type_name

ANYBODY = "*"
"""In the list of trusted names: every machine that may join."""

_CACHES = "**/@adv/**"
_STORE = "midspan/store"
_SPACES = ("**", _CACHES, abandon_key("**"), f"{_STORE}/*/@sync/**", f"{ADMIN_SPACE}/**", f"{MIDSPAN_SPACE}/**")
"""``**`` does not match what begins with ``@``."""

_LISTENING = ("declare_subscriber", "liveliness_token", "liveliness_query", "declare_liveliness_subscriber")
_EVERYTHING = ("put", "delete", "query", "reply", "declare_queryable", *_LISTENING)

_GOAL = "Goal_"
"""Types of goals and cancels end so: MoveBaseActionGoal_, NavigateToPose_SendGoal_, CancelGoal_."""

QUESTIONS = (
    *(f"*/**/$*::srv::dds_::{verb}$*/RIHS01_$*" for verb in ("Get", "List", "Describe")),
    "*/**/$*::action::dds_::$*_GetResult_/RIHS01_$*",
)
"""Services that change nothing."""

_READING = (f"{_STORE}/**", f"{_STORE}/*/@sync/digest/**", f"{_STORE}/*/@sync/fetch/**")
"""What is kept (`bridge.stores`): whoever may join reads it, and those who are trusted alone change it."""

_ANSWERS = tuple(f"*/**/$*::{middle}::dds_::$*/RIHS01_$*" for middle in ("srv", "action"))
"""A server may answer who calls it, also whether it takes a goal."""

_TYPE_LETTERS = string.ascii_letters + string.digits + "_:"
_NAME_LETTERS = string.ascii_letters + string.digits + "_-."


def access_control(door: OpenSection, routing: RoutingSection, loopback: Sequence[str]) -> dict[str, Any]:
    """The ``access_control`` of the door's zenoh configuration.

    The routing rules name commands beyond the usual ones. ``loopback`` names this machine's loopback interfaces; they
    count only where there is no TLS.
    """
    here = {"interfaces": list(loopback)} if door.insecure else {"link_protocols": ["tcp", "unixsock-stream"]}
    others: dict[str, Any] = {} if door.insecure else {"link_protocols": ["tls", "quic"]}
    names = [name for name in door.trusted if name != ANYBODY]
    subjects = [{"id": "here", **here}, {"id": "others", **others}]
    masters = ["here", *(["others"] if ANYBODY in door.trusted else [])]
    if names:
        subjects.append({"id": "trusted", "cert_common_names": names, **others})
        masters.append("trusted")
    control = f"{MIDSPAN_SPACE}/**"
    harmless = harmless_keys(commands(routing))
    guest = [
        _rule("hear", "egress", _EVERYTHING, _SPACES),
        _rule("join", "ingress", _LISTENING, _SPACES),
        _rule("say", "ingress", ("put", "reply"), (*harmless, control)),
        _rule("answer", "ingress", ("reply",), _ANSWERS),
        # who is asked for a latched command could answer on any key
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
    """Key expressions of samples that do not command; together all of them, as far as types are spelled as in ROS.

    ``commanding`` has the types that command, with the last parts of their topics' names (words, ``*`` at their end).
    """
    types = {type_name: dds_type_name(type_name) for type_name in commanding}
    endings = {_GOAL, *(f":{name.rpartition(':')[2]}" for name in types.values())}
    keys = [f"*/**/{chunk}/RIHS01_$*" for chunk in not_ending("_", endings)]
    for type_name, parts in commanding.items():
        if EVERY not in parts:
            keys += [f"*/**/{chunk}/{types[type_name]}/RIHS01_$*" for chunk in not_beginning("", parts)]
    return keys


def not_ending(tail: str, endings: Iterable[str]) -> Iterator[str]:
    """Expressions for the chunks that end with ``tail`` and with none of the endings, each of which is longer."""
    longer = {ending for ending in endings if ending.endswith(tail)}
    if tail in longer:
        return
    before = {ending[-len(tail) - 1] for ending in longer}
    yield from (f"$*{letter}{tail}" for letter in _TYPE_LETTERS if letter not in before)
    for letter in sorted(before):
        yield from not_ending(letter + tail, longer)


def not_beginning(head: str, words: Iterable[str]) -> Iterator[str]:
    """Expressions for the chunks that begin with ``head`` and are none of the words; ``go*`` is all that begin so."""
    longer = {word for word in words if word.startswith(head)}
    if f"{head}*" in longer:
        return
    if head and head not in longer:
        yield head
    after = {word[len(head)] for word in longer if len(word) > len(head)}
    yield from (f"{head}{letter}{'$*'}" for letter in _NAME_LETTERS if letter not in after)
    for letter in sorted(after):
        yield from not_beginning(head + letter, longer)


def _rule(name: str, flow: str, messages: Iterable[str], keys: Iterable[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}

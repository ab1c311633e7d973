"""The configuration determines how calls from YARP programs are answered."""

from __future__ import annotations

from typing import Any
from unittest.mock import Mock

import pytest
from pydantic import ValidationError

from bridge.adapters.worker import BridgeWorker
from bridge.config.model import Config
from bridge.config.sections.yarp import YarpSection
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile

RULES = [{"port": "/old/*", "release": "3.9.1"}, {"port": "/old/but/new", "release": "4"}]

GUESS = "a guess: several releases send such requests"
YARP3 = "its bytes are YARP 3's; the release of YARP 3 is a guess"


@pytest.mark.parametrize(
    ("section", "peer", "profile", "generation", "why"),
    [
        ({}, "/any", None, "3.12", GUESS),
        ({}, "/any", Profile.YARP3, "3.12", GUESS),
        ({"profile": "yarp4"}, "/any", None, "4.0", GUESS),
        ({"profile": "yarp4"}, "/any", Profile.YARP3, "3.12", YARP3),
        ({"release": "3.11.2"}, "/any", None, "3.11", "its name server's generation"),
        ({"peers": RULES}, "/old/but/new", None, "3.6", "set by the rule for /old/*"),
        ({"peers": RULES}, "/any", Profile.YARP4, "4.0", "its bytes are YARP 4's"),
        ({"peers": RULES}, "/old/one", Profile.YARP4, "4.0", "its bytes are YARP 4's"),
        ({"release": "3.9", "profile": "yarp4"}, "/any", Profile.YARP3, "3.6", "its name server's generation"),
        ({"release": "4.0"}, "/any", Profile.YARP3, "3.12", YARP3),
    ],
)
def test_each_client_gets_the_replies_of_its_release(
    section: dict[str, Any], peer: str, profile: Profile | None, generation: str, why: str
) -> None:
    decided = YarpSection.model_validate(section).generations().of(peer, profile)
    parsed = decided.as_dict()
    cure = parsed.pop("generation_cure", "")
    assert parsed == {"generation": generation, "generation_why": why}
    assert ("guess" in why) is (cure != "")
    assert not cure or ("yarp.peers: [{port: /any, release: '3.9'}]" in cure and "yarp.release: '3.9'" in cure)


def test_a_new_release_restarts_nothing_but_a_new_address_does() -> None:
    """The test uses what workers compare on a reload."""
    old = Config.model_validate({"yarp": {"address": "robot:10000"}})
    parsed = Config.model_validate({"yarp": {"address": "robot:10000", "release": "3.9", "peers": RULES}})
    topics = Config.model_validate({"yarp": {"address": "robot:10000", "topics": [{"topic": "/x", "as": "natural"}]}})
    moved = Config.model_validate({"yarp": {"address": "other:10000"}})
    joined = BridgeWorker("yarp")
    joined.config, joined.bridges = old, [Mock()]
    other = BridgeWorker("ros1")
    other.config, other.bridges = old, [Mock()]
    for new, stays_joined, stays_open in ((parsed, True, True), (topics, False, True), (moved, False, False)):
        joined.config = other.config = old
        assert joined.reload(new) is stays_joined
        assert new.yarp.opens_as(old.yarp) is stays_open
        assert other.reload(new)


def test_the_introduction_of_a_peer_overrides_the_rules() -> None:
    generations = YarpSection.model_validate({"peers": RULES}).generations()
    generations.introduced("/old/one")
    assert generations.of("/old/one").generation is Generation.YARP_4
    assert generations.of("/old/two").generation is Generation.YARP_3_6


@pytest.mark.parametrize(
    "section", [{"release": "2.3"}, {"release": "new"}, {"peers": [{"port": "/a", "release": ""}]}]
)
def test_an_invalid_release_is_refused(section: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"is not a supported version of YARP: give one from 3\.6 on"):
        YarpSection.model_validate(section)

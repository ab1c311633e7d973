"""The configuration says how the calls of YARP programs are answered."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from bridge.config.sections.yarp import YarpSection
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile

RULES = [{"port": "/old/*", "release": "3.9.1"}, {"port": "/old/but/new", "release": "4"}]


@pytest.mark.parametrize(
    ("section", "peer", "profile", "generation", "why"),
    [
        ({}, "/any", None, "3.12", "its name server's generation"),
        ({"profile": "yarp4"}, "/any", None, "4.0", "its name server's generation"),
        ({"release": "3.11.2"}, "/any", None, "3.11", "its name server's generation"),
        ({"peers": RULES}, "/old/but/new", None, "3.6", "the rule for /old/* says so"),
        ({"peers": RULES}, "/any", Profile.YARP4, "4.0", "its bytes are YARP 4's"),
        ({"peers": RULES}, "/old/one", Profile.YARP4, "4.0", "its bytes are YARP 4's"),
        ({"release": "3.9", "profile": "yarp4"}, "/any", Profile.YARP3, "3.6", "its name server's generation"),
        ({"release": "4.0"}, "/any", Profile.YARP3, "3.12", "its bytes are YARP 3's"),
    ],
)
def test_who_is_answered_how(
    section: dict[str, Any], peer: str, profile: Profile | None, generation: str, why: str
) -> None:
    decided = YarpSection.model_validate(section).generations().of(peer, profile)
    assert decided.as_dict() == {"generation": generation, "generation_why": why}


def test_what_a_peer_told_itself_outweighs_the_rules() -> None:
    made = YarpSection.model_validate({"peers": RULES}).generations()
    made.introduced("/old/one")
    assert made.of("/old/one").generation is Generation.YARP_4
    assert made.of("/old/two").generation is Generation.YARP_3_6


@pytest.mark.parametrize(
    "section", [{"release": "2.3"}, {"release": "new"}, {"peers": [{"port": "/a", "release": ""}]}]
)
def test_what_is_no_release_is_refused(section: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"is no version of YARP that this knows: give one from 3\.6 on"):
        YarpSection.model_validate(section)

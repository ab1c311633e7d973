"""Contact with a planner that did not answer."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from navigation.gateway import contact
from navigation.gateway.contact import PROOF_SECONDS, TRIAL_SECONDS, Contact

PARTS = frozenset({b"part"})


@pytest.mark.parametrize("before", [0.5, TRIAL_SECONDS + 0.5])
def test_a_stall_of_the_gateway_is_no_trial(monkeypatch: pytest.MonkeyPatch, before: float) -> None:
    """While the gateway stands still, no call to the planner can fail."""
    now = 100.0
    monkeypatch.setattr(contact, "time", SimpleNamespace(monotonic=lambda: now))
    lost = Contact()
    lost.lose(PARTS)
    now += before
    answers = lost.answers(PARTS)
    now += 20.0
    lost.excuse(20.0)
    assert lost.answers(PARTS) is answers
    assert not lost.proven
    now += TRIAL_SECONDS + PROOF_SECONDS
    assert lost.answers(PARTS)
    assert lost.proven


def test_a_loss_during_a_stall_is_not_excused_into_the_future(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(contact, "time", SimpleNamespace(monotonic=lambda: now))
    lost = Contact()
    lost.lose(PARTS)
    lost.excuse(20.0)
    now += TRIAL_SECONDS + 0.1
    assert lost.answers(PARTS)

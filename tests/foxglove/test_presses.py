"""Which controls count as held after a reconnection or a restart."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import MagicMock

import pytest

from bridge.foxglove import presses
from bridge.foxglove.presses import Press, Presses


def opened(folder: Path) -> Presses:
    """Open the presses of a worker whose background jobs run at once."""
    host = MagicMock(folder=folder)
    host.background.submit = lambda prepare, deliver: deliver(prepare()())
    return Presses(host)


def test_a_held_control_must_be_pressed_anew_after_a_restart(tmp_path: Path) -> None:
    held, other, before = Press(5.0, 6.0, held=True), Press(7.0, 8.0, held=True), opened(tmp_path)
    for person, press in (("anna", held), ("10.0.0.1", other)):
        assert before.held_by(person) is None
        before.note(person, press)
        assert before.held_by(person) is press
    other.held = False
    before.note("10.0.0.1", other)
    before.note("anna", Press(9.0, 9.0))
    assert before.held_by("anna") is held, "zero on another connection does not release it"
    after = opened(tmp_path)
    assert (after.held_by("anna"), after.held_by("10.0.0.1")) == (Press(0.0, held=True, refused=True), None)
    released = Press(10.0, 11.0, held=True)
    after.note("anna", released)
    released.held = False
    after.note("anna", released)
    assert opened(tmp_path).held_by("anna") is None


@pytest.mark.parametrize("content", ["", "[", "3", "{}"])
def test_a_damaged_file_names_nobody(tmp_path: Path, content: str) -> None:
    (tmp_path / "held").write_text(content)
    assert opened(tmp_path).held_by("anna") is None


def test_the_number_of_persons_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(presses, "MOST_PERSONS", 2)
    several = opened(tmp_path)
    for name in ("first", "second", "first", "third"):
        several.note(name, Press(1.0, held=True))
    assert [bool(several.held_by(name)) for name in ("first", "second", "third")] == [True, False, True]

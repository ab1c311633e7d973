"""The watch for new key files."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from typing_extensions import override

from bridge.config.model import Config
from bridge.hub.security import external_access
from bridge.hub.security.certificates import Authority
from bridge.hub.security.external_access import ExternalAccess
from bridge.hub.security.key_files import KeyFiles
from bridge.hub.security.key_watch import KeyWatch


class UnreadableKey(KeyFiles):
    """Files whose key the process may not read until ``readable`` is set; tests may run as root, who reads all."""

    readable = False

    @override
    def trouble(self) -> str:
        return "" if UnreadableKey.readable else f"{self.key} cannot be used: [Errno 13] Permission denied"


def make(folder: Path) -> KeyFiles:
    authority = Authority(folder)
    if not authority.exists():
        authority.make()
    authority.issue("robot", replace=True)
    return KeyFiles(folder / "ca.pem", folder / "robot.pem", folder / "robot.key")


def test_new_files_are_used_after_their_owner_is_corrected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """`chown` and `chmod` change neither content nor time of a file that root has copied."""
    made = make(tmp_path)
    watch = KeyWatch(UnreadableKey(made.ca, made.certificate, made.key))
    monkeypatch.setattr(UnreadableKey, "readable", False)
    assert not watch.renewed()
    assert watch.trouble == ""
    make(tmp_path)
    with caplog.at_level(logging.ERROR):
        assert [watch.renewed() for _ in range(4)] == [False] * 4
    assert "Permission denied" in watch.trouble
    assert caplog.text.count("Permission denied") == 1
    UnreadableKey.readable = True
    assert watch.renewed()
    assert watch.trouble == ""
    assert not watch.renewed()


def test_trouble_ends_when_the_old_files_are_back(tmp_path: Path) -> None:
    files = make(tmp_path)
    saved = tmp_path / "saved.key"
    watch = KeyWatch(files)
    files.key.rename(saved)
    files.key.write_text("no key", encoding="utf-8")
    assert not any([watch.renewed(), watch.renewed()])
    assert "robot.key" in watch.trouble
    saved.rename(files.key)
    assert not watch.renewed()
    assert watch.trouble == ""


def test_a_new_authority_is_used_with_the_certificate_that_it_signed(tmp_path: Path) -> None:
    """The files arrive one after the other; with the first alone, no machine would accept this one."""
    files = make(tmp_path / "here")
    new = make(tmp_path / "new")
    watch = KeyWatch(files)
    files.ca.write_bytes(new.ca.read_bytes())
    assert not any([watch.renewed(), watch.renewed()])
    assert f"{files.certificate} was not signed by {files.ca}" in watch.trouble
    files.certificate.write_bytes(new.certificate.read_bytes())
    files.key.write_bytes(new.key.read_bytes())
    assert [watch.renewed(), watch.renewed()] == [False, True]
    assert watch.trouble == ""


def test_status_warns_of_new_files_that_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class OpenRouter:
        trouble = ""

        def __init__(self, *_: object) -> None:
            pass

    files = make(tmp_path)
    monkeypatch.setattr(external_access, "ExternalRouter", OpenRouter)
    access = ExternalAccess(None)
    config = Config.model_validate(
        {"name": "robot", "hub": {"open": {"listen": ["tls/127.0.0.1:7449"], "keys": str(tmp_path)}}}
    )
    access.open(config)
    assert access.warning() == ""
    files.key.write_text("no key", encoding="utf-8")
    for _ in range(2):
        access.check(config)
    assert access.warning().startswith("hub.open: the new certificates cannot be used, the old ones stay in use:")

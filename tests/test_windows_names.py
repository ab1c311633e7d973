"""Names that users choose become valid file names on Windows, too, or are refused with the reason."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bridge import state_file
from bridge.bags.bag import BagError
from bridge.bags.writers import complete_file
from bridge.config.model import Config
from bridge.hub.security.certificates import Authority, CertificateError
from bridge.hub.security.external_router import key_files
from bridge.web.verbs.map_files import file_of
from navigation.map2d_server.files import MapsFolder
from tests.support.hidden import is_windows_name
from yarp_compat.dev.mapfile import MapFileError, file_name, write
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import save_maps


@pytest.fixture(autouse=True)
def _windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")


@pytest.mark.parametrize("name", ["CON", "con.lab", "robot1.", "nul"])
def test_a_daemon_of_any_name_has_state_files_and_keys(name: str, tmp_path: Path) -> None:
    config = Config(name=name, state=tmp_path)
    keys = key_files(config)
    paths = [
        state_file.worker_folder(config), state_file.daemon_lock(config), state_file.worker_lock(config, "yarp"),
        state_file.worker_output(config, "yarp"), state_file.control_socket(config, "yarp"),
        state_file.daemon_socket(config), keys.certificate, keys.key,
    ]  # fmt: skip
    assert [path.name for path in paths if not is_windows_name(path.name)] == []
    assert len(set(paths)) == len(paths)


@pytest.mark.parametrize("name", ["CON.mcap", "a:b.mcap", "aux", "run.mcap."])
def test_a_bag_with_an_invalid_file_name_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="not a file name on Windows"), complete_file(tmp_path / name, "mcap"):
        pytest.fail("it is not written")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["CON", "a?b", "floor."])
def test_maps_with_invalid_file_names_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(MapFileError, match="on Windows"):
        file_name(name)
    with pytest.raises(MapFileError, match="on Windows"):
        write(tmp_path / name, "text")
    with pytest.raises(ValueError, match="refused: it is not a file name on Windows"):
        MapsFolder(tmp_path).new(name, ".map") if name != "floor." else MapsFolder(tmp_path).new(name)
    assert list(tmp_path.iterdir()) == []


def test_maps_whose_names_differ_only_in_case_are_not_saved(tmp_path: Path) -> None:
    grid = MapGrid2D()
    with pytest.raises(MapFileError, match="differ only in case"):
        save_maps({"lab": grid, "Lab": grid}, tmp_path / "maps.ini")


def test_a_file_from_the_page_with_an_invalid_name_is_refused() -> None:
    assert file_of("house.map") == "house.map"
    with pytest.raises(ValueError, match="is not a file name on Windows"):
        file_of("aux.map")


def test_a_certificate_with_an_invalid_file_name_is_refused(tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    authority.make()
    with pytest.raises(CertificateError, match=r"'com1'.*on Windows"):
        authority.issue("com1")

"""Which file names from clients are accepted, and which are rejected."""

from __future__ import annotations

from pathlib import Path

import pytest

from navigation.map2d_server.files import MapsFolder

HOSTILE = (
    "", ".", "..", "../x.map", "/etc/passwd", "a/b.map", "..\\x.map", "C:\\x.map", "file:///etc/passwd",
    "package://x/y.yaml", ".hidden.map", "x\0.map", "x\n.map", "x" * 300 + ".map", "x.sh", "x.map.exe", "~/x.map/",
    "\ud800.map",
)  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_names_that_are_not_plain_are_rejected(tmp_path: Path, name: str) -> None:
    folder = MapsFolder(tmp_path / "maps")
    for ask in (folder.file, folder.existing, folder.new):
        with pytest.raises(ValueError, match=r"refused|invalid file name"):
            ask(name, ".map")
    assert list(tmp_path.iterdir()) == []


def test_plain_names_are_accepted(tmp_path: Path) -> None:
    folder = MapsFolder(tmp_path / "maps")
    assert folder.new("first floor.map", ".map") == tmp_path / "maps" / "first floor.map"
    assert folder.file("Küche", ".map").name == "Küche.map"
    assert folder.file("m.YAML", ".yaml", ".yml").name == "m.YAML"
    with pytest.raises(FileNotFoundError, match="no file"):
        folder.existing("m1", ".map", ".yaml")
    (tmp_path / "maps" / "m1.yaml").write_text("")
    assert folder.existing("m1", ".map", ".yaml").name == "m1.yaml"


def test_links_out_of_the_folder_are_rejected(tmp_path: Path) -> None:
    folder = MapsFolder(tmp_path / "maps")
    folder.path.mkdir()
    (tmp_path / "outside.map").write_text("secret")
    (folder.path / "link.map").symlink_to(tmp_path / "outside.map")
    (folder.path / "good.map").write_text("")
    (folder.path / "near.map").symlink_to("good.map")
    with pytest.raises(ValueError, match="a link out of"):
        folder.existing("link.map", ".map")
    assert folder.existing("near.map", ".map").name == "near.map"

"""The page's views: their files, and a view that is added."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bridge.web import views
from bridge.web.serving.page_files import STATIC, PageFiles, Tab
from tests.peers.browser.page import TestPage
from tests.support.wait import until
from tests.web import example_view
from tests.web.conftest import Desk
from tests.web.test_server import ask

IMPORT = re.compile(r'(?:^import|^export|\bfrom|\bimport\()[^"\n]*"([^"\n]+\.js)"', re.MULTILINE)
BATTERY = "sensor_msgs/BatteryState"


def test_a_view_imports_only_its_own_files_and_the_library() -> None:
    wrong = []
    for file in STATIC.rglob("*.js"):
        own = file.parent.relative_to(STATIC)
        for name in IMPORT.findall(file.read_text()):
            target = Path(os.path.normpath(own / name))
            assert (STATIC / target).is_file() or target == Path("views.js"), f"{file}: {name}"
            allowed = (own, Path("lib"), Path("views.js")) if own == Path() else (own, Path("lib"))
            if not any(target == place or target.is_relative_to(place) for place in allowed):
                wrong.append(f"{file.relative_to(STATIC)} imports {name}")
    assert not wrong


def test_each_view_has_a_folder_with_its_files() -> None:
    names = [view.name for view in views.all_views()]
    assert {folder.name for folder in (STATIC / "views").iterdir()} == set(names)
    assert all(re.fullmatch("[a-z]+", name) for name in names)
    assert {file.name for file in STATIC.iterdir() if file.is_file()} == {
        "app.js", "icon.svg", "index.html", "style.css",
    }  # fmt: skip


@pytest.mark.parametrize("name", ["my-view", "View", "", 'a"b', "ü"])
def test_invalid_view_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="must consist of lower-case letters"):
        Tab(name=name, label="My view", icon="")


def test_a_view_may_have_a_reserved_word_as_its_name() -> None:
    module = PageFiles([Tab(name="new", label="New", icon="")]).views()
    assert module == 'import view_new from "./views/new/view.js";\nexport const VIEWS = { new: view_new };\n'


def test_the_page_has_the_tabs_the_sections_and_the_styles_of_its_views(desk: Desk) -> None:
    page = ask(desk.port, "/")[2].decode()
    module = ask(desk.port, "/views.js")[2].decode()
    assert "<!--" not in page
    for view in views.all_views():
        assert f'<a href="#{view.name}"><svg' in page
        assert f'<section id="{view.name}" class="view" aria-label="{view.label}" hidden>' in page
        assert f'import view_{view.name} from "./views/{view.name}/view.js";' in module
        for link in re.findall(rf'href="(views/{view.name}/[^"]*)"', page):
            assert ask(desk.port, f"/{link}")[0] == 200
        assert ask(desk.port, f"/views/{view.name}/view.js")[0] == 200
    assert ask(desk.port, "/index.html")[2].decode() == page


def test_the_view_of_the_documentation_is_added_by_three_edits(
    desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = example_view.PAGE.read_text()
    assert len(re.findall(r"^\*\*\d\.\*\*", text, re.MULTILINE)) == 3
    example_view.add(tmp_path / "copy", monkeypatch)
    desk.open_with()
    assert '<a href="#battery"><svg viewBox="0 0 24 24" aria-hidden="true"><path' in ask(desk.port, "/")[2].decode()
    assert 'import view_battery from "./views/battery/view.js";' in ask(desk.port, "/views.js")[2].decode()
    script = ask(desk.port, "/views/battery/view.js")[2].decode()
    (feed,) = re.findall(r'socket\.watch\("([^"]+)"', script)
    out = desk.far.advertise("/battery_state", BATTERY, latched=True, depth=1)
    desk.far.publish(out, {"percentage": 0.25})
    with TestPage(desk.port) as page:
        page.watch(feed)
        assert page.value(feed)["message"]["percentage"] == 0.25


class Watcher:
    def __init__(self) -> None:
        self.texts: list[str] = []

    def changed(self, _name: str, _n: int, text: str) -> None:
        self.texts.append(text)


def test_the_feeds_and_verbs_of_the_documentation_work(
    desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (block,) = example_view.BLOCK.findall(example_view.PAGE.read_text())
    names: dict[str, Any] = {}
    exec(block, names)
    view = replace(names["VIEW"], folder=tmp_path)
    monkeypatch.setattr("bridge.web.worker.all_views", lambda: (*views.all_views(), view))
    desk.open_with()
    console, watcher = desk.console, Watcher()
    assert console.verbs.begin("dock", {"on": True}, "test").result(40) == "docking: True"
    loop = console.host.loop
    loop.call(lambda: console.feeds.find("charge").watch(watcher))
    out = desk.far.advertise("/battery_state", BATTERY, depth=1)

    def shown() -> bool:
        desk.far.publish(out, {"percentage": 0.25})
        return any('"percent":25' in text for text in watcher.texts)

    until(shown, "the charge is shown", 20, every=0.2)


def test_a_view_outside_the_tree_uses_its_own_folder(tmp_path: Path) -> None:
    (tmp_path / "view.js").write_text("export default () => ({});\n")
    (tmp_path / "view.css").write_text("\n")
    view = views.View(name="battery", label="Battery & more", icon="<path/>", folder=tmp_path)
    files = PageFiles([view])
    assert 'href="views/battery/view.css"' in files.index()
    assert "Battery &amp; more</a>" in files.index()

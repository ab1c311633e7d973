"""Creates the example of docs/develop/add_a_view.md, by applying the page's edits to a copy of the console's files."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import pytest

from bridge.web import views
from bridge.web.serving import page_files

PAGE = Path(__file__).parents[2] / "docs" / "develop" / "add_a_view.md"
EDIT = re.compile(r"^```\w+\n(?://|#) (bridge/\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINE = re.compile(r'^\*\*3\.\*\* `"([\w.]+:VIEW)"` goes into `VIEWS`', re.MULTILINE)
BLOCK = re.compile(r"^```python\n(?!# bridge)(.*?)^```$", re.MULTILINE | re.DOTALL)


def add(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the edits for this test."""
    static, modules = folder / "bridge/web/static", folder / "bridge/web/views"
    shutil.copytree(page_files.STATIC, static)
    text = PAGE.read_text()
    for name, content in EDIT.findall(text):
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)
    (line,) = LINE.findall(text)
    monkeypatch.setattr(page_files, "STATIC", static)
    monkeypatch.setattr(views, "__path__", [*views.__path__, str(modules)])
    monkeypatch.setattr(views, "VIEWS", (*views.VIEWS, line))
    monkeypatch.setitem(sys.modules, line.partition(":")[0], None)  # the imported module is forgotten after the test
    del sys.modules[line.partition(":")[0]]

"""The files of the console's page: the common files, and a folder for each view."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

STATIC = Path(__file__).parents[1] / "static"
_NAME = re.compile("[a-z]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tab:
    """A view as the page shows it.

    Attributes:
        name: the view's name in addresses (``#name``); lower-case letters.
        label: the text of the tab.
        icon: the SVG elements of the tab's icon, in a 24 by 24 view box.
        folder: the folder of ``view.js``, and of ``view.css`` if it has styles; by default ``static/views/NAME``.
    """

    name: str
    label: str
    icon: str
    folder: Path | None = None

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"view {self.name!r}: the name must consist of lower-case letters")

    @property
    def files(self) -> Path:
        """The folder of the view's files."""
        return self.folder or STATIC / "views" / self.name


class PageFiles:
    """The page with the given views; the page shows the first view if the address names none."""

    def __init__(self, tabs: Sequence[Tab]) -> None:
        self._tabs = tabs

    @property
    def routes(self) -> list[BaseRoute]:
        return [
            *(Route(path, self._index) for path in ("/", "/index.html")),
            Route("/views.js", self._views),
            *(Mount(f"/views/{tab.name}", StaticFiles(directory=tab.files)) for tab in self._tabs),
            Mount("/", StaticFiles(directory=STATIC)),
        ]

    def index(self) -> str:
        """Return the page with the views' styles, tabs and sections."""
        styles = [tab.name for tab in self._tabs if (tab.files / "view.css").is_file()]
        parts = {
            "styles": [f'<link rel="stylesheet" href="views/{name}/view.css">' for name in styles],
            "tabs": [
                f'    <a href="#{tab.name}"><svg viewBox="0 0 24 24" aria-hidden="true">{tab.icon}</svg>'
                f"{html.escape(tab.label)}</a>"
                for tab in self._tabs
            ],
            "sections": [
                f'  <section id="{tab.name}" class="view" aria-label="{html.escape(tab.label)}" hidden></section>'
                for tab in self._tabs
            ],
        }
        text = (STATIC / "index.html").read_text(encoding="utf-8")
        for name, lines in parts.items():
            text = text.replace(f"<!-- {name} -->", "\n".join(lines).lstrip())
        return text

    def views(self) -> str:
        """Return the module ``views.js``, which exports each view's function under the view's name."""
        # a name such as "new" can be a key in JavaScript, but not a variable
        imports = [f'import view_{tab.name} from "./views/{tab.name}/view.js";' for tab in self._tabs]
        views = ", ".join(f"{tab.name}: view_{tab.name}" for tab in self._tabs)
        return "\n".join([*imports, f"export const VIEWS = {{ {views} }};", ""])

    async def _index(self, _request: Request) -> Response:
        return Response(self.index(), media_type="text/html; charset=utf-8")

    async def _views(self, _request: Request) -> Response:
        return Response(self.views(), media_type="text/javascript; charset=utf-8")

"""In the documentation, links resolve, configurations load, and commands parse."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import yaml

from bridge.cli.main import build_parser
from bridge.config.load import loads
from bridge.config.model import Config

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "CHANGELOG.md")),
        *(ROOT / "docs").rglob("*.md"),
        ROOT / "benchmarks" / "README.md",
        ROOT / "examples" / "README.md",
    ]
)
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)")


def blocks(language: str) -> list[tuple[str, str]]:
    """Return the code blocks of a language in all pages, each with its page's path."""
    code_blocks = [(page, name, code) for page in PAGES for name, code in BLOCK.findall(page.read_text())]
    return [(str(page.relative_to(ROOT)), code) for page, name, code in code_blocks if name == language]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_heading(page: Path) -> None:
    links = [link for link in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link]
    assert [link for link in links if not resolves(page, link)] == []


def resolves(page: Path, link: str) -> bool:
    """Return whether a link's file and heading exist."""
    target, _, heading = link.partition("#")
    file = page.parent / target if target else page
    return file.exists() and (not heading or heading in anchors(file))


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as on GitHub."""
    titles = re.findall(r"^#+ (.*)$", BLOCK.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_bold_text_is_closed() -> None:
    """An unmatched mark is shown as asterisks, and may make the rest of a paragraph bold."""
    unmatched = []
    for page in PAGES:
        prose = re.sub(r"^ {4}.*|`[^`]+`", "code", BLOCK.sub("", page.read_text()), flags=re.MULTILINE)
        parts = re.split(r"\n\s*\n|\n(?=\s*(?:-|\||[0-9]+\.) )", prose)
        unmatched += [(page.name, part[:60]) for part in parts if part.count("**") % 2 or "***" in part]
    assert unmatched == []


def test_pages_name_only_existing_tests() -> None:
    sources = "".join(file.read_text() for file in (ROOT / "tests").rglob("test_*.py"))
    existing = set(re.findall(r"^def (test_\w+)", sources, re.MULTILINE))
    named = {name for page in PAGES for name in re.findall(r"`(test_\w+)`", page.read_text())}
    assert "test_topics_of_cyclone_dds_are_bridged_both_ways" in named
    assert named - existing == set()


@pytest.mark.parametrize("folder", sorted(p for p in (ROOT / "docs").iterdir() if p.is_dir()), ids=lambda p: p.name)
def test_each_page_is_in_its_index(folder: Path) -> None:
    index = set(LINK.findall((folder / "README.md").read_text()))
    assert {page.name for page in folder.glob("*.md")} - index == {"README.md"}


def configurations() -> list[tuple[str, str]]:
    """Return the YAML blocks that contain only keys of the configuration."""
    sections = []
    for page, code in blocks("yaml"):
        data = yaml.safe_load(code)
        if isinstance(data, dict) and set(data) <= set(Config.model_fields):
            sections.append((page, code))
    return sections


@pytest.mark.parametrize(("page", "code"), configurations())
def test_every_configuration_in_the_documents_is_valid(page: str, code: str, tmp_path: Path) -> None:
    # example paths do not exist here; everything else must be valid
    empty = tmp_path / "empty"
    empty.touch()
    text = re.sub(
        r"(?<=[\[\s])/(?:home|etc|opt)/[\w./-]+",
        lambda path: str(empty if Path(path[0]).suffix else tmp_path),
        code,
    )
    assert isinstance(loads(text, tmp_path / "page.md"), Config)


def test_there_are_configurations() -> None:
    assert any(page == "README.md" for page, _ in configurations())


def commands() -> list[tuple[str, str]]:
    """Return the lines of shell blocks that call midspan."""
    shell = [block for language in ("", "sh", "bash") for block in blocks(language)]
    lines = [(page, line.removeprefix("$ ")) for page, code in shell for line in code.splitlines()]
    return [(page, line) for page, line in lines if line.startswith("midspan ")]


@pytest.mark.parametrize(("page", "line"), commands())
def test_every_command_in_the_documents_is_accepted(page: str, line: str) -> None:
    arguments = shlex.split(line, comments=True)[1:]
    for stop in ("|", ">", "&", "&&", "||", ";"):
        arguments = arguments[: arguments.index(stop)] if stop in arguments else arguments
    assert callable(build_parser(arguments[:1]).parse_args(arguments).run)

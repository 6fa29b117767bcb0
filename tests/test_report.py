"""The report: one page that opens offline, whole or not at all."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

import rangecam
from rangecam.errors import UsageError
from rangecam.report import Report


class Page(HTMLParser):
    """Collects what a page refers to, and its headings."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[str] = []
        self.headings: list[str] = []
        self._heading = False

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.references += [value or "" for name, value in attributes if name in ("src", "href")]
        self._heading = tag in ("h1", "h2")

    def handle_data(self, data: str) -> None:
        if self._heading:
            self.headings.append(data)
        self._heading = False


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("report") / "report.html"
    source = rangecam.open_source("scenario:approach-box")
    with Report(path, source.config, source.name) as report:
        for _ in rangecam.run(source.captures, source.config, [report]):
            pass
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    return path.read_text(encoding="utf-8")


def test_the_page_refers_to_nothing_outside_itself(page: str) -> None:
    parser = Page()
    parser.feed(page)
    assert len(parser.references) == 4
    assert all(reference.startswith("data:image/png;base64,") for reference in parser.references)
    assert not re.search(r"https?://|@import|<script", page)


def test_the_page_shows_images_the_life_of_a_frame_tracks_and_braking(page: str) -> None:
    parser = Page()
    parser.feed(page)
    assert parser.headings[0] == "scenario:approach-box"
    assert [heading.split(" at ")[0] for heading in parser.headings[1:]] == [
        "What the camera measured",
        "The life of this frame",
        "Segments and tracks from above",
        "Time to collision and brake",
    ]
    assert "brake      at" in page


def test_names_from_outside_are_escaped(tmp_path: Path) -> None:
    source = rangecam.open_source("scenario:test-scene", layers=[{"camera": {"rows": 12, "columns": 16}}])
    with Report(tmp_path / "r.html", source.config, "<script>x</script>") as report:
        for _ in rangecam.run(list(source.captures)[:2], source.config, [report]):
            pass
    assert "<script" not in (tmp_path / "r.html").read_text()


def test_a_run_without_frames_leaves_no_page(tmp_path: Path) -> None:
    source = rangecam.open_source("scenario:test-scene")
    with Report(tmp_path / "r.html", source.config):
        pass
    assert not list(tmp_path.iterdir())


def test_an_error_leaves_no_page(tmp_path: Path) -> None:
    source = rangecam.open_source("scenario:test-scene")

    def broken_run() -> None:
        with Report(tmp_path / "r.html", source.config) as report:
            next(rangecam.run(source.captures, source.config, [report]))
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        broken_run()
    assert not list(tmp_path.iterdir())


def test_a_page_in_a_missing_folder_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        Report(tmp_path / "x" / "r.html", rangecam.load_config())


@pytest.mark.parametrize("scenario", ["braking-car", "crossing-person"])
def test_every_family_has_a_report(scenario: str, tmp_path: Path) -> None:
    source = rangecam.open_source(f"scenario:{scenario}")
    with Report(tmp_path / "r.html", source.config, source.name) as report:
        for _ in rangecam.run(list(source.captures)[:30], source.config, [report]):
            pass
    assert (tmp_path / "r.html").stat().st_size > 20_000

"""A page: everything in one file, nothing that a value could break."""

import json
import re

import numpy as np
import pytest

from service.report.figure import Figure, line
from service.report.format import table
from service.report.page import Captioned, Page, Section
from tests.support.browser import BROWSER
from tests.support.tab import tab

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


def page_with(*parts, title="A title", lead="A lead.") -> str:
    return Page(title, "about", lead, "good", (), [Section("Part", parts)]).html()


def figure(name="a-figure", curve="</script><b>x") -> Figure:
    f = Figure(name, 1, 1, 300)
    f.add(0, 0, line(np.arange(3.0), np.arange(3.0), curve))
    return f


def test_the_library_is_there_once_and_only_where_something_is_drawn():
    drawn = page_with(Captioned(figure("one"), "c"), Captioned(figure("two"), "c"))
    assert drawn.count("plotly.js v") == 1
    assert "plotly.js v" not in page_with("<p>words</p>")


def test_nothing_is_loaded_from_elsewhere():
    page = page_with(Captioned(figure(), "c"))
    shell = re.sub(r"<script>.*?</script>", "", page, flags=re.S)
    assert not re.search(r'(src|href)="(?!#|data:)', shell)
    assert "@import" not in shell
    assert "url(" not in shell


@pytest.mark.parametrize("curve", ["</script><b>x", "<!--<script>", "<!-- x", "a < b"])
def test_data_cannot_end_their_script_nor_keep_it_from_ending(curve):
    page = page_with(Captioned(figure(curve=curve), "c"))
    data = re.search(r'id="a-figure-data">(.*?)</script>', page, flags=re.S)
    assert data is not None
    assert "<" not in data[1], "a parser of HTML looks for the script's end from any of these"
    assert json.loads(data[1])["data"][0]["name"] == curve


@needs_browser
def test_a_comment_that_looks_like_html_leaves_every_figure_and_the_text_after_it(tmp_path):
    parts = [Captioned(figure(f"figure-{k}", "<!--<script>"), "c") for k in range(2)]
    file = tmp_path / "page.html"
    file.write_text(page_with(*parts, "<p id='after'>words</p>"))
    with tab() as page:
        page.open(file.as_uri())
        page.until("document.querySelectorAll('figure:has(.main-svg)').length == 2")
        assert page.run("document.getElementById('after')?.textContent") == "words"
        assert page.complaints == []


def test_words_are_escaped():
    page = page_with(Captioned(figure(), "1 < 2 & so on"), title="<x>", lead="a < b")
    assert "<x>" not in page.replace("<script", "").split("<style>")[0].replace("<title>", "")
    assert "a &lt; b" in page
    assert "1 &lt; 2 &amp; so on" in page


def test_links_lead_to_their_parts():
    page = Page("t", "", "", "good", (), [Section("x-plane", []), Section("The end", [])]).html()
    for target in re.findall(r'href="#([^"]+)"', page):
        assert f'id="{target}"' in page


WIDE = table([f"a column of words {k}" for k in range(12)], [["12345.678 ± 0.012"] * 12])
FOUR = Figure("four", 1, 4, 300)


@needs_browser
def test_on_a_phone_tables_and_figures_scroll_in_their_own_boxes(tmp_path):
    for c in range(4):
        FOUR.add(0, c, line(np.arange(3.0), np.arange(3.0), f"a line {c}"))
    code = f"<p>Submit it: <code>{'x' * 200}</code></p>"
    sections = [Section("Part", [WIDE, code, Captioned(figure(), "one panel"), Captioned(FOUR, "four panels")])]
    sections += [Section(f"The part after that, {k}", []) for k in range(8)]
    file = tmp_path / "page.html"
    file.write_text(Page("A" * 80, "about", "A lead of " + "b" * 80, "good", (), sections).html())
    with tab() as page:
        page.narrow(390)
        page.open(file.as_uri())
        page.until("document.documentElement.dataset.drawn && document.querySelectorAll('.main-svg').length >= 2")
        assert page.wide() == 390
        assert page.run("document.querySelector('nav').offsetHeight") > 60, "the links wrap"
        hidden = "[...document.querySelectorAll('.scroll')].map((e) => e.scrollWidth > e.clientWidth)"
        assert page.run(hidden) == [True, True, True]
        drawn = page.run("[...document.querySelectorAll('figure .main-svg:first-child')].map((e) => e.clientWidth)")
        assert drawn[0] >= 700
        assert drawn[1] >= 1000, "four panels need more than one"
        assert page.run("[...document.querySelectorAll('.modebar')].every((e) => !e.offsetHeight)")
        assert page.run("document.getElementById('four').layout.dragmode") is False, "a finger scrolls"
        assert page.complaints == []


@needs_browser
def test_on_a_desk_nothing_scrolls_but_what_is_wider_than_the_page(tmp_path):
    file = tmp_path / "page.html"
    file.write_text(page_with(Captioned(figure(), "c"), table(["a", "b"], [["1", "2"]]), WIDE))
    with tab() as page:
        page.open(file.as_uri())
        page.until("document.documentElement.dataset.drawn && document.querySelector('.main-svg')")
        assert page.wide() == page.run("document.documentElement.clientWidth")
        hidden = "[...document.querySelectorAll('.scroll')].map((e) => e.scrollWidth > e.clientWidth)"
        assert page.run(hidden) == [False, False, True]

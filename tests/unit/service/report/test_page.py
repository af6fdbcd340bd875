"""A page: everything in one file, nothing that a value could break."""

import json
import re

import numpy as np

from service.report.figure import Figure, line
from service.report.page import Captioned, Page, Section


def page_with(*parts, title="A title", lead="A lead.") -> str:
    return Page(title, "about", lead, "good", (), [Section("Part", parts)]).html()


def figure(name="a-figure") -> Figure:
    f = Figure(name, 1, 1, 300)
    f.add(0, 0, line(np.arange(3.0), np.arange(3.0), "</script><b>x"))
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


def test_data_cannot_end_their_script():
    page = page_with(Captioned(figure(), "c"))
    data = re.search(r'id="a-figure-data">(.*?)</script>', page, flags=re.S)
    assert data is not None
    assert json.loads(data[1])["data"][0]["name"] == "</script><b>x"


def test_words_are_escaped():
    page = page_with(Captioned(figure(), "1 < 2 & so on"), title="<x>", lead="a < b")
    assert "<x>" not in page.replace("<script", "").split("<style>")[0].replace("<title>", "")
    assert "a &lt; b" in page
    assert "1 &lt; 2 &amp; so on" in page


def test_links_lead_to_their_parts():
    page = Page("t", "", "", "good", (), [Section("x-plane", []), Section("The end", [])]).html()
    for target in re.findall(r'href="#([^"]+)"', page):
        assert f'id="{target}"' in page

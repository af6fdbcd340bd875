"""docs/effects.md says what the catalogue says."""

from pathlib import Path

from sim.effect_page import effect_page
from sim.effects import CATALOGUE

PAGE = Path(__file__).resolve().parents[2] / "docs" / "effects.md"


def test_the_page_in_the_documentation_is_that_of_the_catalogue():
    assert PAGE.read_text(encoding="utf-8") == effect_page(), "python -m sim.effect_page > docs/effects.md"


def test_every_effect_has_its_law_its_parameters_and_its_source_on_the_page():
    page = effect_page()
    for one in CATALOGUE.values():
        section = page.split(f"### {one.id}\n")[1].split("\n##")[0]
        for words in (one.law, one.signature, one.separated_by, one.source, *(p.name for p in one.parameters)):
            assert words in section, (one.id, words)

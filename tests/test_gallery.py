"""Gallery: all figures and tables of the papers, drawn from runs, and the page as generated."""

import re
import runpy
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
# Figures and tables that the papers number.
NUMBERED = {
    "SATO": [f"Fig. {n}" for n in range(1, 7)],
    "Formation": [f"Fig. {n}" for n in range(1, 8)] + [f"Table {n}" for n in ("I", "II", "III")],
    "Connectivity": [f"Fig. {n}" for n in range(1, 8)] + ["Table I"],
}
LARGEST, LARGEST_SUM = 150_000, 3_000_000  # [byte]


@pytest.fixture(scope="module")
def gallery():
    sys.path.insert(0, str(ROOT / "scripts"))
    try:
        yield runpy.run_path(str(ROOT / "scripts/make_gallery.py"))
    finally:
        sys.path.remove(str(ROOT / "scripts"))


def test_page_is_as_generated_and_has_every_figure_and_table(gallery):
    page = (ROOT / "docs/gallery.md").read_text(encoding="utf-8")
    assert page == gallery["format_page"]()
    for paper, numbers in NUMBERED.items():
        found = re.findall(rf"^### {paper}, (.+)$", page, flags=re.M)
        singular = " ".join(found).replace("Figs. 4 and 5", "Fig. 4 Fig. 5")
        assert [n for n in numbers if not re.search(rf"{re.escape(n)}\b", singular)] == []


def test_pictures_exist_and_are_small(gallery):
    paths = sorted((ROOT / "docs/gallery").glob("*.png"))
    assert [path.stem for path in paths] == sorted(gallery["PICTURES"])
    sizes = [path.stat().st_size for path in paths]
    assert max(sizes) <= LARGEST and sum(sizes) <= LARGEST_SUM


def test_tables_are_those_of_the_page_on_formations():
    pages = [(ROOT / "docs" / name).read_text("utf-8") for name in ("gallery.md", "formation.md")]
    marks = re.findall(r'"(<!-- table\d \w+ -->)"', pages[0])
    assert len(marks) == 6 and all(pages[1].count(mark) == 1 for mark in marks)


@pytest.mark.parametrize("name", ["sato-1", "sato-3", "formation-3", "formation-4"])
def test_picture_is_drawn_from_its_runs(gallery, name):
    content = gallery["to_png"](gallery["draw"](gallery["PICTURES"][name]))
    with Image.open(BytesIO(content)) as image:
        pixels = np.asarray(image.convert("RGB"))
    assert image.width <= 1200 and len(np.unique(pixels.reshape(-1, 3), axis=0)) > 8
    assert len(content) <= LARGEST

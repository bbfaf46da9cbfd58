"""What tests of the app share."""

from __future__ import annotations

import shutil

import pytest

from apps import chromium_with, pages
from chromaperture.products.samples import open_sample

NAME = "still_life_cy_halves"


@pytest.fixture(scope="module")
def browser(driver, tmp_path_factory):
    with chromium_with(driver, tmp_path_factory.mktemp("camera"), open_sample(NAME, quality="real-time")[1]) as started:
        yield started


@pytest.fixture
def page_at(browser, app):
    with pages(browser, app.url) as opened:
        yield opened


@pytest.fixture
def pictures(tmp_path, rendered):
    """Boards at 2000, 1000 and 3000 mm, as a folder of 10-bit counts."""
    place = tmp_path / "bench camera"
    place.mkdir()
    for i, at in enumerate((2000, 1000, 3000)):
        shutil.copyfile(rendered / "board" / f"{at}.png", place / f"{i}.png")
    return place

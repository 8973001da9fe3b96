"""Pages of identifications and folders of touches."""

import re
from pathlib import Path

from message_helpers import missing
from report_helpers import Elements

from tactile_loc import Identification, KnownObject, Verdict
from tactile_loc.locate.touch_files import LocatedFile
from tactile_loc.reports.page import Page, render
from tactile_loc.reports.tasks import make_folder_page, make_identification_page


def read(page: Page) -> Elements:
    """Return the elements of a page, after checks that hold for every page without plots."""
    html = render(page)
    assert len(html) < 1e6  # without plotly
    found = Elements(html)
    assert all(str(a["src"]).startswith("data:image/png") for a in found.named("img"))
    assert "<script>alert" not in html
    return found


def list_cells(page: Page) -> list[str]:
    """Return the texts of a page's table cells."""
    return re.findall(r"<td[^>]*>([^<]*)</td>", render(page))


def make_identification(localization, names: list[str]) -> Page:
    objects = [KnownObject(name, p, 0.5, localization) for name, p in zip(names, (0.39, 0.31), strict=True)]
    return make_identification_page(Identification(tuple(objects), 0.3), [localization.touch])


def test_an_identification_has_its_verdict_as_title(localization):
    page = make_identification(localization, ["hook", "head"])
    assert page.title.startswith("ambiguous: hook 39 %, head 31 %")
    found = read(page)
    iou = f"{100 * localization.best.imprint_iou:.0f}"
    assert {"hook", "head", "none of these", "39.0", iou} <= set(list_cells(page))
    assert len(found.named("img")) == 1


def test_a_folder_counts_its_verdicts(localization):
    found = [
        LocatedFile(Path("a.npz"), localization.best, verdict=Verdict.CERTAIN),
        LocatedFile(Path("b.npz"), localization.best, verdict=Verdict.CERTAIN),
        LocatedFile(Path("c.npz"), problem="c.npz is no touch"),
    ]
    page = make_folder_page(found, {"a.npz": localization.touch}, "pin on gelslim, from touches")
    assert page.title == "3 touches: 2 certain, 1 refused"
    shown = read(page)
    assert not missing(shown.text, "a.npz", "b.npz", "c.npz is no touch", "2 touches are not drawn")

"""The dossier in a real browser: drawn with no message and no request, printed on two pages, with holes and without."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from service.reports.dossier import Dossier
from service.storage.accidents import AccidentRow
from service.storage.evidence import EvidenceRow
from service.storage.reviews import ReviewRow
from tests.browsing import Opened, needs_chromium
from tests.evidence_inputs import small_bundle
from tests.service.stored_rows import T0, accident_row

pytestmark = needs_chromium
HOSTILE = "</script><script>document.title='taken'</script><img src=http://127.0.0.1:9/x onerror=alert(1)>"
A4 = {"format": "A4", "margin": {"top": "12mm", "bottom": "12mm", "left": "12mm", "right": "12mm"}}


def dossier(*, whole: bool = True, places: bool = True) -> Dossier:
    row = accident_row("default", 1, 0, lat_deg=40.4, lon_deg=-3.7)
    accident = AccidentRow(**row, vehicle_id="car-1", trip_id=None, street=HOSTILE)
    if not whole:
        accident = replace(accident, status="false", verdict="false")
    bundle = small_bundle(accident.id, "car-1", T0, hole_s=None if whole else (-25.0, -18.5))
    evidence = EvidenceRow("complete", T0, T0, None, bundle.sha256, None)
    review = ReviewRow("r", "default", 1, accident.id, "confirmed", HOSTILE, "k-1", "suspected", "confirmed", T0)
    return Dossier(accident, bundle, evidence, [review] if whole else [], places)


@pytest.fixture(scope="module")
def addresses(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dossiers")
    pages = {"whole": dossier(), "holes": dossier(whole=False), "no-places": dossier(places=False)}
    for name, page in pages.items():
        (folder / f"{name}.html").write_text(page.html(), encoding="utf-8")
    return {name: (folder / f"{name}.html").as_uri() for name in pages}


@pytest.mark.parametrize(
    ("name", "plots", "width", "scheme"),
    [
        ("whole", 3, 1280, "light"),
        ("whole", 3, 360, "dark"),
        ("holes", 3, 1280, "dark"),
        ("no-places", 2, 1280, "light"),
    ],
)
def test_all_is_drawn_with_no_message_and_no_request(browser, addresses, name, plots, width, scheme):
    opened = Opened(browser, addresses[name], viewport={"width": width, "height": 900}, color_scheme=scheme)
    page = opened.page
    assert opened.draw_all() == plots
    assert opened.said == []
    assert opened.asked == [addresses[name]]
    assert page.evaluate("document.documentElement.scrollWidth") <= width  # nothing sticks out sideways
    assert page.title().startswith("Accident of car-1, 2027-01-15 08:00:00")
    assert page.locator("img").count() == 0
    text = page.locator("main").inner_text()
    assert ("The recording is not whole" in text) is (name == "holes")
    assert ("needs the scope positions:read" in text) is (name == "no-places")
    assert ("This was no accident" in text) is (name == "holes")
    page.close()


def test_the_curves_show_the_crash(browser, addresses):
    opened = Opened(browser, addresses["whole"], viewport={"width": 1280, "height": 900})
    opened.draw_all()
    curve = "plot => plot._fullData.filter(t => t.name === 'forward').map(t => Math.min(...t.y))"
    lowest_g, lowest_kmh = opened.page.locator("#p1-0").evaluate(curve)
    assert lowest_g == pytest.approx(-150.0 / 9.80665, rel=1e-4)
    # 150 m/s2 for 0.1 s at 50 Hz, the edges of the pulse half a sample wide: between 0.1 and 0.12 s of it.
    assert -3.6 * 150.0 * 0.121 < lowest_kmh < -3.6 * 150.0 * 0.099
    opened.page.close()


@pytest.mark.parametrize("name", ["whole", "holes", "no-places"])
def test_it_prints_on_two_pages(browser, addresses, name):
    opened = Opened(browser, addresses[name], viewport={"width": 1280, "height": 900})
    opened.draw_all()
    pdf = opened.page.pdf(print_background=True, **A4)
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 2
    opened.page.close()

"""The report in a real browser: drawn without a console message or a request, toggled, zoomed, and printed."""

from __future__ import annotations

import re

import pytest

from tests.browsing import Opened, needs_chromium
from tests.report_inputs import report

pytestmark = needs_chromium
HOSTILE = "</script><script>document.title='taken'</script><img src=http://127.0.0.1:9/x onerror=alert(1)>"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(report(name=HOSTILE).html(), encoding="utf-8")
    return path.as_uri()


@pytest.fixture
def opened(browser, address):
    opened = Opened(browser, address, viewport={"width": 1280, "height": 900})
    yield opened
    opened.page.close()


def range_of(plot, axis="xaxis"):
    return plot.evaluate(f"plot => plot._fullLayout.{axis}.range.map(Number)")


@pytest.mark.parametrize(("width", "scheme"), [(1280, "dark"), (360, "light")])
def test_all_plots_are_drawn_with_no_message_and_no_request(browser, address, width, scheme):
    opened = Opened(browser, address, viewport={"width": width, "height": 800}, color_scheme=scheme)
    page = opened.page
    count = opened.draw_all()
    assert count > 8
    assert page.locator(".plot .trace.scatter").count() >= 2 * count
    assert opened.said == []
    assert opened.asked == [address]
    assert page.evaluate("document.documentElement.scrollWidth") <= width  # nothing sticks out sideways
    ink = page.evaluate("getComputedStyle(document.querySelector('.plot .xtitle')).fill")
    assert ink == ("rgb(232, 232, 232)" if scheme == "dark" else "rgb(27, 27, 27)")
    page.close()


def test_a_hostile_name_is_shown_and_not_run(opened):
    opened.draw_all()
    assert opened.page.title() == f"Navigation report: {HOSTILE}"
    assert opened.page.locator("h1").inner_text() == f"Navigation report: {HOSTILE}"
    assert opened.page.locator("img").count() == 0
    assert opened.said == []


def test_plots_are_drawn_when_they_come_into_sight(opened):
    page = opened.page
    last = page.locator(".plot").last
    assert last.get_attribute("data-drawn") is None
    last.scroll_into_view_if_needed()
    last.locator(".main-svg").first.wait_for()
    assert last.get_attribute("data-drawn") == "yes"


def test_the_legend_switches_what_it_names(opened):
    page = opened.page
    plot = page.locator("#p1-0")
    plot.scroll_into_view_if_needed()
    plot.locator(".legend").wait_for()
    before = plot.locator(".trace.scatter").count()
    plot.locator(".legend .traces", has_text="coasting").locator(".legendtoggle").click()
    page.wait_for_function(
        "n => document.querySelectorAll('#p1-0 .trace.scatter').length === n", arg=before - 1
    )  # after the time in which a second click would have made it a double click
    shown = plot.evaluate("plot => plot._fullData.filter(trace => trace.visible === 'legendonly').map(t => t.name)")
    assert shown == ["coasting"]


def test_one_zoom_moves_all_times_and_the_keyboard_can_do_it(opened):
    page = opened.page
    opened.draw_all()
    errors, motion = page.locator("#p2-0"), page.locator("#p4-0")
    assert range_of(errors) == range_of(motion) == [0.0, pytest.approx(119.98)]
    errors.focus()
    page.keyboard.press("+")
    page.wait_for_function("() => document.querySelector('#p4-0')._fullLayout.xaxis.range[0] > 5")
    assert range_of(errors) == range_of(motion) == pytest.approx([12.0, 108.0], abs=0.1)
    page.keyboard.press("ArrowRight")
    page.wait_for_function("() => document.querySelector('#p4-0')._fullLayout.xaxis.range[1] > 110")
    page.keyboard.press("0")
    page.wait_for_function("() => document.querySelector('#p4-0')._fullLayout.xaxis.range[0] < 5")
    chart = page.locator("#p1-0")
    north = range_of(chart, "yaxis")
    chart.focus()
    page.keyboard.press("ArrowUp")
    assert range_of(chart, "yaxis")[0] > north[0]
    assert opened.said == []


def test_the_map_has_one_scale(opened):
    opened.page.locator("#p1-0 .main-svg").first.wait_for()
    metres_a_pixel = opened.page.evaluate(
        "['xaxis', 'yaxis'].map(a => document.querySelector('#p1-0')._fullLayout[a])"
        ".map(a => (a.range[1] - a.range[0]) / a._length)"
    )
    assert metres_a_pixel[0] == pytest.approx(metres_a_pixel[1], rel=1e-3)


def test_pointing_at_the_track_tells_time_and_place(opened):
    plot = opened.page.locator("#p1-0")
    plot.scroll_into_view_if_needed()
    plot.locator(".main-svg").first.wait_for()
    x, y = plot.evaluate(
        "plot => { const l = plot._fullLayout, t = plot._fullData.find(t => t.name === 'aided'), i = 500;"
        " const box = plot.getBoundingClientRect();"
        " return [box.left + l.xaxis._offset + l.xaxis.d2p(t.x[i]), box.top + l.yaxis._offset + l.yaxis.d2p(t.y[i])]; }"
    )
    opened.page.mouse.move(x, y)
    opened.page.mouse.move(x + 1, y)
    plot.locator(".hoverlayer .hovertext").first.wait_for()
    assert re.search(r"40\.\d{7}°, -3\.\d{7}°", plot.locator(".hoverlayer").text_content())


def test_printed_it_holds_every_plot(opened):
    document = opened.page.pdf()
    assert document.startswith(b"%PDF")
    assert opened.page.locator(".plot[data-drawn]").count() == opened.page.locator(".plot").count()
    assert opened.said == []

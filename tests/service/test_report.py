"""The report's page without a browser: numbers in words, thinning that hides nothing, nothing of a drive as markup."""

from __future__ import annotations

import base64
import html.parser
import json
import re
from dataclasses import replace

import numpy as np
import pymap3d
import pytest

from core.measurements import GNSS
from core.navigation.solution import SLOW_COLUMNS
from core.navigation.track import Track
from service.recordings.fusing import figures
from service.reports.map_plot import LocalMap
from service.reports.plots import band, line
from service.reports.state_plots import GROUPS
from service.reports.texts import percent
from service.reports.thinning import extremes
from tests.report_inputs import report


class Text(html.parser.HTMLParser):
    """The visible text, the tags, and each plot's specification."""

    def __init__(self, document: str) -> None:
        super().__init__()
        self.tags, self.text, self.plots, self.scripts = [], [], {}, 0
        self._inside = ""
        self.feed(document)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append((tag, found))
        self._inside = tag
        if tag == "script":
            self.scripts += 1
            self._inside = found.get("id", "code")

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside.endswith("-spec"):
            self.plots[self._inside.removesuffix("-spec")] = json.loads(data)
        elif self._inside not in ("code", "style"):
            self.text.append(data)

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module")
def page():
    return Text(report().html())


def numbers(packed):
    values = np.frombuffer(base64.b64decode(packed["bdata"]), dtype=f"<{packed['dtype']}")
    return values.reshape([int(n) for n in packed["shape"].split(",")]) if "shape" in packed else values


def test_figures_are_told_in_words_too(page):
    assert "Tunnel & <crash>" in page.words
    # The track's north error is 1 sd at most, so all of it is inside 3 sd.
    assert re.search(r"north error [\d.]+ m RMS, 100.0 % inside", page.words)
    assert "pitch 2.000° ± 0.250" in page.words
    assert "Not estimated in this drive: barometer bias." in page.words
    assert "the greatest test ratio 2.60" in page.words  # 36 / 13.82
    assert "severe" in page.words
    assert "Shaded: GNSS withheld." in page.words
    assert "gate_position" in page.words
    assert "chi-squared, 2 degrees of freedom, 99.9 %" in page.words


def test_every_plot_has_a_title_a_text_and_can_have_the_focus(page):
    plots = [found for tag, found in page.tags if tag == "div" and found.get("class") == "plot"]
    ids = {found["id"] for _, found in page.tags if "id" in found}
    assert len(plots) == len(page.plots) > 8
    for plot in plots:
        assert plot["tabindex"] == "0"
        assert {plot["aria-labelledby"], plot["aria-describedby"]} <= ids


def test_the_map_has_each_kind_of_place(page):
    traces = {trace["name"]: trace for trace in page.plots["p1-0"]["data"]}
    assert set(traces) == {
        "reference", "GNSS fix", "fix refused", "fix withheld", "aided", "coasting", "3 sd", "start", "end", "accident",
    }  # fmt: skip
    assert len(numbers(traces["fix withheld"]["x"])) == 20
    assert len(numbers(traces["fix refused"]["x"])) == 1
    assert numbers(traces["fix refused"]["customdata"]).item() == 80.0
    lap = numbers(traces["reference"]["x"])
    assert np.ptp(lap) == pytest.approx(600.0, rel=0.01)  # the circle's diameter; the sphere of the inputs is 0.3 % off
    outlines = np.split(numbers(traces["3 sd"]["x"]), np.flatnonzero(np.isnan(numbers(traces["3 sd"]["x"]))))
    assert np.nanmin([np.ptp(one[np.isfinite(one)]) for one in outlines[:-1]]) == pytest.approx(6.0, rel=0.02)


def test_the_errors_drawn_are_those_of_the_track(page):
    plot = page.plots["p2-0"]
    north = next(trace for trace in plot["data"] if trace["name"] == "error" and trace["yaxis"] == "y")
    t_s, error = numbers(north["x"]), numbers(north["y"])
    assert np.nanmax(np.abs(error)) == pytest.approx(6.0, abs=0.15)  # 1 sd after 20 s of outage
    assert 59.0 < t_s[np.nanargmax(np.abs(error))] < 60.0
    assert plot["layout"]["shapes"][0]["x0"] == 40.0
    assert plot["layout"]["shapes"][0]["x1"] == 60.0
    assert plot["layout"]["xaxis"]["range"] == [0.0, pytest.approx(119.98)]


def test_what_a_drive_is_called_is_text_and_nothing_else():
    name = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\u2028\"'><b>"
    page, usual = Text(report(name=name).html()), Text(report().html())
    assert "<script>alert(1)" in page.words
    assert page.scripts == usual.scripts
    assert [tag for tag, _ in page.tags] == [tag for tag, _ in usual.tags]
    assert not [found for _, found in page.tags if any(key.startswith("on") for key in found)]


def test_the_page_fetches_nothing_and_runs_only_its_own_scripts(page):
    (policy,) = [found["content"] for _, found in page.tags if found.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-inline" not in policy.split("script-src")[1].split(";")[0]
    sources = [found.get("src") or found.get("href") or "" for tag, found in page.tags if tag != "a"]
    assert set(sources) <= {"", "data:,"}


def test_without_a_reference_the_fixes_are_what_it_is_held_against():
    page = Text(report(reference=False).html())
    assert "There is no reference, so the track is held against the GNSS fixes" in page.words
    assert "heading error," not in page.words.replace("heading error, RMS –", "")


def test_a_drive_that_never_aligned_has_a_page():
    usual = report()
    track = Track(usual.fused.track.t_ns[:2], usual.fused.track.values[:2])
    fused = replace(usual.fused, track=track, accidents=())
    found = figures(usual.drive, fused, usual.outages)
    m = usual.drive.measurements
    blind = replace(usual.drive, measurements=replace(m, gnss_t_ns=m.gnss_t_ns[:0], gnss=m.gnss[:0]))
    for drive in (usual.drive, blind):
        page = Text(replace(usual, drive=drive, fused=fused, figures=found, solution=None, records=None).html())
        assert "The filter never aligned" in page.words
        assert "None found." in page.words


def test_an_hour_stays_a_page_that_can_be_sent():
    document = report(seconds=3600, rate_hz=100).html()
    assert len(document) < 12e6
    page = Text(document)
    points = [
        len(numbers(trace["y"])) for plot in page.plots.values() for trace in plot["data"] if "bdata" in trace["y"]
    ]
    assert max(points) < 45_000  # the filled bands and the map; what a browser draws without stutter


def test_thinning_keeps_what_stands_out():
    values = np.sin(np.arange(100_000) / 500.0)
    values[[77_777, 31_234]] = 40.0, -30.0
    values[50_000:50_002] = np.nan
    kept = extremes(values, 3000)
    assert kept.size <= 3100
    assert {77_777, 31_234, 50_000, 0, 99_999} <= set(kept.tolist())
    assert np.all(np.diff(kept) > 0)
    assert extremes(np.full(10_000, np.nan), 300).size > 0


def test_lines_and_bands_break_where_nothing_is_known():
    t_s = np.concatenate([np.arange(10.0), np.arange(30.0, 40.0)])
    assert np.isnan(numbers(line(t_s, t_s, "x", "#000", gap_s=5.0)["y"])).sum() == 1
    (filled,) = band(t_s, -t_s, t_s, "x", gap_s=5.0)
    assert np.isnan(numbers(filled["y"])).sum() == 2  # after each of the two stretches
    (nothing,) = band(np.arange(3.0), np.full(3, np.nan), np.full(3, np.nan), "x")
    assert numbers(nothing["y"]).size == 0


def test_the_map_is_true_to_scale_over_a_county():
    lat, lon = np.radians([59.35, 59.9, 59.0]), np.radians([18.07, 18.9, 17.1])
    east, north = LocalMap(lat[0], lon[0], 40.0).east_north_m(lat, lon)
    other_e, other_n, _ = pymap3d.geodetic2enu(lat, lon, 40.0, lat[0], lon[0], 40.0, deg=False)
    assert east == pytest.approx(other_e, abs=1e-6)
    assert north == pytest.approx(other_n, abs=1e-6)


def test_every_slow_state_is_drawn():
    assert sorted(column for group in GROUPS for column, _ in group.states) == sorted(SLOW_COLUMNS)


def test_a_share_is_not_rounded_up_to_all():
    assert [percent(share) for share in (1.0, 0.99999, 0.5, float("nan"))] == ["100.0 %", "99.9 %", "50.0 %", "–"]


def test_a_fix_without_height_has_no_down_error():
    usual = report(reference=False)
    gnss = usual.drive.measurements.gnss.copy()
    gnss[:, GNSS["alt_m"]] = np.nan
    drive = replace(usual.drive, measurements=replace(usual.drive.measurements, gnss=gnss))
    assert "down error – RMS" in Text(replace(usual, drive=drive).html()).words

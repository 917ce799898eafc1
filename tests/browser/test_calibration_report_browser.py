"""The reports on calibration and noise in a real browser: every plot drawn, also those in three dimensions."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.recording import CalibrationRecording
from core.sensors import TriadCalibration
from core.simulation.calibration_recording import Iron, simulate_recording
from service.calibrating import CalibrationOptions, calibrate
from service.noise import measure_noise
from service.recordings.calibration_recording import ReadRecording
from service.reports.calibration import calibration_report
from service.reports.noise import noise_report
from tests.browsing import Opened, needs_chromium

pytestmark = needs_chromium
HOSTILE = "</script><script>document.title='taken'</script><img src=http://127.0.0.1:9/x onerror=alert(1)>.csv"
OF_THE_DRIVER = ("GPU stall", "willReadFrequently")
"""What Chromium itself says of drawing in three dimensions without a graphics card."""


@pytest.fixture(scope="module")
def addresses(tmp_path_factory):
    """Pages of a box with too few positions, and of one that lay still."""
    rng, folder = np.random.default_rng(1), tmp_path_factory.mktemp("reports")
    box = simulate_recording(
        rng,
        accelerometer=TriadCalibration((1.02, 0.98, 1.01)),
        gyroscope=TriadCalibration(bias=(0.02, -0.01, 0.015)),
        positions=12,
        hold_s=3.0,
        initial_rest_s=5.0,
        rate_hz=100.0,
        magnetometer=Iron(hard_iron_ut=(30.0, -20.0, 12.0)),
    )
    calibrated = calibrate(
        ReadRecording(HOSTILE, box.recording, counts=False, rate_hz=100.0), CalibrationOptions(gravity_mps2=9.80665)
    )
    rows = 6000
    still = CalibrationRecording(
        np.arange(rows) / 50.0, rng.normal([0.0, 0.0, -9.8], 0.01, (rows, 3)), rng.normal(0.0, 1e-3, (rows, 3))
    )
    pages = {
        "calibration": calibration_report(calibrated),
        "noise": noise_report(measure_noise(ReadRecording(HOSTILE, still, counts=False, rate_hz=50.0))),
    }
    for name, text in pages.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return {name: (folder / f"{name}.html").as_uri() for name in pages}


@pytest.mark.parametrize(
    ("name", "width", "scheme"),
    [("calibration", 1280, "dark"), ("calibration", 360, "light"), ("noise", 1280, "light")],
)
def test_all_plots_are_drawn_with_no_request(browser, addresses, name, width, scheme):
    opened = Opened(browser, addresses[name], viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert opened.draw_all() == 8
    assert opened.asked == [addresses[name]]
    assert said_by_the_page(opened) == []
    assert opened.page.title() == f"{name.capitalize()} report: {HOSTILE}"
    assert opened.page.locator("img").count() == 0
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= width  # nothing sticks out sideways
    opened.page.close()


def test_a_sphere_shows_the_positions_and_leaves_the_keyboard_alone(browser, addresses):
    opened = Opened(browser, addresses["calibration"], viewport={"width": 1280, "height": 900})
    sphere = opened.page.locator("#p1-1")
    sphere.scroll_into_view_if_needed()
    sphere.locator(".gl-container canvas").first.wait_for()
    assert sphere.evaluate("plot => plot._fullData.find(t => t.name === 'position').x.length") == 12
    sphere.focus()
    opened.page.keyboard.press("+")
    opened.page.keyboard.press("ArrowLeft")
    assert said_by_the_page(opened) == []
    opened.page.close()


def test_the_allan_curve_falls_over_decades(browser, addresses):
    opened = Opened(browser, addresses["noise"], viewport={"width": 1280, "height": 900})
    first = opened.page.locator(".plot").first
    first.scroll_into_view_if_needed()
    first.locator(".main-svg").first.wait_for()
    assert first.evaluate("plot => [plot._fullLayout.xaxis.type, plot._fullLayout.yaxis.type]") == ["log", "log"]
    y = first.evaluate("plot => [...plot._fullData.find(t => t.name === 'x').y]")
    # White noise over 1024 samples: a factor of 32, to the few degrees of freedom at the end.
    assert 20.0 < y[0] / y[-1] < 50.0
    opened.page.close()


def said_by_the_page(opened):
    return [said for said in opened.said if not any(own in said for own in OF_THE_DRIVER)]

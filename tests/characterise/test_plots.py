"""The figures of a result: panels, drawn data against the numbers of the result, marks, and sensors without results."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.characterise import characterise_log
from imuarray.characterise.plots import COLOURS, FIGURES
from imuarray.characterise.plots.codes import bars, marks
from imuarray.characterise.plots.curves import bands, interval, line_label
from imuarray.errors import MissingExtraError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from tests.selection import some

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure
from matplotlib.text import Text

RATE_HZ, ROWS, PER_COUNT = 100.0, 20_000, 1 / 5460
LEVEL = 1e-3


def _sensors() -> dict[str, np.ndarray]:
    """Counts of accelerometers, each with the property in its name, otherwise white with sigma 10."""
    rng = np.random.default_rng(20250607)

    def white(rows: int = ROWS) -> np.ndarray:
        return np.rint(rng.normal(0.0, 10.0, (rows, 3))).astype(np.int32)

    hum = white() + np.rint(8 * np.sin(2 * np.pi * 11.0 * np.arange(ROWS) / RATE_HZ)).astype(np.int32)[:, None] * [
        1,
        0,
        0,
    ]
    clipped = np.clip(white(), [-15, -99, -99], [99, 12, 99])
    steps = white() * [2, 4, 2] + [0, 1, 1]
    missing = white()
    missing[missing[:, 0] == 3, 0] = 4
    missing[:, 1] = np.where(rng.random(ROWS) < 0.6, missing[:, 1] & ~1, missing[:, 1] | 1)
    missing[7, 2] = 600
    constant, ramp = np.full((ROWS, 3), 7), np.arange(ROWS)[:, None] * [1, 1, 1]
    outcome = {"white": white(), "hum": hum, "clipped": clipped, "steps": steps, "missing": missing}
    outcome |= {"constant": constant, "ramp": ramp, "one": white(1), "short": white(8), "empty": white(0)}
    return {name: counts.astype(np.int32) for name, counts in outcome.items()}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = tmp_path_factory.mktemp("plots") / "odd_$1_^.h5"
    sensors = _sensors()
    headers = [SensorHeader(name, "bma180", "specific_force", "g", 1.5, 5460.0) for name in sensors]
    with LogWriter(path, headers, source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        for name, counts in sensors.items():
            time = np.arange(len(counts), dtype=np.int64) * int(1e9 / RATE_HZ)
            writer.append(name, Block(time, counts, np.zeros(len(counts), np.uint16)))
    with open_log(path) as log:
        return characterise_log(log)


def _of(result: dict[str, Any], *names: str) -> dict[str, Any]:
    return result | {"sensors": [sensor for sensor in result["sensors"] if sensor["name"] in names]}


def _axes(result: dict[str, Any], name: str) -> list[dict[str, Any]]:
    return _of(result, name)["sensors"][0]["axes"]


@pytest.mark.slow
@pytest.mark.parametrize("name", some(FIGURES, 1))
@pytest.mark.parametrize(
    "sensors", some([(("empty",),), (("one",),), (("short",),), (("constant",),), (("ramp",),), None], 1)
)
def test_figures_of_incomplete_sensors_are_drawn(
    result: dict[str, Any], name: str, sensors: tuple[str, ...] | None
) -> None:
    """Warnings of matplotlib's layout and of NumPy's logarithms are errors."""
    figure = FIGURES[name](_of(result, *sensors) if sensors else result)
    figure.canvas.draw()
    assert r"odd_\$1_^.h5" in figure.get_suptitle()
    if sensors == ("empty",):
        assert figure.get_axes() == []
        assert figure.texts[-1].get_text().startswith("no sensor has")


@pytest.mark.parametrize("name", some(FIGURES, 1))
def test_a_figure_without_matplotlib_is_refused(
    result: dict[str, Any], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"imuarray\[report\]"):
        FIGURES[name](result)


def test_drawn_allan_curve_and_fit_are_those_of_the_result(result: dict[str, Any]) -> None:
    panel = FIGURES["allan.png"](_of(result, "white")).get_axes()[0]
    curves = [line for line in panel.get_lines() if line.get_marker() == "o"]
    fits = [line for line in panel.get_lines() if line.get_gid() == "fit"]
    for axis, curve, fit in zip(_axes(result, "white"), curves, fits, strict=True):
        np.testing.assert_allclose(curve.get_xdata(), axis["allan"]["tau_s"])
        np.testing.assert_allclose(curve.get_ydata(), np.array(axis["allan"]["deviation"]) * PER_COUNT)
        np.testing.assert_allclose(fit.get_ydata(), np.array(axis["fit"]["deviation"]) * PER_COUNT)
    note = panel.get_legend().get_texts()[0].get_text()
    # sigma 10 at 100 Hz is 1 count/sqrt(Hz), 1.8e-4 g/sqrt(Hz)
    assert note == "white ±1.5 g\nN 0.00018 g/√Hz"


def test_a_bad_fit_is_noted_and_not_drawn(result: dict[str, Any]) -> None:
    panel = FIGURES["allan.png"](_of(result, "hum")).get_axes()[0]
    assert sum(line.get_gid() == "fit" for line in panel.get_lines()) == 2
    assert panel.get_legend().get_texts()[0].get_text().endswith("not fitted: x")


def test_each_axis_is_drawn_with_its_own_scale(result: dict[str, Any]) -> None:
    """A calibration may have a scale for each axis."""
    sensor = _of(result, "white")["sensors"][0]
    axes = [axis | {"unit_per_count": scale} for axis, scale in zip(sensor["axes"], (1.0, -2.0, 3.0), strict=True)]
    for name in ("allan.png", "spectrum.png"):
        lines = FIGURES[name](result | {"sensors": [sensor | {"axes": axes}]}).get_axes()[0].get_lines()
        levels = [
            np.asarray(line.get_ydata())[0] for line in lines if line.get_color() == COLOURS[0] and not line.get_gid()
        ]
        plain = FIGURES[name](_of(result, "white")).get_axes()[0].get_lines()
        before = [
            np.asarray(line.get_ydata())[0] for line in plain if line.get_color() == COLOURS[0] and not line.get_gid()
        ]
        np.testing.assert_allclose(np.array(levels) / before, np.array([1.0, 2.0, 3.0]) / PER_COUNT)


def test_drawn_density_of_white_noise_and_a_line(result: dict[str, Any]) -> None:
    """White noise of variance 100 + 1/12 at 100 Hz has sqrt(2 * 100.083 / 100) = 1.4148 counts/sqrt(Hz), one-sided.

    1 % allows for 5 standard errors of the mean of the curve's upper bands; a sine of amplitude 8 adds no more than its
    marker, at sqrt(density) of its bin: A^2 / 2 over 1.5 bins (Hann) and the noise, which gives it an error of 1.7 %.
    """
    panel = FIGURES["spectrum.png"](_of(result, "hum")).get_axes()[0]
    curves = [line for line in panel.get_lines() if not line.get_gid()]
    assert panel.get_ylabel() == "density (g/√Hz)"
    for curve in curves:
        upper = np.asarray(curve.get_ydata())[np.asarray(curve.get_xdata()) > 2.0]
        assert np.sqrt(np.mean(upper**2)) / PER_COUNT == pytest.approx(1.4148, rel=0.01)
    markers = [line for line in panel.get_lines() if line.get_gid() == "lines"]
    (x,), (y,) = markers[0].get_data()
    resolution_hz = RATE_HZ / 2048
    assert x == pytest.approx(11.0, abs=resolution_hz / 2)
    offset = (11.0 - x) / resolution_hz
    lobe = (np.sinc(offset) / (1 - offset**2)) ** 2
    assert y / PER_COUNT == pytest.approx(np.sqrt(32 / 1.5 / resolution_hz * lobe + 2.0), rel=0.06)
    assert [text.get_text() for text in panel.texts] == ["x: 11 Hz"]


def test_bands_are_means_of_a_sixth_of_an_octave() -> None:
    frequency_hz = np.arange(65.0)
    outcome = bands(frequency_hz, frequency_hz**2, (frequency_hz >= 2) & (frequency_hz != 40) & (frequency_hz < 64))
    assert outcome.bins.sum() == 61
    assert np.all(outcome.bins[:6] == 1)
    # the last sixth of the octave below 64 begins at 64 * 2^(-1/6) = 57.02
    last = np.arange(58.0, 64.0)
    assert (outcome.frequency_hz[-1], outcome.density[-1]) == (last.mean(), pytest.approx((last**2).mean()))


def test_band_intervals_cover_the_truth() -> None:
    """95 % of the intervals of white noise cover its density: of 300 spectra of 33 bands, 94 to 96 %. The share has a
    standard error below 0.4 % even if bands of a spectrum covered or failed in groups of three.
    """
    rng = np.random.default_rng(77)
    window = np.sin(np.pi * np.arange(256) / 256) ** 2
    taken = np.ones(129, bool)
    taken[[0, 1, -1]] = False
    held = []
    for _ in range(300):
        segments = rng.normal(size=(20, 256)) * window
        density = (np.abs(np.fft.rfft(segments)) ** 2).mean(axis=0) / (window @ window)
        low, high = interval(bands(np.arange(129.0), density, taken), 40.0)
        held.append((low <= 1) & (high >= 1))
    assert np.mean(held) == pytest.approx(0.95, abs=0.012)


@pytest.mark.parametrize(
    ("apparent_hz", "aliases_hz", "label"),
    [
        (2.0, [2.0, 46.0, 50.02, 94.0], "2 Hz (50 Hz mains?)"),
        (49.95, [49.95, 300.05], "49.95 Hz (mains?)"),
        (12.34, [12.34, 112.34], "12.34 Hz"),
    ],
)
def test_mains_lines_are_labelled(apparent_hz: float, aliases_hz: list[float], label: str) -> None:
    assert line_label({"frequency_hz": apparent_hz, "aliases_hz": aliases_hz}) == label


def test_only_correlated_axes_are_coloured(result: dict[str, Any]) -> None:
    """Chance of a coloured axis among the five that are white: below 1 %, and the seed is fixed."""
    panel = FIGURES["autocorrelation.png"](_of(result, "white", "hum")).get_axes()[0]
    coloured = [line for line in panel.get_lines() if line.get_color() in COLOURS]
    grey = [line for line in panel.get_lines() if line.get_color() == "0.7"]
    assert (len(coloured), len(grey)) == (1, 5)
    expected = _axes(result, "hum")[0]["autocorrelation"]["correlation"]
    np.testing.assert_allclose(coloured[0].get_ydata(), expected[1:])
    texts = [text.get_text() for text in panel.get_legend().get_texts()]
    # +-1.96 / sqrt(20000)
    assert texts == ["hum ±1.5 g", "axis x", "axis y", "axis z", "like white noise", "±0.014: 95 % of white noise"]


def test_a_sensor_has_the_same_colour_in_every_figure(result: dict[str, Any]) -> None:
    sensors = _of(result, "constant", "hum")
    for name in ("allan.png", "spectrum.png", "autocorrelation.png"):
        handles = FIGURES[name](sensors).get_axes()[0].get_legend().get_lines()
        assert handles[0].get_color() == COLOURS[[s["name"] for s in sensors["sensors"]].index("hum")]


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        ("white", [[], [], []]),
        ("steps", [["even codes only"], ["codes in steps of 4"], ["odd codes only"]]),
        ("constant", [["one code only"]] * 3),
        ("short", [[], [], []]),
        ("one", [[], [], []]),
    ],
)
def test_marks_of_codes(result: dict[str, Any], sensor: str, expected: list[list[str]]) -> None:
    assert [marks(axis, LEVEL) for axis in _axes(result, sensor)] == expected


def test_marks_state_the_share_of_clipped_readings(result: dict[str, Any]) -> None:
    """Of a Gaussian with sigma 10, rounded, Phi(-1.45) = 7.4 % are at or below -15, 12.5 % at or above 12."""
    (low,), (high,), none = (marks(axis, LEVEL) for axis in _axes(result, "clipped"))
    assert low.endswith(" % at the low end")
    assert float(low.split()[0]) == pytest.approx(7.4, abs=0.6)
    assert float(high.split()[0]) == pytest.approx(12.5, abs=1.0)
    assert none == []
    missing, uneven, far = (marks(axis, LEVEL) for axis in _axes(result, "missing"))
    assert missing == ["1 code missing"]
    assert float(uneven[0].removesuffix("% even codes")) == pytest.approx(60.0, abs=2.0)
    assert far == ["outlier at 600"]


def test_histogram_has_panels_bars_and_a_gaussian(result: dict[str, Any]) -> None:
    panels = FIGURES["histogram.png"](_of(result, "missing", "steps", "white")).get_axes()
    assert [panel.get_title(loc="left") for panel in panels[3:5]] == ["steps ±1.5 g, x", "steps ±1.5 g, y"]
    for panel, axis in zip(panels[6:], _axes(result, "white"), strict=True):
        seen, (heights, edges, _) = axis["histogram"], panel.patches[0].get_data()
        np.testing.assert_allclose(heights[heights > 0], np.array(seen["counts"]) / ROWS)
        assert (edges[:-1] + 0.5)[heights > 0].tolist() == seen["codes"]
    for panel, sigma, step in ((panels[6], 10.0, 1), (panels[3], 20.0, 2), (panels[4], 40.0, 4)):
        top = np.max(panel.get_lines()[0].get_ydata())
        assert top == pytest.approx(step / (sigma * np.sqrt(2 * np.pi)), rel=0.03)
    (mark,) = [line for line in panels[0].get_lines() if line.get_gid() == "marks"]
    assert mark.get_xdata() == [3.0]


def test_wide_histograms_keep_their_area() -> None:
    codes = list(range(-300, 301, 2))
    heights, edges = bars({"codes": codes, "counts": [5] * len(codes)}, 2)
    # 301 codes in bars of 3, 6 wide: the share of one code is 1/301, and the last bar has only one
    np.testing.assert_allclose(edges, -300.5 + 6 * np.arange(102))
    np.testing.assert_allclose(heights, [1 / 301] * 100 + [1 / 903])


def test_histogram_of_even_codes_has_gaps() -> None:
    heights, edges = bars({"codes": [-2, 0, 4], "counts": [1, 2, 1]}, 2)
    assert edges.tolist() == [-2.5, -1.5, -0.5, 0.5, 3.5, 4.5]
    assert heights.tolist() == [0.25, 0.0, 0.5, 0.0, 0.25]


@pytest.mark.slow
def test_sensors_with_findings_have_panels_first(result: dict[str, Any]) -> None:
    """Sensors with findings are first, in the order of the log."""
    white, steps = (_of(result, name)["sensors"][0] for name in ("white", "steps"))
    many = [white | {"name": f"W{number}"} for number in range(14)] + [steps]
    figure = FIGURES["histogram.png"](result | {"sensors": many})
    titles = [panel.get_title(loc="left").split()[0] for panel in figure.get_axes()[::3]]
    assert titles == [f"W{number}" for number in range(11)] + ["steps"]
    assert "12 of 15 sensors" in figure.get_suptitle()


@pytest.mark.slow
def test_many_sensors_on_a_panel_have_thin_lines_without_bands(result: dict[str, Any]) -> None:
    white = _of(result, "white")["sensors"][0]
    many = result | {"sensors": [white | {"name": f"W{number}"} for number in range(32)]}
    for name in ("allan.png", "spectrum.png"):
        figure = FIGURES[name](many)
        figure.canvas.draw()
        assert not figure.get_axes()[0].collections
        colours = [line.get_color() for line in figure.get_axes()[0].get_lines()]
        assert len({tuple(colour) for colour in colours if not isinstance(colour, str)}) == 32


def test_files_are_named_and_written(result: dict[str, Any], tmp_path: Path) -> None:
    assert list(FIGURES) == ["allan.png", "spectrum.png", "autocorrelation.png", "histogram.png"]
    FIGURES["autocorrelation.png"](_of(result, "white")).savefig(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", some(FIGURES, 1))
def test_labels_are_inside_the_figure_and_panels_do_not_overlap(result: dict[str, Any], name: str) -> None:
    figure = FIGURES[name](result)
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    panels = [panel.get_tightbbox() for panel in figure.get_axes() if panel.axison]
    texts = [text.get_window_extent() for text in figure.findobj(Text) if text.get_text() in _figure_texts(figure)]
    for box in [*panels, *texts]:
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
    for place, box in enumerate(panels):
        for other in [*panels[place + 1 :], *texts]:
            assert not (box.x0 < other.x1 and other.x0 < box.x1 and box.y0 < other.y1 and other.y0 < box.y1)


def _figure_texts(figure: Figure) -> tuple[str, str]:
    return figure.get_suptitle(), figure.get_supxlabel()

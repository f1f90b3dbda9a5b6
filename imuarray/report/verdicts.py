"""The verdict that opens a page: one sentence on the quality of a recording, a calibration or a fused result and on
what to do, with a few figures.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.fuse import FusedHead, Score, TechniqueComparison
from imuarray.log import Log
from imuarray.log.health import Observations, health_of, is_trouble
from imuarray.log.missed_frames import frame_timing, is_fault_of_bus
from imuarray.log.row_timing import row_timing
from imuarray.printable import counted, duration
from imuarray.report.page import Level, Verdict
from imuarray.report.recording import silent_s
from imuarray.units import INERTIAL, READABLE, READABLE_SI

_LEVELS: dict[str, Level] = {"green": "good", "amber": "doubtful", "red": "bad"}
_FIGURES = 5
_NOTICEABLE = 0.95
"""Largest ratio of errors that the verdict calls a reduction."""
_CLAIMED = 1.5
"""Ratio of scatter to claimed error above which a fused result is worse than it claims."""


def recording_verdict(log: Log, doubts: Sequence[str] = ()) -> Verdict:
    """Return whether a recording is healthy, and what to do if it is not; with `doubts` about an imported recording,
    their number and the first of them.
    """
    sensors = log.sensors
    first_ns = min((int(sensor.time[0]) for sensor in sensors.values() if len(sensor)), default=0)
    last_ns = max((int(sensor.time[-1]) for sensor in sensors.values() if len(sensor)), default=0)
    flags = {name: sensor.flagged() for name, sensor in sensors.items()}
    rows = sum(len(sensor) for sensor in sensors.values())
    faults = Counter((event.sensor, event.kind) for event in log.events if is_trouble(event))
    missed = frame_timing(log).missed or 0
    ended = log.state == "finished"
    timings = {name: row_timing(sensor) for name, sensor in sensors.items()}
    stalls = {name: timing for name, timing in timings.items() if timing.kind == "stalls"}
    observations = Observations(
        sensors=len(sensors),
        frames=max((len(sensor) for sensor in sensors.values()), default=0),
        missed=missed,
        bus_failed=any(map(is_fault_of_bus, log.events)),
        silent=_silent(log, (first_ns, last_ns)),
        gaps={name: counts.get("lost_before", 0) for name, counts in flags.items()},
        clipped={name: counts.get("saturated", 0) for name, counts in flags.items()},
        faults=faults,
        stopped="" if ended else f"the log is {log.state}",
        stalled={name: timing.gaps_s / timing.seconds for name, timing in stalls.items()},
    )
    if not rows:
        figures = ((f"{len(sensors)}", "sensors"), ("0", "readings"))
        return Verdict(f"{log.path.name} holds no reading.{_doubts_text(doubts)}", "bad", figures)
    health = health_of(observations)
    healthy = "is complete" if doubts else "is healthy"
    words = {"green": healthy, "amber": "is usable, with losses", "red": "has serious losses"}[health.level]
    advice = f"; {health.advice}" if health.advice and ended else ""
    advice = advice if ended else "; `imuarray recover` finishes it"
    gaps = sum(observations.gaps.values()) + max((timing.gaps for timing in stalls.values()), default=0)
    clipped = sum(observations.clipped.values())
    level = _LEVELS[health.level]
    return Verdict(
        f"{log.path.name} {words}: {health.reason}{advice}.{_doubts_text(doubts)}",
        "doubtful" if doubts and level == "good" else level,
        (
            (duration((last_ns - first_ns) * 1e-9, 1), "recorded"),
            (f"{rows}", f"readings of {counted(len(sensors), 'sensor')}"),
            (f"{missed}", "frames missed"),
            (f"{gaps}", "gaps in the readings"),
            (f"{clipped}", "readings at the end of the range"),
        ),
    )


def _doubts_text(doubts: Sequence[str]) -> str:
    """Return a sentence with the number of doubts and the first of them; empty without any."""
    if not doubts:
        return ""
    are, others = ("is", "") if len(doubts) == 1 else ("are", ", for example")
    return f" But there {are} {counted(len(doubts), 'doubt')} about it{others}: {doubts[0]}"


def _silent(log: Log, ends_ns: tuple[int, int]) -> dict[str, float]:
    """Return the seconds without readings at the end of the log, of the sensors that are silent there."""
    silent = {name: silent_s(sensor, ends_ns)[1] for name, sensor in log.sensors.items()}
    return {name: seconds for name, seconds in silent.items() if seconds}


def calibration_verdict(path: Path, calibration: Calibration) -> Verdict:
    """Return whether a calibration is complete: what was measured of every sensor, and with what error."""
    inertial = [sensor for sensor in calibration.sensors.values() if sensor.quantity in INERTIAL]
    biased = [sensor for sensor in inertial if sensor.bias_sem_lsb is not None]
    scaled = [sensor for sensor in inertial if sensor.response_sem_lsb_per_unit is not None]
    lacking = [sensor.name for sensor in inertial if sensor.bias_sem_lsb is None]
    forces = [sensor for sensor in inertial if sensor.quantity == "specific_force"]
    unscaled = [sensor.name for sensor in forces if sensor.response_sem_lsb_per_unit is None]
    worst = {
        quantity: _worst_bias([sensor for sensor in biased if sensor.quantity == quantity]) for quantity in INERTIAL
    }
    worst_text = " and ".join(text for text in worst.values() if text)
    level: Level = "good"
    if not biased and any(sensor.thermal is not None for sensor in inertial):
        level = "doubtful"
        sentence = "has temperature slopes of biases, but no biases; a log at rest or a tumble gives them"
    elif not biased and any(sensor.turn_on is not None for sensor in inertial):
        level = "doubtful"
        sentence = "has the changes of biases from run to run, but no biases; a log at rest or a tumble gives them"
    elif not biased:
        level, sentence = "bad", "has no measured bias: fusion with it uses the data sheets' values"
    elif lacking:
        level, sentence = (
            "doubtful",
            f"is incomplete: {_list_names(lacking)} without a measured bias; biases to {worst_text}",
        )
    elif unscaled:
        level = "doubtful"
        names = _list_names(unscaled)
        sentence = f"is incomplete: {names} without a measured scale, which a tumble gives; biases to {worst_text}"
    else:
        sentence = f"is good: biases are known to {worst_text}{_turns_wanted(scaled)}"
    thermal = sum(sensor.thermal is not None for sensor in inertial)
    noisy = sum(sensor.noise_lsb is not None for sensor in inertial)
    of_sensors = f"of {len(inertial)} sensors"
    figures = [
        *(
            (text, f"largest standard error of a bias, {name.replace('_', ' ')}")
            for name, text in worst.items()
            if text
        ),
        (f"{sum(not sensor.uncertain_axes() for sensor in scaled)}", f"{of_sensors} with measured scale and axes"),
        (f"{noisy}", f"{of_sensors} with measured noise"),
        (f"{thermal}", f"{of_sensors} with temperature slopes"),
    ]
    return Verdict(f"{path.name} {sentence}.", level, tuple(figures[:_FIGURES]))


def _turns_wanted(scaled: Sequence[SensorCalibration]) -> str:
    """Return the text on accelerometers whose angles between axes are those of the data sheet, and on gyroscopes that
    were hardly turned about some box axes; "" if there are none.
    """
    nominal = [sensor.name for sensor in scaled if sensor.quantity == "specific_force" and sensor.uncertain_axes()]
    angles = f"; the angles between the axes of {_list_names(nominal)} are the data sheet's" if nominal else ""
    uncertain = {sensor.name: sensor.uncertain_axes() for sensor in scaled if sensor.quantity == "angular_rate"}
    texts = []
    for axes in sorted({axes for axes in uncertain.values() if axes}):
        names = [name for name, uncertain_axes in uncertain.items() if uncertain_axes == axes]
        texts.append(f"{_list_names(names)} about box {', '.join(axes)}")
    if not texts:
        return angles
    return f"{angles}; add turns of {' and of '.join(texts)}, to which the response is not fully measured"


def _worst_bias(sensors: Sequence[SensorCalibration]) -> str:
    """Return the largest standard error of a bias, with its unit; "" without any."""
    errors = [
        READABLE[sensor.unit][0] * float(np.max(sensor.bias_sem_lsb / sensor.scale_lsb_per_unit))
        for sensor in sensors
        if sensor.bias_sem_lsb is not None
    ]
    return f"{max(errors):.2g} {READABLE[sensors[0].unit][1]}" if errors else ""


def _list_names(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def fused_verdict(
    path: Path, head: FusedHead, noise: dict[str, Floats], claimed: dict[str, Floats], failed: Sequence[str] = ()
) -> Verdict:
    """Return the scatter of a result at rest, and whether its claimed errors are honest. `noise` and `claimed` (3,) in
    SI by quantity; `failed` are the sensors that were excluded for part of the time.
    """
    figures, texts, ratios = [(f"{head.frames}", "frames")], [], []
    for quantity, values in noise.items():
        factor, unit = READABLE_SI[quantity]
        worst = float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")
        name = quantity.replace("_", " ")
        texts.append(f"{factor * worst:.2g} {unit}")
        figures.append((f"{factor * worst:.2g} {unit}", f"largest scatter at rest, {name}"))
        claim = claimed.get(quantity)
        if claim is not None and np.isfinite(claim).all() and (claim > 0).all():
            ratios.append(float(np.nanmax(values / claim)))
    count = sum(len(names) for names in head.sensors.values())
    if count:  # a file may lack the names
        figures.append((f"{count}", "sensors that went into it"))
    if ratios:
        figures.append((f"{max(ratios):.2g}", "scatter divided by claimed error"))
    level: Level = "doubtful" if ratios and max(ratios) > _CLAIMED else "good" if texts else "neutral"
    quiet = f"scatters by {' and '.join(texts)} at rest" if texts else "has no frames at rest"
    honest = ", more than it claims; give fuse a calibration with measured noise" if level == "doubtful" else ""
    if failed:
        level = "doubtful"
        honest += (
            f"; {len(failed)} of {counted(count, 'sensor')} were excluded for part of the time, see the faults below"
        )
    return Verdict(f"{path.name}, fused by {head.technique}, {quiet}{honest}.", level, tuple(figures[:_FIGURES]))


def techniques_verdict(log: Log, comparison: TechniqueComparison) -> Verdict | None:
    """Return the gain of fusion over the simple average of the same sensors; None if there is nothing to compare."""
    scores = [score for score in comparison.scores if score.technique != "mean"]
    if not scores:
        return None
    best = {
        quantity: min(same, key=lambda score: score.ratio["XYZ"].ratio)
        for quantity in dict.fromkeys(score.quantity for score in scores)
        if (same := [score for score in scores if score.quantity == quantity])
    }
    gains = [
        f"the error of {_words(score)} to {score.ratio['XYZ'].ratio:.2f} times that of the simple average"
        f" ({score.technique})"
        for score in best.values()
        if _is_sure(score) and score.ratio["XYZ"].ratio < _NOTICEABLE
    ]
    if gains:
        sentence = f"reduces {' and '.join(gains)}"
    elif any(map(_is_sure, best.values())):
        sentence = f"gains less than {100 * (1 - _NOTICEABLE):.0f} % over the simple average"
    else:
        sentence = "has no significant gain over the simple average"
    figures = tuple(
        (f"{score.ratio['XYZ'].ratio:.2f} ×", f"the simple average's error of {_words(score)}, with {score.technique}")
        for score in best.values()
    )
    return Verdict(f"Fusion of {log.path.name} {sentence}.", "good" if gains else "neutral", figures)


def _words(score: Score) -> str:
    return score.quantity.replace("_", " ")


def _is_sure(score: Score) -> bool:
    ratio = score.ratio["XYZ"]
    if ratio.ratio >= 0.995:  # printed as 1.00
        return False
    return bool(ratio.high < 1) if np.isfinite(ratio.high) else ratio.ratio < 1


_FEW = 2
"""Number of verdicts up to which the joint one also names the gain of fusion."""

_ORDER = ("bad", "doubtful", "neutral", "good")


def joined(verdicts: Sequence[Verdict]) -> Verdict | None:
    """Return one verdict for several: the worst, or that everything is in order, with the first figure of each verdict
    before the second ones. One verdict is returned as it is; None if there are none.
    """
    if len(verdicts) < 2:
        return verdicts[0] if verdicts else None
    ranked = sorted(verdicts, key=lambda verdict: _ORDER.index(verdict.level))
    rounds = max(len(verdict.figures) for verdict in ranked)
    first: dict[str, tuple[str, str]] = {}
    for turn in range(rounds):
        for verdict in ranked:
            if turn < len(verdict.figures):
                first.setdefault(verdict.figures[turn][1], verdict.figures[turn])
    figures = list(first.values())
    worst = ranked[0]
    if worst.level in ("bad", "doubtful"):
        return Verdict(worst.sentence, worst.level, tuple(figures[:_FIGURES]))
    gains = "Fusion of"
    remaining = [verdict for verdict in verdicts if len(verdicts) == _FEW or not verdict.sentence.startswith(gains)]
    texts = [re.sub(", fused by [^,]*,", "", verdict.sentence.split(": ")[0].rstrip(".")) for verdict in remaining]
    brief = "; ".join(text.replace(gains, "fusion of") for text in texts)
    return Verdict(f"Everything is in order: {brief}.", "good", tuple(figures[:_FIGURES]))

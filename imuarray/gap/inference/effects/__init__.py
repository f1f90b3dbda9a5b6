"""All effects that may be the cause of a gap: how each is recognised, and what to record so that it shows."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import get_args

from imuarray.gap.inference.effects.bias import guess_bias, guess_bistable_bias, guess_turn_on_bias
from imuarray.gap.inference.effects.candidate import Action, Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.channel_swap import guess_channel_swap
from imuarray.gap.inference.effects.codes import guess_quantisation, guess_saturation
from imuarray.gap.inference.effects.motion import guess_g_sensitivity, guess_nonlinearity, guess_size_effect
from imuarray.gap.inference.effects.noise import guess_bandwidth, guess_tone, guess_white_noise
from imuarray.gap.inference.effects.range_reset import guess_range_reset
from imuarray.gap.inference.effects.readings import guess_glitches, guess_stuck
from imuarray.gap.inference.effects.response import guess_axis_error, guess_misalignment, guess_scale
from imuarray.gap.inference.effects.temperature import guess_thermal_bias, guess_thermal_lag, guess_thermal_scale
from imuarray.gap.inference.effects.timing import (
    guess_adaptive_range,
    guess_clock_error,
    guess_dropped_samples,
    guess_jitter,
    guess_odr_error,
    guess_skew,
    guess_stale_samples,
)
from imuarray.gap.inference.effects.wander import (
    guess_bias_instability,
    guess_common_mode,
    guess_popcorn_noise,
    guess_random_walk,
)

__all__ = ["CANDIDATES", "Action", "Candidate", "Hypothesis", "Kind"]

_ALL = get_args(Kind)
_FACES = "all six faces, 1 minute each"
_STROKES = "turns and strokes along every axis, 1 minute"

_TABLE = (
    Candidate(
        "clock_error",
        guess_clock_error,
        {"motion": "shaking together with another sensor or a reference, 20 s at the beginning and after an hour"},
        "a delay of a sensor against the others that grows; if it is the host's clock, of all sensors against a track",
    ),
    Candidate(
        "skew",
        guess_skew,
        {"motion": "shaking at 2 Hz and more together with another sensor, 1 minute"},
        "a delay of a sensor against the others that is the same in every motion",
    ),
    Candidate(
        "jitter",
        guess_jitter,
        {"motion": "shaking as fast as possible together with another sensor, 1 minute"},
        "noise in proportion to the signal's rate of change; rows that repeat a late one; late times of all sensors",
    ),
    Candidate(
        "dropped_samples",
        guess_dropped_samples,
        dict.fromkeys(_ALL, "10000 readings or more"),
        "gaps between rows, and flags that say so",
    ),
    Candidate(
        "size_effect",
        guess_size_effect,
        {"motion": "turn the box by hand at 200 dps and more about every axis, 1 minute"},
        "specific force that the rotation explains, given the position of the sensor",
        quantity="specific_force",
        needs=("turns",),
    ),
    Candidate(
        "thermal_lag",
        guess_thermal_lag,
        {"heating": "heat by 20 degC within 2 minutes and let cool for 20, twice"},
        "levels that follow the temperature with a delay",
        existing="ignored",
        needs=("warmth",),
    ),
    Candidate(
        "axis_error",
        guess_axis_error,
        {"tumble": "all six faces, 10 s each", "motion": "turns and strokes along every axis, 20 s"},
        "faces or motions that appear along another axis, or with the opposite sign",
        needs=("faces", "turns"),
    ),
    Candidate(
        "misalignment",
        guess_misalignment,
        {"tumble": _FACES, "motion": _STROKES},
        "axes that show part of the stimulus along another axis",
        needs=("faces", "turns"),
    ),
    Candidate(
        "nonlinearity",
        guess_nonlinearity,
        {
            "tumble": _FACES,
            "motion": "turns and strokes up to the range along every axis, 1 minute",
        },
        "opposite faces whose mean is not the bias; in motion, readings that are not proportional to the stimulus",
        needs=("faces", "turns"),
    ),
    Candidate(
        "scale",
        guess_scale,
        {"tumble": _FACES, "motion": _STROKES},
        "a wrong difference of opposite faces, a wrong size of the motion, or a wrong level along gravity",
        needs=("faces", "turns"),
    ),
    Candidate(
        "thermal_scale",
        guess_thermal_scale,
        {"heating": "heat by 20 degC on two opposite faces, 10 minutes each"},
        "slopes over temperature that are opposite on opposite faces, or a wrong scale factor in a warm box",
        needs=("warm_faces",),
    ),
    Candidate(
        "g_sensitivity",
        guess_g_sensitivity,
        {"tumble": _FACES, "motion": "strokes of 1 g and more along every axis, 1 minute"},
        "levels of a gyroscope or magnetometer that differ from face to face, or follow the force",
        quantity="angular_rate",
        needs=("faces", "turns"),
    ),
    Candidate(
        "bias",
        guess_bias,
        {"turn-on": "a dozen boots of 1 minute before the suspected change, and as many after it"},
        "a step of the levels from one log to the next, or stretches of a log with another level",
        existing="ignored",
    ),
    Candidate(
        "turn_on_bias",
        guess_turn_on_bias,
        {"turn-on": "a dozen boots of 1 minute, switched off for 10 s in between"},
        "levels that differ from log to log by more than their scatter within the logs explains",
        needs=("runs",),
    ),
    Candidate(
        "bistable_bias",
        guess_bistable_bias,
        {"turn-on": "20 boots of 1 minute, switched off for 10 s in between"},
        "levels of boots in two groups, which are the same on all axes",
        needs=("runs",),
    ),
    Candidate(
        "thermal_bias",
        guess_thermal_bias,
        {"heating": "heat by 20 degC and let cool, twice, on one face, 10 minutes each way"},
        "levels that follow the square of the temperature, in addition to the fitted straight line",
        existing="ignored",
        needs=("warmth",),
    ),
    Candidate(
        "bias_instability",
        guess_bias_instability,
        {"static": "still for 10 of its time constants, an hour at least", "turn-on": "a dozen boots of some minutes"},
        "Allan deviations that depart from the slope of -1/2, and may return to it",
        existing="joined or replaced",
    ),
    Candidate(
        "random_walk",
        guess_random_walk,
        {"static": "still for an hour, several times", "tumble": "the first face again at the end"},
        "Allan deviations that rise with a slope of +1/2, levels that do not return",
    ),
    Candidate(
        "popcorn_noise",
        guess_popcorn_noise,
        {"static": "still until 20 jumps have occurred, an hour at least"},
        "levels that jump to and fro between two values",
    ),
    Candidate(
        "common_mode",
        guess_common_mode,
        {"static": "all units of the chip, two of them anti-parallel, still for an hour at one temperature"},
        "slow drift that correlates between the units of a chip along their own axes",
    ),
    Candidate(
        "tone",
        guess_tone,
        {"static": "still for 5 minutes, and again at another poll rate, which shifts an alias"},
        "a line in the spectrum, at a constant or a drifting frequency",
        existing="joined or replaced",
        needs=("rest",),
    ),
    Candidate(
        "white_noise",
        guess_white_noise,
        {"static": "still for 1 minute"},
        "more noise in a part of the time, or since an earlier recording; noise of a sensor that was never at rest",
        existing="ignored",
        needs=("rest",),
    ),
    Candidate(
        "bandwidth",
        guess_bandwidth,
        {"static": "still for 2 minutes, read at the sensor's data rate"},
        "correlation phi^k of readings k rows apart, and a delayed response to motion",
        existing="ignored",
        needs=("rest",),
    ),
    Candidate(
        "odr_error",
        guess_odr_error,
        dict.fromkeys(_ALL, "polled faster than the chip's data rate"),
        "rows that repeat in step with the polls, readings that are older than others, even codes, other noise",
    ),
    Candidate(
        "range_reset",
        guess_range_reset,
        {
            "tumble": _FACES,
            "turn-on": "20 boots of 1 minute",
            "static": "still for an hour, on a face with gravity along the sensor's z axis",
            "motion": _STROKES,
        },
        "levels and noise scaled by the ratio of two ranges of the chip: always, in some boots, or from a row on",
    ),
    Candidate(
        "quantisation",
        guess_quantisation,
        dict.fromkeys(_ALL, "1000 readings, at rest or in motion"),
        "codes that are multiples of a number, that never have one of their bits, or that are missing before a carry",
    ),
    Candidate(
        "saturation",
        guess_saturation,
        {"tumble": _FACES, "motion": "strokes and turns up to the range, along every axis"},
        "readings that accumulate at the outermost code, before the end of the converter",
        needs=("faces", "turns"),
    ),
    Candidate(
        "adaptive_range",
        guess_adaptive_range,
        {"motion": "turns that pass 100 dps a hundred times, at the chip's full rate"},
        "readings of an ICM-42688-P that repeat at high rates",
        chip="icm42688_gyro",
    ),
    Candidate(
        "stale_samples",
        guess_stale_samples,
        dict.fromkeys(_ALL, "1000 readings or more"),
        "rows that equal the previous row on all axes, throughout the log",
    ),
    Candidate(
        "glitches",
        guess_glitches,
        dict.fromkeys(("static", "tumble", "heating", "turn-on"), "at rest, 10000 readings or more"),
        "jumps there and back that noise does not explain, or codes that no sensor delivers",
    ),
    Candidate(
        "stuck",
        guess_stuck,
        dict.fromkeys(_ALL, "the same experiment again, for as long as possible"),
        "runs of equal rows that are longer than repeated samples and chance explain",
    ),
    Candidate(
        "channel_swap",
        guess_channel_swap,
        {
            "static": "still for 1 minute",
            "tumble": _FACES,
            "motion": _STROKES,
        },
        "readings with the noise, axes or levels of another sensor, or of two sensors that are exchanged",
    ),
)

CANDIDATES: Mapping[str, Candidate] = MappingProxyType({candidate.effect: candidate for candidate in _TABLE})
"""In the physical order of the effects. `own_clock` is not among them: every polled chip has a phase of its own, and
the base model draws it, so only larger errors remain to be explained. An age that no sample period explains is a
`skew`, an age that changes is a `jitter`, and a rate at which rows repeat is an `odr_error`. Each of these names the
cause better than `own_clock` would.
"""

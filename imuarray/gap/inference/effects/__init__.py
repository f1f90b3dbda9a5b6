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
        {"motion": "shaking beside another sensor, or a reference, 20 s at the beginning and after an hour"},
        "a sensor that is behind the others, or ahead, by more and more; of the host: all sensors behind a log's track",
    ),
    Candidate(
        "skew",
        guess_skew,
        {"motion": "shaking at 2 Hz and more beside another sensor, 1 minute"},
        "a sensor that is behind the others by the same time in every motion",
    ),
    Candidate(
        "jitter",
        guess_jitter,
        {"motion": "shaking as fast as possible beside another sensor, 1 minute"},
        "noise in proportion to how fast the signal changes; rows that repeat a late one; late times of all sensors",
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
        "force that rotation explains, by where the sensor sits",
        quantity="specific_force",
        needs=("turns",),
    ),
    Candidate(
        "thermal_lag",
        guess_thermal_lag,
        {"heating": "heat by 20 degC within 2 minutes and let cool for 20, twice"},
        "levels that follow the temperature of some time ago",
        existing="ignored",
        needs=("warmth",),
    ),
    Candidate(
        "axis_error",
        guess_axis_error,
        {"tumble": "all six faces, 10 s each", "motion": "turns and strokes along every axis, 20 s"},
        "faces or a motion that come out along another axis, or with the other sign",
        needs=("faces", "turns"),
    ),
    Candidate(
        "misalignment",
        guess_misalignment,
        {"tumble": _FACES, "motion": _STROKES},
        "axes that show a share of what acts along another one",
        needs=("faces", "turns"),
    ),
    Candidate(
        "nonlinearity",
        guess_nonlinearity,
        {
            "tumble": _FACES,
            "motion": "turns and strokes up to the range along every axis, 1 minute",
        },
        "opposite faces whose mean isn't the bias; in motion, readings that bend",
        needs=("faces", "turns"),
    ),
    Candidate(
        "scale",
        guess_scale,
        {"tumble": _FACES, "motion": _STROKES},
        "opposite faces that differ by more or less than they should, a share of motion, or a level along gravity",
        needs=("faces", "turns"),
    ),
    Candidate(
        "thermal_scale",
        guess_thermal_scale,
        {"heating": "heat by 20 degC on two opposite faces, 10 minutes each"},
        "slopes over temperature that are opposite on opposite faces, or a scale that is off in warmth",
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
        "levels of logs that differ by more than what is within them explains",
        needs=("runs",),
    ),
    Candidate(
        "bistable_bias",
        guess_bistable_bias,
        {"turn-on": "20 boots of 1 minute, switched off for 10 s in between"},
        "levels of boots in two groups, the same ones on all axes",
        needs=("runs",),
    ),
    Candidate(
        "thermal_bias",
        guess_thermal_bias,
        {"heating": "heat by 20 degC and let cool, twice, on one face, 10 minutes each way"},
        "levels that follow the square of the temperature, beside the straight line that is fitted",
        existing="ignored",
        needs=("warmth",),
    ),
    Candidate(
        "bias_instability",
        guess_bias_instability,
        {"static": "still for 10 of its time constants, an hour at least", "turn-on": "a dozen boots of some minutes"},
        "Allan deviations that leave the slope of -1/2, and come back to it or not",
        existing="joined or replaced",
    ),
    Candidate(
        "random_walk",
        guess_random_walk,
        {"static": "still for an hour, several times", "tumble": "the first face again at the end"},
        "Allan deviations that rise by +1/2, levels that never come back",
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
        {"static": "still for 5 minutes, and again at another poll rate, by which an alias moves"},
        "a line in the spectrum, that stays where it is or drifts",
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
        "correlation phi^k of readings k rows apart, and motion that comes late",
        existing="ignored",
        needs=("rest",),
    ),
    Candidate(
        "odr_error",
        guess_odr_error,
        dict.fromkeys(_ALL, "polled faster than the chip's data rate"),
        "rows that repeat at the poll's pace, readings that are older than others, even codes, noise of another size",
    ),
    Candidate(
        "range_reset",
        guess_range_reset,
        {
            "tumble": _FACES,
            "turn-on": "20 boots of 1 minute",
            "static": "still for an hour, on a face that the sensor's z axis feels",
            "motion": _STROKES,
        },
        "levels and noise scaled by sensitivities of the chip: always, in some boots, or from a row on",
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
        "readings that pile up at the outermost code, short of the converter's end",
        needs=("faces", "turns"),
    ),
    Candidate(
        "adaptive_range",
        guess_adaptive_range,
        {"motion": "turns that pass 100 dps a hundred times, at the chip's full rate"},
        "readings that repeat where the rates of an ICM-42688-P are high",
        chip="icm42688_gyro",
    ),
    Candidate(
        "stale_samples",
        guess_stale_samples,
        dict.fromkeys(_ALL, "1000 readings or more"),
        "rows that equal the one before on all axes, all through the log",
    ),
    Candidate(
        "glitches",
        guess_glitches,
        dict.fromkeys(("static", "tumble", "heating", "turn-on"), "at rest, 10000 readings or more"),
        "steps there and back that no noise makes, or words that no sensor gives",
    ),
    Candidate(
        "stuck",
        guess_stuck,
        dict.fromkeys(_ALL, "the same again, for as long as possible"),
        "runs of equal rows that are longer than holding and chance make them",
    ),
    Candidate(
        "channel_swap",
        guess_channel_swap,
        {
            "static": "still for 1 minute",
            "tumble": _FACES,
            "motion": _STROKES,
        },
        "readings that are another sensor's, by noise, axes or levels; or two in each other's place",
    ),
)

CANDIDATES: Mapping[str, Candidate] = MappingProxyType({candidate.effect: candidate for candidate in _TABLE})
"""In the physical order of the effects. `own_clock` is not among them: every polled chip has a phase of its own, and
the base model draws it, so only larger errors remain to be explained. An age that no sample period explains is a
`skew`, an age that changes is a `jitter`, and a rate at which rows repeat is an `odr_error`. Each of these names the
cause better than `own_clock` would.
"""

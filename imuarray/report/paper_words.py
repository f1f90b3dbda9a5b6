"""What the paper's page says beside its numbers: titles, what each table is, captions of the figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

HOW_TO_READ = (
    "Each row is a number that the paper prints. Recomputed: what follows for it from other numbers that the paper "
    "prints; unmarked if equal in every digit, ≈ if within the rounding of those numbers, ≠ if beyond. Simulated: the "
    "same statistic of the simulated array. Difference: simulated less printed. z: the difference over its "
    "uncertainty, which is what the paper's own tables disagree by where they tell the same thing twice (of the "
    "logarithm for deviations, ranges and ratios); marked beyond 2. Source:"
)

TABLE_WORDS: Mapping[int, tuple[str, str]] = {
    1: (
        "how the sensors lie",
        "The sensor axis along each axis of the box. Recomputed from Table 10 for accelerometers. Put into the "
        "simulation, not found by it.",
    ),
    2: ("one gyroscope at its fastest", "Gyro1 alone at 350 Hz. Columns in dps are the same numbers in another unit."),
    3: (
        "accelerometers on six faces",
        "Bias, scale factor and drift, recomputed from Table 10; scale factors are simulated without a sign.",
    ),
    4: ("gyroscopes on six faces", "Bias and response to gravity, recomputed from Table 10."),
    5: (
        "in-run variation",
        "Standard deviation of fifteen five-minute means in a row, averaged over axes; recomputed from Table 11.",
    ),
    6: ("BMA1 switched on fifteen times", "Means of each run; run 10 came up in the wrong range."),
    7: ("Gyro3 switched on fifteen times", "Means of each run; two sets of biases."),
    8: (
        "output against temperature",
        "Straight lines through readings while the box was heated twice. Slopes can't be recomputed without the "
        "readings; what two sensors keep together can, below the table.",
    ),
    9: ("one gyroscope's noise", "The logs of Table 2, with standard errors and the chip's thermometer."),
    10: ("six faces, every channel", "Fifteen minutes on each face and the first once more; BMA180 and ADXL345 noise."),
    11: (
        "run to run and within a run",
        "Fifteen runs of five minutes, and fifteen such windows of one run: mean, standard error, deviation of "
        "readings, deviation and range of the means, and the ratio of the two deviations.",
    ),
}
"""By the number of the table: the rest of the heading, and what it is."""

FIGURE_WORDS: Mapping[str, tuple[str, str]] = {
    "6": (
        "Like Figure 6, simulated: a continuous run averaged over five minutes, less its mean. Gyro3 is at ±250 dps, "
        "where a count is eight times smaller. Curves wander by as much as Table 5 says, each in its own way.",
        "Smoothed outputs of two ADXL345, two BMA180 and three L3G4200D over 75 minutes",
    ),
    "7": (
        "Like Figure 7: the temperature that the simulated box was given. Times and peaks are the paper's, the curves "
        "between them are ours.",
        "Temperature over 110 minutes with two peaks",
    ),
    "8": (
        "Like Figure 8, simulated: ADXL1 z against temperature. The slope is small beside the noise of one reading; "
        "only even codes come out.",
        "Scatter of ADXL1 z against temperature with the simulated and the printed line",
    ),
    "9": (
        "Like Figure 9, simulated: Gyro2 x against temperature. The slope stands out, and the lines differ by what the "
        "bias does from one day to another.",
        "Scatter of Gyro2 x against temperature with the simulated and the printed line",
    ),
    "10": (
        "Like Figure 10, simulated: two gyroscopes about box Y that point in opposite directions, means of half a "
        "minute. Each follows the temperature, half of their difference hardly does.",
        "Outputs of Gyro1 y and Gyro2 y and half of their difference while the box is heated",
    ),
    "11": (
        "Like Figure 11, simulated: Allan deviation of Gyro1 alone. Both ranges are alike; the curves are straight "
        "(grey: white noise) but for the shortest times, where neighbours correlate, and the longest, where the bias "
        "wanders.",
        "Allan deviation of three axes of a gyroscope at two ranges",
    ),
    "13": (
        "Like Figures 13 and 14, simulated: neighbours correlate by 0.4; the y axis has a line at 50 Hz, whose period "
        "at 350 Hz is seven samples.",
        "Autocorrelation and spectrum of three axes of a gyroscope at 250 dps",
    ),
    "15": (
        "Like Figure 15, simulated: codes of Gyro1 x at both ranges and the normal curve of the same deviation. A "
        "count at ±2000 dps is small beside the noise.",
        "Histograms of Gyro1 x at two ranges",
    ),
    "16": (
        "Like Figures 16 and 17, simulated: ADXL1, from the continuous run at 48 Hz (the paper's own log was faster). "
        "White on all axes, z twice as noisy.",
        "Allan deviation and spectrum of three axes of an ADXL345",
    ),
    "18": (
        "Like Figures 18 and 19, simulated: BMA2 at ±16 g, from the same run. White on all axes, no line.",
        "Allan deviation and spectrum of three axes of a BMA180",
    ),
}
"""By the number of the paper's figure: caption, and what it shows for those who can't see it."""


def further_words(result: Mapping[str, Any]) -> dict[int, str]:
    """What recomputing tells of whole columns, by table."""
    slow, fast, runs, windows = result["readings"]
    spread = result["range_over_deviation"]
    possible, total = spread["possible"]
    return {
        9: (
            f"All four standard errors at ±250 dps fit {slow['least']} to {slow['most']} readings "
            f"({slow['seconds']:.0f} s at 350 Hz), all at ±2000 dps {fast['least']} to {fast['most']} "
            f"({fast['seconds']:.0f} s; the text says about 1400 s of both)."
        ),
        11: (
            f"One number of readings explains all {runs['channels']} standard errors of a series: {runs['least']} to "
            f"{runs['most']} for the runs ({runs['rate_hz']:.2f} Hz), {windows['least']} to {windows['most']} for the "
            f"windows ({windows['rate_hz']:.2f} Hz). Fifteen numbers have a range of {spread['least']:.2f} to "
            f"{spread['most']:.2f} of their deviations; {possible} of {total} printed pairs do, the others are of "
            f"thermometers. Inertial axes (not of BMA1 and Gyro3) have {spread['mean']['runs']:.2f} and "
            f"{spread['mean']['cont']:.2f} on average, normal numbers {spread['normal']:.2f}."
        ),
    }

"""The inputs of a fusion, prepared for one log: the calibration as it holds for this log, and the sensors to fuse."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from imuarray.calibrate import Calibration
from imuarray.calibrate.start_up import came_up
from imuarray.errors import CalibrationError, FusionError
from imuarray.fuse.element_temperature import (
    element_temperatures,
    mismatch_sentences,
    slopes_of,
    temperature_mismatch,
)
from imuarray.fuse.fuse import NEEDS_NOISE
from imuarray.log import Log, SensorLog
from imuarray.printable import listed
from imuarray.units import INERTIAL

_NO_RANGES: Mapping[str, Mapping[float, float]] = MappingProxyType({})


@dataclass(frozen=True)
class FusionInputs:
    """A calibration and the sensors to fuse (`only`, all if empty), with what a person should know of them.

    `uncalibrated`: sensors that are fused with data-sheet values. `start_up`: sentences on the states in which sensors
    started. `thermal`: sensors whose bias follows the log's temperature. `temperature`: sentences on sensors that were
    calibrated at another temperature. `remarks`: sentences on what the calibration lacks.
    """

    calibration: Calibration
    only: tuple[str, ...] = ()
    uncalibrated: tuple[str, ...] = ()
    start_up: tuple[str, ...] = ()
    thermal: tuple[str, ...] = ()
    temperature: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def prepare_inputs(
    log: Log,
    calibration: Calibration,
    *,
    technique: str | None = None,
    only: Sequence[str] = (),
    ranges: Mapping[str, Mapping[float, float]] = _NO_RANGES,
    progress: Callable[[str, int, int], None] = lambda what, done, of: None,
) -> FusionInputs:
    """Prepare `calibration` for fusing `log` by `technique` (None: by any of them); `only` these sensors, if any are
    named.

    Biases become those of the states in which the sensors started, and sensors that started wrong are left out: in
    another range, too, for chips whose sensitivities by range are in `ranges` (`imuarray.chips.SENSITIVITIES`). Noise
    that the technique needs and the calibration lacks is measured where the log is at rest; `progress` is called
    meanwhile with a text, the number of sensors that are done, and of how many.

    >>> from imuarray import load_calibration, open_log
    >>> from imuarray.chips import SENSITIVITIES
    >>> from imuarray.fuse import fuse
    >>> with open_log("run.h5") as log:
    ...     inputs = prepare_inputs(log, load_calibration("cal.toml"), technique="planes", ranges=SENSITIVITIES)
    ...     blocks = list(fuse(log, inputs.calibration, "planes", only=inputs.only))
    """
    uncalibrated = [sensor.name for sensor in _inertial(log, only) if sensor.name not in calibration.sensors]
    calibration, start_up, chosen = _in_start_states(log, calibration, only, ranges)
    sensors = _inertial(log, chosen)
    sloped = [sensor for sensor in sensors if slopes_of(calibration, sensor) is not None]
    warm = element_temperatures(log, sloped, calibration)
    cold = [sensor.name for sensor in sloped if sensor.name not in warm]
    remarks = []
    if cold:
        remarks.append(f"{log.path}: no thermometer for the slopes of {', '.join(cold)}; biases stay as calibrated")
    lacking = [sensor.name for sensor in sensors if calibration.or_nominal(sensor).noise_lsb is None]
    if lacking and (technique is None or technique in NEEDS_NOISE):
        which = "" if len(lacking) == len(sensors) else f" of {', '.join(lacking)}"
        from imuarray.calibrate.noise import with_noise_of  # its weight is for those who lack it

        remarks.append(f"no noise{which} in the calibration; it was measured in this log at rest")
        try:
            calibration = with_noise_of(log, calibration, lacking, progress)
        except CalibrationError as error:
            raise FusionError(
                f"{error}, to measure noise{which} that the calibration lacks; record the box at rest, run"
                " `imuarray calibrate noise` on that log and give the file as calibration, or choose a technique"
                " that needs no noise (mean, opposed)"
            ) from None
    mismatch = temperature_mismatch(log, sensors, calibration)
    return FusionInputs(
        calibration,
        tuple(chosen),
        tuple(uncalibrated),
        tuple(start_up),
        tuple(warm),
        tuple(mismatch_sentences(calibration, mismatch)),
        tuple(remarks),
    )


def complete_responses(log: Log, inputs: FusionInputs) -> FusionInputs:
    """Return the inputs of `prepare_inputs` with the columns of gyroscopes' responses that the calibration lacks and
    the log determines, from other gyroscopes or from gravity, and sentences about them. It takes the whole log: frames
    that are fused by what was known when they were read do without.
    """
    gyroscopes = [sensor for sensor in _inertial(log, inputs.only) if sensor.quantity == "angular_rate"]
    if not any(inputs.calibration.or_nominal(sensor).uncertain_axes() for sensor in gyroscopes):
        return inputs
    from imuarray.calibrate.response_transfer import transfer_response  # its weight is for those who lack a column

    transfer = transfer_response(log, inputs.calibration, inputs.only)
    remarks = [
        f"response of {name} to rates about box {', '.join(axes)} determined in this log, from"
        f" {listed(transfer.references)}"
        for name, axes in transfer.axes.items()
    ]
    remarks += [
        f"rates of {name} contradict its calibration and {listed(transfer.references)}; its response stays as"
        " calibrated"
        for name in transfer.refused
    ]
    return replace(inputs, calibration=transfer.calibration, remarks=(*inputs.remarks, *remarks))


def _inertial(log: Log, only: Sequence[str]) -> list[SensorLog]:
    """The accelerometers and gyroscopes of a log; `only` these, if any are named."""
    sensors = [sensor for quantity in INERTIAL for sensor in log.of(quantity)]
    return [sensor for sensor in sensors if not only or sensor.name in only]


def require_known_sensors(log: Log, calibration: Calibration, only: Sequence[str], calibration_file: str) -> None:
    """FusionError if a calibration, named by its file, knows none of the inertial sensors of `log` (`only` these)."""
    fused = [sensor.name for sensor in _inertial(log, only)]
    if fused and not calibration.sensors.keys() & set(fused):
        raise FusionError(
            f"{calibration_file}: contains {', '.join(calibration.sensors) or 'no sensor'},"
            f" but none of {log.path}: {', '.join(fused)}"
        )


def _in_start_states(
    log: Log, calibration: Calibration, only: Sequence[str], ranges: Mapping[str, Mapping[float, float]]
) -> tuple[Calibration, list[str], Sequence[str]]:
    """The calibration with the biases of the states in which sensors started; sentences; the sensors to fuse."""
    by_sensor = {name: ranges[sensor.chip] for name, sensor in log.sensors.items() if sensor.chip in ranges}
    chosen, starts = came_up(log, calibration, by_sensor)
    wrong = [name for name, start in starts.items() if start.fault]
    sentences = [start.sentence(name, calibration) for name, start in starts.items()]
    if wrong:
        only = [name for name in only or [sensor.name for sensor in _inertial(log, ())] if name not in wrong]
    return chosen, [sentence for sentence in sentences if sentence], only

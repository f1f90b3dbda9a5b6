"""Noise figures of an IMU in the configuration files of estimators and simulators: SI, one file an IMU.

========== ======================== ==========================================================================
tool       file                     figures
========== ======================== ==========================================================================
kalibr     imu.yaml                 noise density N and random walk K of the bias (ethz-asl/kalibr, wiki "IMU
                                    Noise Model"; keys as `ImuParameters` of its ConfigReader.py reads them)
openvins   kalibr_imu_chain.yaml    the same below `imu0`, with the identity for its intrinsics
vins-fusion part of its config.yaml standard deviations at the rate f: N sqrt(f) and K sqrt(f), which it multiplies by
                                    the interval (`integration_base.h`)
gazebo     sensor of an .sdf        standard deviation N sqrt(f), and K as `dynamic_bias_stddev`
px4        plugin of an .sdf        N and K (`gazebo_imu_plugin.cpp` of PX4-SITL_gazebo-classic)
========== ======================== ==========================================================================

These tools have one figure for all three axes: the largest of them is written. If no random walk is detected, the file
has no figure for it, only a comment with the upper limit, so that every figure in a file was measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from imuarray.units import INERTIAL, STANDARD_GRAVITY

PREFIX: Mapping[str, str] = MappingProxyType({"specific_force": "accelerometer", "angular_rate": "gyroscope"})
_UNIT = {"specific_force": "m/s^2", "angular_rate": "rad/s"}
_WALK_UNIT = {"specific_force": "m/s^3", "angular_rate": "rad/s^2"}
_VINS = {"specific_force": "acc", "angular_rate": "gyr"}
_SDF = {"specific_force": "linear_acceleration", "angular_rate": "angular_velocity"}
_INFLATE = (
    "as measured at rest. A rig in motion has errors that rest does not show; users of these tools inflate",
    "the figures to cover them: often the densities by 5 and the walks by 10 (OpenVINS, rpng_aruco).",
)
_TYPICAL_CORRELATION_S = 3600.0
"""Correlation time of a bias that SDFormat's specification calls typical."""


@dataclass(frozen=True)
class TriadNoise:
    """Noise of the worst of three axes in SI: density N and random walk K of the bias, None if not detected, and their
    upper limits (None without a limit). `verdict` is the reason why the fit is not reliable; noise of another kind may
    then look like a random walk, and neither K nor its limit is stated.
    """

    density: float | None
    walk: float | None
    density_bound: float | None
    walk_bound: float | None
    verdict: str = ""


@dataclass(frozen=True)
class ImuNoise:
    """Noise of one IMU: its name, its ROS topic ("" if it has none), rate and length of the record, and the noise of
    its triads by quantity, one or both.
    """

    name: str
    topic: str
    rate_hz: float
    seconds: float
    software: str
    triads: Mapping[str, TriadNoise]

    def lacks(self) -> list[str]:
        """Return the keys of Kalibr's file without a figure."""
        parts = {"density": "noise_density", "walk": "random_walk"}
        return [
            f"{PREFIX[quantity]}_{part}"
            for quantity in INERTIAL
            for attribute, part in parts.items()
            if getattr(self.triads.get(quantity), attribute, None) is None
        ]


def triad_noise(axes: Sequence[Mapping[str, Any]], si_per_count: float) -> TriadNoise | None:
    """Return the noise of a triad from the fits of its axes, each the terms by name and a verdict; None if its white
    noise has no upper limit, so that nothing is known.
    """

    def largest(term: str, part: str) -> float | None:
        """Return the largest detected coefficient of the axes, or the largest upper limit if none is detected."""
        terms = [item for axis in axes if (item := axis["terms"].get(term))]
        values = [item[part] for item in terms if part != "value" or item["significant"]]
        return max(values) * si_per_count if values else None

    bound = largest("white", "high")
    if bound is None:
        return None
    verdict = next((str(axis["verdict"]) for axis in axes if axis["verdict"]), "")
    walk, walk_bound = largest("random walk", "value"), largest("random walk", "high")
    if any(item.get("doubtful") for axis in axes if (item := axis["terms"].get("random walk"))):
        walk = walk_bound = None
    return TriadNoise(largest("white", "value"), walk, bound, walk_bound, verdict)


def imus_of(result: Mapping[str, Any]) -> list[ImuNoise]:
    """Return the IMUs of a `characterise_log` result: an accelerometer and a gyroscope are one IMU if the log has no
    other sensors; otherwise each sensor is one. The halves of a six-axis chip ("IMU1_acc", "IMU1_gyro") are one IMU.
    """
    sensors = [sensor for sensor in result["sensors"] if sensor["quantity"] in PREFIX and _noise(sensor) is not None]
    if len(sensors) == 2 and {sensor["quantity"] for sensor in sensors} == set(PREFIX):
        return [_imu(sensors, result)]
    units: dict[str, list[Mapping[str, Any]]] = {}
    for sensor in sensors:
        units.setdefault(_unit_name(sensor["name"]), []).append(sensor)
    return [_imu(halves, result) for halves in units.values()]


def _imu(sensors: Sequence[Mapping[str, Any]], result: Mapping[str, Any]) -> ImuNoise:
    names = {_unit_name(sensor["name"]) for sensor in sensors}
    name = names.pop() if len(names) == 1 else "_".join(sensor["name"] for sensor in sensors)
    topic = "" if names else f"/sensors/{name if len(sensors) > 1 else sensors[0]['name']}"
    stretch = result["stretch"]
    noise = {sensor["quantity"]: triad for sensor in sensors if (triad := _noise(sensor))}
    seconds = stretch["end_s"] - stretch["start_s"]
    return ImuNoise(name, topic, float(sensors[0]["rate_hz"]), seconds, result["software"], noise)


def _noise(sensor: Mapping[str, Any]) -> TriadNoise | None:
    fits = [axis["fit"] for axis in sensor["axes"] if axis.get("fit")]
    scale = sensor["si_per_count"]
    return None if scale is None else triad_noise(fits, float(scale))


def _unit_name(name: str) -> str:
    for half in ("_acc", "_gyro"):
        name = name.removesuffix(half)
    return name


def imu_files(result: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts for Kalibr by file name ("imu_Gyro1.yaml"), one for every IMU of a `characterise_log` result."""
    units: dict[str, list[Mapping[str, Any]]] = {}
    for sensor in result["sensors"]:
        units.setdefault(_unit_name(sensor["name"]), []).append(sensor)
    imus = [imu for sensors in units.values() for imu in imus_of({**result, "sensors": sensors})]
    return {f"imu_{imu.name}.yaml": kalibr_text(imu) for imu in imus}


def kalibr_text(imu: ImuNoise) -> str:
    """Return Kalibr's imu.yaml."""
    return _lines([*_comments(imu), *_kalibr_keys(imu), f"rostopic: {_topic(imu)}", f"update_rate: {imu.rate_hz:.6g}"])


def openvins_text(imu: ImuNoise) -> str:
    """Return OpenVINS's kalibr_imu_chain.yaml: the box has the frame of the IMU, and its intrinsics are calibrated."""
    ones, zeros = _matrix(3, 1.0), _matrix(3, 0.0)
    keys = [
        "T_i_b:",
        *_matrix(4, 1.0),
        *_kalibr_keys(imu),
        f"rostopic: {_topic(imu)}",
        "time_offset: 0.0",
        f"update_rate: {imu.rate_hz:.6g}",
        'model: "kalibr"',
        *("Tw:", *ones, "R_IMUtoGYRO:", *ones, "Ta:", *ones, "R_IMUtoACC:", *ones, "Tg:", *zeros),
    ]
    return _lines(["%YAML:1.0", *_comments(imu), "imu0:", *(f"  {key}" for key in keys)])


def vins_fusion_text(imu: ImuNoise) -> str:
    """Return the IMU's part of VINS-Fusion's configuration."""
    keys = ["imu: 1", f'imu_topic: "{_topic(imu)}"']
    factor = math.sqrt(imu.rate_hz)
    for quantity, triad in _triads(imu):
        for part, value, bound in (
            ("n", triad.density, triad.density_bound),
            ("w", triad.walk, triad.walk_bound),
        ):
            unit = _UNIT[quantity] if part == "n" else _WALK_UNIT[quantity]
            scaled = [None if figure is None else figure * factor for figure in (value, bound)]
            key, at_rate = f"{_VINS[quantity]}_{part}", f"{unit}, at {imu.rate_hz:.6g} Hz"
            keys.append(_yaml_key(key, scaled[0], scaled[1], at_rate, triad.verdict))
    keys.append(f"g_norm: {STANDARD_GRAVITY}  # m/s^2, standard gravity; local gravity is better")
    return _lines(["%YAML:1.0", *_comments(imu), "# Put these keys into the configuration of VINS-Fusion.", *keys])


def gazebo_text(imu: ImuNoise) -> str:
    """Return a sensor of type imu for the model of a Gazebo simulation (SDFormat)."""
    lines = [
        *_xml_comments(imu),
        f'<sensor name={quoteattr(imu.name)} type="imu">',
        "  <always_on>true</always_on>",
        f"  <update_rate>{imu.rate_hz:.6g}</update_rate>",
        f"  <topic>{escape(_topic(imu))}</topic>",
        "  <imu>",
    ]
    for quantity, triad in reversed(_triads(imu)):
        noise = _gazebo_noise(quantity, triad, imu.rate_hz)
        lines += [f"    <{_SDF[quantity]}>"]
        for axis in "xyz":
            lines += [f"      <{axis}>", *(f"        {line}" for line in noise), f"      </{axis}>"]
        lines += [f"    </{_SDF[quantity]}>"]
    return _lines([*lines, "  </imu>", "</sensor>"])


def _gazebo_noise(quantity: str, triad: TriadNoise, rate_hz: float) -> list[str]:
    if triad.density is None:
        return [_xml_missing("stddev", triad.density_bound, math.sqrt(rate_hz), _UNIT[quantity])]
    noise = ['<noise type="gaussian">', "  <mean>0</mean>"]
    noise.append(f"  <stddev>{triad.density * math.sqrt(rate_hz):.6g}</stddev>")
    if triad.walk is None:
        noise.append(
            "  "
            + _xml_missing(
                "dynamic_bias_stddev", triad.walk_bound, 1.0, f"{_WALK_UNIT[quantity]}/sqrt(Hz)", triad.verdict
            )
        )
    else:
        noise.append(f"  <dynamic_bias_stddev>{triad.walk:.6g}</dynamic_bias_stddev>")
        noise.append("  <!-- not measured: the correlation time that SDFormat's specification calls typical -->")
        noise.append(f"  <dynamic_bias_correlation_time>{_TYPICAL_CORRELATION_S:g}</dynamic_bias_correlation_time>")
    return [*noise, "</noise>"]


def px4_text(imu: ImuNoise) -> str:
    """Return the IMU plugin of a model of PX4 for Gazebo Classic."""
    lines = [
        *_xml_comments(imu),
        '<plugin name="imu_plugin" filename="libgazebo_imu_plugin.so">',
        "  <robotNamespace></robotNamespace>",
        "  <linkName>/imu_link</linkName>",
        "  <imuTopic>/imu</imuTopic>",
    ]
    for quantity, triad in reversed(_triads(imu)):
        for part, value, bound, unit in (
            ("NoiseDensity", triad.density, triad.density_bound, f"{_UNIT[quantity]}/sqrt(Hz)"),
            ("RandomWalk", triad.walk, triad.walk_bound, f"{_WALK_UNIT[quantity]}/sqrt(Hz)"),
        ):
            tag = f"{PREFIX[quantity]}{part}"
            if value is None:
                lines.append(f"  {_xml_missing(tag, bound, 1.0, unit, triad.verdict)}")
            else:
                lines.append(f"  <{tag}>{value:.6g}</{tag}>")
        lines.append(
            f"  <!-- {PREFIX[quantity]}BiasCorrelationTime and TurnOnBiasSigma: not measured by one record -->"
        )
    lines.append("  <!-- PX4 takes the figures of an ADIS16448 for what is not here. -->")
    return _lines([*lines, "</plugin>"])


TEXTS: Mapping[str, Callable[[ImuNoise], str]] = MappingProxyType(
    {
        "kalibr": kalibr_text,
        "openvins": openvins_text,
        "vins-fusion": vins_fusion_text,
        "gazebo": gazebo_text,
        "px4": px4_text,
    }
)
"""Tool to the text of its file."""


def _triads(imu: ImuNoise) -> list[tuple[str, TriadNoise]]:
    """Return the noise of both quantities; all figures of a quantity that the IMU lacks are None."""
    return [(quantity, imu.triads.get(quantity, TriadNoise(None, None, None, None))) for quantity in INERTIAL]


def _comments(imu: ImuNoise) -> Iterator[str]:
    """Return comments: the origin of the figures, and warnings."""
    yield f"# {imu.name}: {imu.software}, noise at rest over {imu.seconds:.0f} s; the largest of three axes,"
    yield from (f"# {line}" for line in _INFLATE)
    for quantity, triad in imu.triads.items():
        if triad.verdict:
            yield f"# The fit of the {PREFIX[quantity]} is poor, do not trust its figures: {triad.verdict}"
    if not imu.topic:
        yield "# rostopic: force and rate come from two chips on two topics; enter the topic that has both."


def _topic(imu: ImuNoise) -> str:
    return imu.topic or "/imu0"


def _kalibr_keys(imu: ImuNoise) -> Iterator[str]:
    for quantity, triad in _triads(imu):
        prefix = PREFIX[quantity]
        density_unit, walk_unit = f"{_UNIT[quantity]}/sqrt(Hz)", f"{_WALK_UNIT[quantity]}/sqrt(Hz)"
        yield _yaml_key(f"{prefix}_noise_density", triad.density, triad.density_bound, density_unit)
        yield _yaml_key(f"{prefix}_random_walk", triad.walk, triad.walk_bound, walk_unit, triad.verdict)


_UNDETERMINED = "not determined, because the noise is of another kind"


def _yaml_key(key: str, value: float | None, bound: float | None, unit: str, verdict: str = "") -> str:
    """Return a key, or a comment in its place without a figure."""
    if value is not None:
        return f"{key}: {_yaml_number(value)}  # {unit}"
    if bound is not None:
        return f"# {key}: not significant, at most {bound:.6g} {unit}; enter your own figure, or record for longer"
    return f"# {key}: {_UNDETERMINED}; enter your own figure" if verdict else f"# {key}: no such sensor was measured"


def _yaml_number(value: float) -> str:
    """Return a number that every YAML parser reads as a number: YAML 1.1 requires a dot, which 1e-05 lacks."""
    text = f"{value:.6g}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa}.0e{exponent}" if mark and "." not in mantissa else text


def _matrix(size: int, diagonal: float) -> list[str]:
    rows = ([diagonal if column == row else 0.0 for column in range(size)] for row in range(size))
    return [f"  - [{', '.join(map(str, row))}]" for row in rows]


def _xml_comments(imu: ImuNoise) -> Iterator[str]:
    for line in _comments(imu):
        yield f"<!-- {escape(line.removeprefix('# ')).replace('--', '- -')} -->"


def _xml_missing(tag: str, bound: float | None, factor: float, unit: str, verdict: str = "") -> str:
    if bound is None:
        return f"<!-- {tag}: {_UNDETERMINED if verdict else 'no such sensor was measured'} -->"
    return f"<!-- {tag}: not significant, at most {bound * factor:.6g} {unit} -->"


def _lines(lines: Iterable[str]) -> str:
    return "\n".join(lines) + "\n"

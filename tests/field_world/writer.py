"""Writes cases: the logs of each, and what is true of them."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from tests.field_world.barometer import read_barometer
from tests.field_world.log_file import configuration, write_log
from tests.field_world.readings import Readings
from tests.field_world.severity import size_faults
from tests.field_world.streams import stream

STALE, OVERRUN, SATURATED, AFTER_LOSS, AFTER_RESTART = 1, 2, 4, 8, 16
"""Bits of the status column."""
BUSES = {"linux": "i2c:/dev/i2c-1", "mcu": "serial:/dev/ttyACM0"}
SOURCES = {"linux": "i2c", "mcu": "serial"}
PROGRAMS = {"linux": "nightlog 0.9.4", "mcu": "teensy-recorder 3"}
BETWEEN_LOGS = timedelta(hours=7)
NATURAL = {
    "bias": "bias",
    "scale": "scale",
    "mis": "misalignment",
    "bt": "bias_slope",
    "st": "scale_slope",
    "curv": "slope_growth",
    "quad": "quadratic",
    "cub": "cubic",
    "gs": "g_sensitivity",
    "bi": "flicker_floor",
    "turn": "turn_on",
    "clock": "clock",
    "nd": "density",
    "offs": "displacement_mm",
}
"""Attributes of a part by their names in the truth."""


def write_case(case, folder, seed_offset=0):
    """Write the logs of a case to `folder`/NAME/*.h5, and return what is true of it.

    A seed gives the same data always.
    """
    readings = Readings(case, seed_offset)
    worlds = readings.worlds()
    sized = size_faults(readings, worlds)
    target = Path(folder) / case.name
    target.mkdir(parents=True, exist_ok=True)
    for path in target.glob("*.h5"):
        path.unlink()
    first_epoch = _first_epoch(readings.key)
    names = case.labels or [f"run_{k + 1}" for k in range(len(worlds))]
    for k, w in enumerate(worlds):
        _, gaps, ppm = readings.poll(k, w)
        rows, events = {}, []
        for a, b, why in gaps:
            if why == "restart":
                time_ns = int(case.logger.stamp(np.array([b]))[0])
                events.append((time_ns, "", "restart", f"logger started again after {b - a:.1f} s"))
        for s in case.sensors:
            rows[s.name], more = _barometer_rows(readings, w, s, k) if s.kind == "baro" else _rows(readings, w, s, k)
            events += more
        epoch = first_epoch + BETWEEN_LOGS * k
        header = {
            "epoch": epoch.isoformat().replace("+00:00", "Z"),
            "source": case.source or SOURCES[case.logger.kind],
            "software": case.software or PROGRAMS[case.logger.kind],
            "config": configuration(case.name, BUSES[case.logger.kind], case.has_multiplexer, case.sensors),
            "has_scales": case.has_scales,
            "has_dimensions": case.has_dimensions,
            "frame_rate_hz": case.logger.rate if case.has_frame_rate else None,
        }
        write_log(
            target / f"{names[k]}.h5",
            header,
            case.sensors,
            rows,
            sorted(events),
            _phases(w, ppm),
            _clocks(w, k, ppm, epoch) if case.has_clocks else None,
            _reference(readings, w, k, ppm),
        )
    return truth_of(readings, worlds, sized, names)


def truth_of(readings, worlds, sized, names):
    """Return what is true of a case as an object of JSON; `names` are those of its logs."""
    case = readings.case
    effects = []
    for x, sd, how in sized:
        effects.append(
            {
                "name": x.name,
                "sensor": x.sensor,
                "axis": x.axis,
                "size": x.size,
                "unit": x.unit,
                "sd": None if sd is None else round(float(sd), 2),
                "sd_how": how,
                "tolerance": x.tolerance,
                "logs": None if x.logs is None else [names[i] for i in x.logs],
                "onset_s": x.onset,
                "duration_s": x.duration,
                "also_acceptable": list(x.also_acceptable),
                "text": x.text or x.mechanism,
                "parameters": {name: value for name, value in x.parameters.items() if not callable(value)},
            }
        )
    truth = {"kind": case.kind, "effects": effects, "description": case.text}
    truth["natural"] = {
        sensor: {
            name: np.round(np.asarray(getattr(part, attribute), float), 6).tolist()
            for name, attribute in NATURAL.items()
        }
        for sensor, part in readings.parts.items()
    }
    truth["logger_ppm"] = [round(readings.poll(k, w)[2], 3) for k, w in enumerate(worlds)]
    return json.loads(json.dumps(truth, default=float))


def status_of(s, d, flags):
    """Return the status of the rows `d` of sensor `s`, as a recorder with these flags knows it."""
    index, counts = d["idx"], d["counts"]
    status = np.zeros(len(index), np.uint16)
    if len(index) == 0:
        return status
    if flags == "full":
        status[np.r_[False, np.diff(index) == 0]] |= STALE
        if s.kind != "mag" and s.chip != "bma180":  # neither has an overrun bit
            status[np.r_[False, np.diff(index) > 1]] |= OVERRUN
    elif flags == "identical":
        status[np.r_[False, np.all(counts[1:] == counts[:-1], axis=1)]] |= STALE
    if flags != "none":
        lo, hi = s.limits
        status[np.any((counts <= lo) | (counts >= hi), axis=1)] |= SATURATED
    return status


def _rows(readings, w, s, k):
    """The rows of an inertial sensor or a magnetometer, and their events."""
    case, events = readings.case, []
    stamp = case.logger.stamp
    d = readings.read(w, s, k, case.faults)
    status = status_of(s, d, case.flags)
    t, counts = d["t"], d["counts"]
    temperature = d["c"].tc
    temperature = None if temperature is None or not s.has_thermometer else temperature[d["idx"]]
    if "lose" in d:
        lose = d["lose"]
        keep = ~lose
        status[np.r_[False, lose[:-1]] & keep] |= AFTER_LOSS
        for i in np.flatnonzero(np.r_[lose[0], lose[1:] & ~lose[:-1]]):
            events.append((int(stamp(t[i : i + 1])[0]), s.name, "lost", "OSError 121: no acknowledge"))
        t, counts, status = t[keep], counts[keep], status[keep]
        temperature = None if temperature is None else temperature[keep]
    rows = {"time": stamp(t), "counts": counts, "status": status}
    if temperature is not None:
        rows["temperature_counts"] = temperature
    return _after_gaps(readings, w, s, k, t, rows, events)


def _barometer_rows(readings, w, s, k):
    """The rows of a barometer, and their events."""
    logger = readings.case.logger
    t = readings.poll(k, w)[0][s.name]
    words, counts, temperature, pressure = read_barometer(w, s, readings.key, k, t)
    rows = {
        "time": logger.stamp(t),
        "counts": counts,
        "temperature": temperature,
        "pressure": pressure,
        "words": words,
        "status": np.zeros(len(t), np.uint16),
        "rate": logger.rate / s.divisor,
    }
    return _after_gaps(readings, w, s, k, t, rows, [])


def _after_gaps(readings, w, s, k, t, rows, events):
    """Flag the rows after the gaps of the recorder."""
    for a, b, why in readings.poll(k, w)[1]:
        i = np.searchsorted(t, b)
        if 0 < i < len(t):
            rows["status"][i] |= AFTER_LOSS | (AFTER_RESTART if why == "restart" else 0)
            if why == "lost":
                events.append((int(rows["time"][i]), s.name, "lost", f"no readings for {b - a:.2f} s"))
    if not np.all(np.diff(rows["time"]) > 0):
        raise ValueError(f"{readings.case.name}, {s.name}: times must increase")
    return rows, events


def _first_epoch(key):
    g = stream(*key, "meta")
    return datetime(
        2013 + int(g.integers(0, 11)),
        int(g.integers(1, 13)),
        int(g.integers(1, 28)),
        int(g.integers(0, 24)),
        int(g.integers(0, 60)),
        int(g.integers(0, 60)),
        int(g.integers(0, 999999)),
        tzinfo=UTC,
    )


def _phases(w, ppm):
    def stamp(time_s):
        return round(max(time_s, 0) * (1 + ppm * 1e-6) * 1e9)

    return [(stamp(start), stamp(min(end, w.dur)), name, up) for start, end, name, up in w.phases]


def _reference(readings, w, k, ppm):
    if w.reference is not None:
        reference = dict(w.reference)
        reference["time"] = np.rint(reference["time"] * (1 + ppm * 1e-6) * 1e9).astype(np.int64)
        return reference
    if not readings.case.has_reference_temperature:
        return None
    time_s = np.arange(0.5, w.dur - 0.5, 1.0)
    g = stream(*readings.key, k, "reftemp")
    return {
        "time": np.rint(time_s * (1 + ppm * 1e-6) * 1e9).astype(np.int64),
        "temperature": np.round(w.at(w.T, time_s) + 0.15 + 0.02 * g.standard_normal(len(time_s)), 2),
    }


def _clocks(w, k, ppm, epoch):
    time_s = np.arange(0, w.dur, 10.0)
    since_boot = int(3.6e12 * (1 + k))
    monotonic = np.rint(time_s * 1e9 * (1 + ppm * 1e-6)).astype(np.int64)
    raw = np.rint(time_s * 1e9 * (1 + (ppm + 11.3) * 1e-6)).astype(np.int64)
    return {
        "time": monotonic,
        "monotonic": monotonic + since_boot,
        "monotonic_raw": raw + since_boot,
        "boottime": monotonic + since_boot + 1200,
        "realtime": monotonic + int(epoch.timestamp() * 1e9),
    }

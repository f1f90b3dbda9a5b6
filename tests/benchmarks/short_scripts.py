"""Scripts as a user writes them first, with numpy, h5py, scipy, matplotlib and mcap, for the result of a command.

`python short_scripts.py NAME LOG OUTPUT` runs one of them in a process (as `commands.py` does). They hold a whole log
in memory, process frames and messages one by one, and check nothing: no flags, no gaps, no times except those of the
first sensor.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Vector = np.ndarray[Any, np.dtype[np.float64]]

_SI = {"specific_force": 9.80665, "angular_rate": float(np.radians(1.0))}


def _read(path: Path) -> tuple[dict[str, dict[str, Vector]], dict[str, Vector]]:
    """Values in SI (n, 3) along the box, and times (n,), by quantity and sensor."""
    values: dict[str, dict[str, Vector]] = {quantity: {} for quantity in _SI}
    times = {}
    with h5py.File(path) as file:
        for name, group in file["sensors"].items():
            quantity = str(group.attrs["quantity"])
            if quantity in values:
                si = group["counts"][:] / float(group.attrs["sensitivity"]) * _SI[quantity]
                values[quantity][name] = si @ np.asarray(group.attrs["orientation"]).T
                times[name] = group["time"][:]
    return values, times


def _write(output: Path, time: Vector, results: dict[str, tuple[Vector, Vector]]) -> None:
    with h5py.File(output, "w") as file:
        file.create_dataset("time", data=time, compression="gzip", shuffle=True)
        for name, (triads, covariances) in results.items():
            file.create_dataset(name, data=triads, compression="gzip", shuffle=True)
            file.create_dataset(f"{name}_covariance", data=covariances, compression="gzip", shuffle=True)


def info(log: Path, output: Path) -> None:
    """Names, rows and attributes."""
    with h5py.File(log) as file:
        for name, group in file["sensors"].items():
            print(name, group["time"].shape[0], dict(group.attrs), group["time"][0], group["time"][-1])


def verify(log: Path, output: Path) -> None:
    """Read everything, which checks HDF5's sums."""
    with h5py.File(log) as file:
        file.visititems(lambda name, item: item[()] if isinstance(item, h5py.Dataset) else None)


def mean(log: Path, output: Path) -> None:
    """The same weight for every axis, frame by frame, with the covariance."""
    _fused(log, output, lambda values: np.ones(values.shape[1]))


def planes(log: Path, output: Path) -> None:
    """Weights by the variance of each axis."""
    _fused(log, output, lambda values: 1 / np.maximum(values.var(axis=0), 1e-12))


def _fused(log: Path, output: Path, weighing: Callable[[Vector], Vector]) -> None:
    values, times = _read(log)
    results = {}
    for quantity, sensors in values.items():
        stacked = np.concatenate(list(sensors.values()), axis=1)
        rows = np.tile(np.eye(3), (len(sensors), 1))
        weights = weighing(stacked)
        gain = np.linalg.solve(rows.T @ (rows * weights[:, None]), (rows * weights[:, None]).T)
        noise = np.diag(np.diff(stacked, axis=0).var(axis=0) / 2)
        triads, covariances = np.empty((len(stacked), 3)), np.empty((len(stacked), 3, 3))
        for index, raw in enumerate(stacked):
            triads[index] = gain @ raw
            covariances[index] = gain @ noise @ gain.T
        results[quantity] = triads, covariances
    _write(output, next(iter(times.values())), results)


def optimal(log: Path, output: Path) -> None:
    """A Kalman filter of the textbook (Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
    navigation", 2001, chapter 5) whose states are the triad, the bias and the drift of every axis, frame by frame.
    """
    values, times = _read(log)
    results = {}
    for quantity, sensors in values.items():
        stacked = np.concatenate(list(sensors.values()), axis=1)
        axes = stacked.shape[1]
        scatter = np.diff(stacked, axis=0).var(axis=0) / 2
        size = 3 + 2 * axes
        seen = np.concatenate([np.tile(np.eye(3), (axes // 3, 1)), np.eye(axes), np.eye(axes)], axis=1)
        left = np.concatenate([np.zeros(3), np.ones(axes), np.full(axes, np.exp(-0.01 / 600))])
        added = np.diag(np.concatenate([np.full(3, 1e4), np.zeros(axes), scatter * 1e-6]))
        state, covariance = np.zeros(size), np.diag(np.concatenate([np.full(3, 1e4), np.ones(axes), scatter]))
        measured, one = np.diag(scatter), np.eye(size)
        triads, covariances = np.empty((len(stacked), 3)), np.empty((len(stacked), 3, 3))
        for index, raw in enumerate(stacked):
            state = left * state
            covariance = left[:, None] * covariance * left + added
            innovation = seen @ covariance @ seen.T + measured
            gain = np.linalg.solve(innovation, seen @ covariance).T
            state = state + gain @ (raw - seen @ state)
            kept = one - gain @ seen
            covariance = kept @ covariance @ kept.T + gain @ measured @ gain.T
            triads[index], covariances[index] = state[:3], covariance[:3, :3]
        results[quantity] = triads, covariances
    _write(output, next(iter(times.values())), results)


def export(log: Path, output: Path) -> None:
    """Every reading as a JSON message, in the order of times, by mcap's writer."""
    from mcap.writer import Writer

    values, times = _read(log)
    with output.open("wb") as file:
        writer = Writer(file)
        writer.start()
        messages = []
        for quantity, sensors in values.items():
            for name, triads in sensors.items():
                schema = writer.register_schema(name, "jsonschema", b'{"type": "object"}')
                channel = writer.register_channel(f"/sensors/{name}", "json", schema)
                messages += [
                    (at, channel, quantity, triad)
                    for at, triad in zip(times[name].tolist(), triads.tolist(), strict=True)
                ]
        with h5py.File(log) as read:
            truth = [read["truth"][name][:].tolist() for name in ("time", *_SI)]
        schema = writer.register_schema("truth", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/truth", "json", schema)
        messages += [(at, channel, "truth", force + rate) for at, force, rate in zip(*truth, strict=True)]
        messages.sort(key=lambda message: message[0])
        for at, channel, quantity, triad in messages:
            stamp = {"sec": at // 1_000_000_000, "nsec": at % 1_000_000_000}
            triads = {"x": triad[0], "y": triad[1], "z": triad[2]}
            data = json.dumps({"timestamp": stamp, "frame_id": "box", quantity: triads}).encode()
            writer.add_message(channel, at, data, at)
        writer.finish()  # type: ignore[no-untyped-call]


def characterise(log: Path, output: Path) -> None:
    """Allan deviation, spectrum, autocorrelation, histogram and a table of every axis, with figures."""
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from scipy.signal import welch

    mpl.use("agg")
    values, times = _read(log)
    output.mkdir(exist_ok=True)
    figures = {name: Figure(figsize=(10, 8)) for name in ("allan", "spectrum", "autocorrelation", "histogram")}
    panels = {name: figure.subplots(2, 1) for name, figure in figures.items()}
    table = {}
    for place, sensors in enumerate(values.values()):
        for name, triads in sensors.items():
            period_s = float(np.median(np.diff(times[name]))) * 1e-9
            for axis, column in zip("xyz", triads.T, strict=True):
                phase = np.concatenate([[0.0], np.cumsum(column - column.mean())]) * period_s
                taus, deviations = [], []
                size = 1
                while size <= len(column) // 4:
                    second = phase[2 * size :] - 2 * phase[size:-size] + phase[: -2 * size]
                    taus.append(size * period_s)
                    deviations.append(float(np.sqrt((second**2).mean() / 2) / (size * period_s)))
                    size *= 2
                frequency, density = welch(column, 1 / period_s, nperseg=4096)
                centred = column - column.mean()
                lags = [float((centred[: len(column) - lag] * centred[lag:]).mean()) for lag in range(51)]
                label = f"{name} {axis}"
                panels["allan"][place].loglog(taus, deviations, label=label)
                panels["spectrum"][place].loglog(frequency[1:], density[1:], label=label)
                panels["autocorrelation"][place].plot(lags, label=label)
                panels["histogram"][place].hist(column, bins=100, histtype="step", label=label)
                table[label] = [float(column.mean()), float(column.std()), taus, deviations]
    for name, figure in figures.items():
        for panel in panels[name]:
            panel.legend(fontsize=6)
        figure.savefig(output / f"{name}.png")
    (output / "table.json").write_text(json.dumps(table))


def simulate(log: Path, output: Path) -> None:
    """As many frames of nine triads as the log has: white noise and a Gauss-Markov bias about gravity, as counts."""
    from scipy.signal import lfilter

    with h5py.File(log) as read, h5py.File(output, "w") as file:
        rng = np.random.default_rng(0)
        for name, group in read["sensors"].items():
            rows = group["time"].shape[0]
            noise = rng.normal(0, 5, (rows, 3))
            wander = lfilter([1.0], [1.0, -0.9999], rng.normal(0, 0.01, (rows, 3)), axis=0)
            counts = np.clip(np.rint(100 + noise + wander), -32768, 32767).astype(np.int16)
            made = file.create_group(f"sensors/{name}")
            for column, data in (
                ("time", np.arange(rows) * 10_000_000),
                ("counts", counts),
                ("status", np.zeros(rows, np.uint16)),
            ):
                made.create_dataset(column, data=data, compression="gzip", shuffle=True, fletcher32=True)
        rows = read["truth/time"].shape[0]
        for column, width in (("time", 0), ("specific_force", 3), ("angular_rate", 3), ("temperature", 0)):
            data = np.zeros((rows, width) if width else rows)
            file.create_dataset(f"truth/{column}", data=data, compression="gzip", shuffle=True)


SCRIPTS: dict[str, Callable[[Path, Path], None]] = {
    "info": info,
    "verify": verify,
    "mean": mean,
    "planes": planes,
    "optimal": optimal,
    "export": export,
    "characterise": characterise,
    "simulate": simulate,
}

if __name__ == "__main__":
    SCRIPTS[sys.argv[1]](Path(sys.argv[2]), Path(sys.argv[3]))

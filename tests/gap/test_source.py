"""Rows of a log and of the simulation that wrote it are the same rows, with the same statistics."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.array import parse_array
from imuarray.gap.recording.recordings import reference_of
from imuarray.gap.recording.source import (
    DOUBTFUL,
    RecordedSource,
    RowFilter,
    SimulatedSource,
    Source,
    simulated_sources,
)
from imuarray.gap.statistics.campaign import Campaign, summarise_log
from imuarray.gap.statistics.catalogue import statistics
from imuarray.log import open_log
from imuarray.log.format import OVERRUN, STALE
from imuarray.log.writer import Block
from imuarray.simulate import Simulation, plan_of, write_log
from imuarray.simulate.effects.readings import ChannelSwap, StaleSamples
from imuarray.simulate.effects.timing import DroppedSamples
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.motion.tumble import Tumble
from imuarray.simulate.sensor import SimulatedSensor
from tests.gap.small_campaign import BASE, RATE_HZ, OneBlock, block, campaign_of, header, phases_of, simulation
from tests.selection import some

TUMBLE = Tumble(10.0, 1.0)


def joined(blocks: list[Block]) -> list[np.ndarray]:
    columns = zip(*((item.time, item.counts, item.status, item.temperature_counts) for item in blocks), strict=True)
    return [np.concatenate(column) for column in columns]


def sources_of(path: Path, dropped: float = 0.0) -> tuple[dict[str, Source], Path]:
    made = simulation(TUMBLE, {name: (DroppedSamples(dropped),) for name in BASE} if dropped else {}, seed=3)
    write_log(made, path)
    return simulated_sources(made), path


@pytest.mark.parametrize("dropped", some([0.0, 0.05], 1))
def test_blocks_of_log_and_simulation_are_equal(tmp_path: Path, dropped: float) -> None:
    simulated, path = sources_of(tmp_path / "log.h5", dropped)
    with open_log(path) as log:
        for name, source in simulated.items():
            recorded = RecordedSource(log[name])
            assert recorded.header == source.header
            for start_s, end_s in ((0.0, 76.0), (3.003, 41.0), (75.0, 200.0)):
                span = (round(start_s * 1e9), round(end_s * 1e9))
                ours, theirs = joined(list(source.blocks(*span))), joined(list(recorded.blocks(*span)))
                for mine, other in zip(ours, theirs, strict=True):
                    np.testing.assert_array_equal(mine, other)
                assert ours[0].min() >= span[0]
                assert ours[0].max() < span[1]
                assert recorded.rows(*span) == len(ours[0])


def test_flags_of_repeated_rows_need_equal_counts(tmp_path: Path) -> None:
    """The flags of repeated rows are kept with the counts of another sensor, most of which differ from the previous
    ones: they give no information, in a log and in a simulation.
    """
    effects = {"G1": (StaleSamples(0.2), ChannelSwap("G2", "counts"))}
    made = simulation(TUMBLE, effects, seed=3)
    write_log(made, tmp_path / "log.h5")
    span = (0, round(TUMBLE.seconds * 1e9))
    with open_log(tmp_path / "log.h5") as log:
        _, _, recorded, _ = joined(list(RecordedSource(log["G1"]).blocks(*span)))
        flagged = np.asarray(log["G1"].status[:]) & STALE
    _, _, simulated, _ = joined(list(simulated_sources(made)["G1"].blocks(*span)))
    assert np.count_nonzero(flagged) > 400
    assert np.count_nonzero(recorded & STALE) < 0.2 * np.count_nonzero(flagged)
    np.testing.assert_array_equal(simulated[1:], recorded[1:])


@pytest.mark.parametrize(
    ("uncertain_ns", "expected_ns"),
    [
        ([5, 1000], [10, 20, 20, 30]),
        ([10, 20, 25], [30]),
        ([30], [10, 20, 20]),
        ([10, 20, 30], []),
        ([], [10, 20, 20, 30]),
    ],
)
def test_rows_at_uncertain_times_are_left_out(uncertain_ns: list[int], expected_ns: list[int]) -> None:
    """Also two rows with the same time."""
    rows = block([1, 2, 3, 4], time=np.array([10, 20, 20, 30]))
    blocks = RowFilter(OneBlock(header(), rows), np.array(uncertain_ns, np.int64)).blocks(0, 100)
    assert [at for rows in blocks for at in rows.time.tolist()] == expected_ns


@pytest.mark.slow
def test_statistics_of_log_and_simulation_are_equal(tmp_path: Path) -> None:
    """To rounding: the log's blocks are the simulator's chunks."""
    simulated, path = sources_of(tmp_path / "log.h5")
    reference = reference_of(TUMBLE)
    one = statistics(Campaign((summarise_log("tumble", simulated, phases_of(TUMBLE), reference),)))
    with open_log(path) as log:
        recorded = {name: RecordedSource(sensor) for name, sensor in log.sensors.items() if sensor.is_triad}
        other = statistics(Campaign((summarise_log("tumble", recorded, log.phases, reference),)))
    assert one.keys == other.keys
    np.testing.assert_allclose(one.values, other.values, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(one.resolutions, other.resolutions)
    assert np.isfinite(one.values).mean() > 0.85


def test_a_simulation_counts_lost_rows() -> None:
    made = simulation(Still(seconds=20), {"A1": (DroppedSamples(0.2),)}, seed=1)
    sensor = made.sensors["A1"]
    assert isinstance(sensor, SimulatedSensor)
    source = SimulatedSource(sensor)
    assert source.rows(0, 20 * 10**9) == 20 * RATE_HZ
    assert sum(len(item.time) for item in source.blocks(0, 20 * 10**9)) == 2000 - len(sensor.lost_rows(0, 2000))


def test_blocks_are_neither_empty_nor_long() -> None:
    made = simulation(Still(seconds=400), {"A1": (DroppedSamples(0.9, 40.0),)}, seed=1)
    sensor = made.sensors["A1"]
    assert isinstance(sensor, SimulatedSensor)
    lengths = [len(item.time) for item in SimulatedSource(sensor).blocks(10**9, 399 * 10**9)]
    assert lengths
    assert 0 < min(lengths) <= max(lengths) <= 16384
    assert list(SimulatedSource(sensor).blocks(500 * 10**9, 600 * 10**9)) == []


def test_a_barometer_has_no_axes(tmp_path: Path) -> None:
    array = parse_array(
        '[array]\nname = "one"\nbus = "i2c:/dev/i2c-1"\n[[sensor]]\nname = "P"\nchip = "bmp180"\naddress = 0x77\n'
    )
    made = Simulation(plan_of(array, 20.0, 2.0), Still(seconds=2), {})
    assert simulated_sources(made) == {}
    write_log(made, tmp_path / "log.h5")
    with open_log(tmp_path / "log.h5") as log, pytest.raises(ValueError, match="no three axes"):
        RecordedSource(log["P"])


@pytest.mark.slow
def test_the_same_seed_gives_the_same_rows_and_another_does_not() -> None:
    first, again, other = (statistics(campaign_of("motion", seed=seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.values, again.values)
    assert first.keys == other.keys
    assert not np.array_equal(first.values, other.values, equal_nan=True)


def test_flags_of_equal_rows_of_a_magnetometer_make_no_difference(tmp_path: Path) -> None:
    """A recorder cannot detect whether a reading of an HMC5883L is new (no driver reads its ready bit): some flag a row
    that equals the previous one, others none.
    """
    array = parse_array(
        '[array]\nname = "one"\nbus = "i2c:/dev/i2c-1"\n[[sensor]]\nname = "M"\nchip = "hmc5883l"\n'
        "address = 0x1E\nrange = 1.3\n"
    )
    made = Simulation(plan_of(array, 20.0, 5.0), Still(seconds=5), {})  # without noise all rows are equal
    paths = [tmp_path / "flagged.h5", tmp_path / "unflagged.h5"]
    for path in paths:
        write_log(made, path)
    with h5py.File(paths[1], "r+") as file:
        status = file["sensors/M/status"]
        assert np.count_nonzero(status[:] & 1) == len(status) - 1
        status[:] &= ~np.uint16(1)
    span = (0, 5 * 10**9)
    with open_log(paths[0]) as flagged, open_log(paths[1]) as unflagged:
        sources = (RecordedSource(flagged["M"]), RecordedSource(unflagged["M"]), simulated_sources(made)["M"])
        for source in sources:
            blocks = list(source.blocks(*span))
            counts = np.concatenate([block.counts for block in blocks])
            assert len(counts) > 90
            assert (counts == counts[0]).all()
            assert not np.concatenate([block.status for block in blocks]).any()


def test_a_flagged_row_that_differs_from_the_previous_is_a_new_reading(tmp_path: Path) -> None:
    """Of rows 5, 6 and 7, all flagged as no new reading, row 6 alone equals the previous row."""
    path = tmp_path / "log.h5"
    write_log(simulation(Still(seconds=2), {}, seed=1), path)
    with h5py.File(path, "r+") as file:
        rows = file["sensors/A1"]
        counts, status = rows["counts"][:], rows["status"][:]
        counts[:10] = np.arange(10)[:, None]
        counts[6] = counts[5]
        status[:] = 0
        status[5:8] = 1
        rows["counts"][:], rows["status"][:] = counts, status
    with open_log(path) as log:
        source = RecordedSource(log["A1"])
        for start_ns in (0, int(log["A1"].time[6])):  # the row before the first requested row is used too
            blocks = list(source.blocks(start_ns, 2 * 10**9))
            times = np.concatenate([block.time for block in blocks])
            is_stale = np.concatenate([block.status for block in blocks]) & 1 != 0
            np.testing.assert_array_equal(times[is_stale], [log["A1"].time[6]])


def test_an_overrun_next_to_a_reading_in_progress_is_not_a_loss(tmp_path: Path) -> None:
    """Row 6 differs although it is flagged as no new reading: its neighbours are flagged as overrun, and no reading was
    lost. A reading was lost before row 20.
    """
    path = tmp_path / "log.h5"
    write_log(simulation(Still(seconds=2), {}, seed=1), path)
    with h5py.File(path, "r+") as file:
        rows = file["sensors/A1"]
        counts, status = rows["counts"][:], rows["status"][:]
        counts[:30] = np.arange(30)[:, None]
        status[:] = 0
        status[6] = STALE
        status[[5, 7, 20]] = OVERRUN
        rows["counts"][:], rows["status"][:] = counts, status
    with open_log(path) as log:
        blocks = list(RecordedSource(log["A1"]).blocks(0, 2 * 10**9))
        flags = np.concatenate([block.status for block in blocks])
    assert np.flatnonzero(flags & (0xFFFF - DOUBTFUL)).tolist() == [20]
    assert np.flatnonzero(flags & DOUBTFUL).tolist() == [6]
    assert flags[20] == OVERRUN

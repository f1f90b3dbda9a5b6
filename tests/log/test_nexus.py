"""The path of NeXus viewers (silx, h5web) in a log: default to default to a group that names signal and axes."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.errors import LogError
from imuarray.log import open_log


def default(file: h5py.File) -> h5py.Group:
    """As the NeXus manual finds what to plot ("Find the plottable data", version 3)."""
    group = file
    while "default" in group.attrs:
        group = group[group.attrs["default"]]
    return group


def test_the_first_plot_is_the_first_triad(small: Path) -> None:
    with h5py.File(small) as file:
        assert file.attrs["NX_class"] == "NXroot"
        plot = default(file)
        assert (plot.attrs["NX_class"], plot.name) == ("NXdata", "/plots/Acc")
        assert plot[plot.attrs["signal"]] == file["sensors/Acc/counts"]
        assert list(plot.attrs["axes"]) == ["time", "."]
        assert plot["time"] == file["sensors/Acc/time"]


def test_every_nxdata_group_is_valid(small: Path) -> None:
    """A signal that exists, an axis for each of its dimensions, each as long as that; others of its shape."""
    with h5py.File(small) as file:
        result = [file["truth"], *file["plots"].values()]
        assert len(result) == 4
        for group in result:
            signal = group[group.attrs["signal"]]
            axes = list(group.attrs["axes"])
            assert len(axes) == signal.ndim
            assert all(
                group[axis].shape == (length,) for axis, length in zip(axes, signal.shape, strict=True) if axis != "."
            )
            assert all(group[name].shape == signal.shape for name in group.attrs.get("auxiliary_signals", ()))
        others = [group for group in file["sensors"].values() if group.attrs["NX_class"] == "NXdata"]
        assert others == []  # its `axes` are the box's: no columns


@pytest.mark.slow  # silx brings 200 MB of filters
def test_silx_plots_it(small: Path) -> None:
    nxdata = pytest.importorskip("silx.io.nxdata")
    opened = pytest.importorskip("silx.io").open
    with opened(str(small)) as file:
        plot = nxdata.get_default(file)
        assert plot.is_valid
        assert np.asarray(plot.signal).tolist() == [[512, -256, 0], [-8192, 8191, 1], [0, 0, 0], [1, 2, 3], [4, 5, 6]]
        assert np.asarray(plot.axes[0]).tolist() == [0, 10_000_000, 20_000_000, 30_000_000, 40_000_000]
        assert nxdata.NXdata(file["plots/Baro"]).issues == []
        truth = nxdata.NXdata(file["truth"])
        assert (truth.issues, truth.auxiliary_signals_names) == ([], ["angular_rate"])


@pytest.mark.parametrize(
    ("place", "target"),
    [
        ("plots/Acc/status", "/sensors/Acc/counts"),  # another column than its name
        ("plots/Acc/status", "/sensors/Gyro/status"),
        ("plots/Acc/status", "/plots/Acc/status"),
        ("plots/Acc/status", "sensors/Acc/status"),
        ("plots/status", "/sensors/status"),
        ("plots/more/Acc/status", "/sensors/Acc/status"),
        ("sensors/Acc/more", "/sensors/Acc/counts"),
        ("others/Acc/status", "/sensors/Acc/status"),
    ],
)
def test_other_links_are_refused(small: Path, place: str, target: str) -> None:
    with h5py.File(small, "r+") as file:
        file[place] = h5py.SoftLink(target)
    with pytest.raises(LogError, match=f"{place}: a link to another place"):
        open_log(small)


def test_the_allowed_links_are_not_followed(small: Path) -> None:
    """They are never followed: a link to a missing column does not affect reading."""
    with h5py.File(small, "r+") as file:
        file["plots/Acc/temperature"] = h5py.SoftLink("/sensors/Acc/temperature")
        file["plots/Nobody/counts"] = h5py.SoftLink("/sensors/Nobody/counts")
        file["plots/Acc/out"] = h5py.ExternalLink("/etc/passwd", "/x")
    with pytest.raises(LogError, match="plots/Acc/out: a link to another place"):
        open_log(small)
    with h5py.File(small, "r+") as file:
        del file["plots/Acc/out"]
    with open_log(small) as log:
        assert list(log.sensors) == ["Acc", "Baro", "Gyro"]


@pytest.mark.slow
def test_xarray_opens_the_whole_log(small: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    with xarray.open_datatree(small, engine="h5netcdf", phony_dims="sort") as tree:
        assert tree["sensors/Acc"]["counts"].shape == (5, 3)

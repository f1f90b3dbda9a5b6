"""What was meant by a misspelt word."""

from __future__ import annotations

import pytest

from imuarray.errors import FusionError
from imuarray.fuse.pipeline import QuantityPipeline
from imuarray.spelling import guess


def test_the_nearest_word_or_none() -> None:
    assert guess("calibrat", ["detect", "calibrate"]) == "; did you mean calibrate?"
    assert guess("xyzzy", ["detect", "calibrate"]) == ""


def test_a_technique() -> None:
    with pytest.raises(FusionError, match=r"^technique 'oposed': allowed are mean, .*; did you mean opposed\?$"):
        QuantityPipeline({}, "oposed")

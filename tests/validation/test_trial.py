"""The model with an extra effect."""

from __future__ import annotations

import pytest

from imuarray.gap.model.populations import usual_model
from imuarray.simulate.streams import Streams
from imuarray.validation.bench import CHIPS
from imuarray.validation.plans import EXTRAS
from imuarray.validation.trial import model_with
from tests.gap.small_campaign import header


@pytest.mark.parametrize("extra", EXTRAS, ids=lambda extra: extra["effect"])
def test_one_sensor_has_one_effect_more_than_the_usual_model(extra: dict[str, str]) -> None:
    headers = [header(name, chip=chip) for name, chip in CHIPS.items()]
    extra = {**extra, "sensor": next(name for name, chip in CHIPS.items() if chip == extra["chip"])}
    model, usual = model_with(extra, headers), usual_model(headers)
    for sensor_header in headers:
        known = {effect.name for effect in usual.effects(sensor_header, Streams(1))}
        added = [extra["effect"]] if sensor_header.name == extra["sensor"] and extra["effect"] not in known else []
        names = [effect.name for effect in model.effects(sensor_header, Streams(1))]
        assert sorted(names) == sorted([*(effect.name for effect in usual.effects(sensor_header, Streams(1))), *added])

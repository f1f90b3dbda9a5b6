"""The state of the search for a unit (a sensor, or a family): its model, the model's statistics, and the recorded
ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.model.base_model import FittedParameters
from imuarray.gap.model.replication import Models, SensorModel
from imuarray.gap.statistics.synthetic_likelihood import (
    FORM,
    FREEDOM,
    SyntheticLikelihood,
    independent_share,
    likelihood_of,
)
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.readings import ChannelSwap

Unit = tuple[str, ...]
"""Names of sensors that are searched together."""

FitsOfReplicates = Sequence[Mapping[str, FittedParameters]]
"""Parameters fitted to replicates, sensor by sensor."""

REPLICATES = 8
"""Number of replicates by which a refined trial is judged."""

LOOKS = 2
"""Number of the first of these replicates, by which a guess is ranked and refined."""

NUMBERS = range(REPLICATES)
"""The numbers of these replicates: the first of the null distribution, so that those of the base model are known."""


@dataclass(frozen=True)
class UnitState:
    """The state of a unit with its present `models`.

    `real` (n,): statistics of the recording; `likelihood`: that of the models; `values` (r, n): statistics in the
    replicates `NUMBERS`, by which changes are compared; `target`: the parameters fitted to the recording;
    `independent`: the independent share of the statistics; `other_models`: those of other sensors, on which statistics
    of motion depend. `probes` (n,) numbers the probes, whose statistics change together, and `scatter_group` (n,) the
    groups of one axis and kind of log, which have the same scatter (None: unknown). `misfit` is the loss in nats due to
    the models' noise. `separate_share` (n,) is the independent share of the statistics that depend on few others (None:
    no statistic does).
    """

    unit: Unit
    models: Models
    real: Floats
    likelihood: SyntheticLikelihood
    values: Floats
    target: Mapping[str, FittedParameters]
    independent: float
    other_models: Models = field(default_factory=dict)
    probes: Indices | None = field(default=None, repr=False)
    scatter_group: Indices | None = field(default=None, repr=False)
    misfit: float = 0.0
    separate_share: Floats | None = field(default=None, repr=False)

    @property
    def weight(self) -> Floats | float:
        """Weight (n,) of each statistic: the independent share of all statistics, or that of the separate ones."""
        return self.independent if self.separate_share is None else np.fmax(self.separate_share, self.independent)

    @property
    def scores(self) -> Floats:
        """Scores (n,) of the recording under the present models."""
        return self.likelihood.scores(self.real)

    def changed(self, trial: Hypothesis) -> Models:
        """Return the models after the trial: its change of each sensor, or of its own sensor, and the opposite change
        of the others.
        """
        effects = dict.fromkeys(trial.others if trial.opposite else (), trial.opposite)
        if trial.sensor:
            effects[trial.sensor] = trial.effects
        else:
            effects.update(dict.fromkeys(trial.members or self.models, trial.effects))
        opposite = replace(trial, fitted=trial.opposite_fitted)
        return {
            name: _changed(model, replace(opposite if name in trial.others else trial, effects=effects[name]))
            if name in effects
            else model
            for name, model in self.models.items()
        }

    def settled(
        self, models: Models, fits: FitsOfReplicates, before: tuple[Models, FitsOfReplicates] | None = None
    ) -> Models:
        """Return `models` with ordinary parameters corrected by the difference between the recording's fit and the
        `fits` of their replicates; by these and the fits of the models `before`, if given. The parameters of a sensor
        that reads another's data have no effect and stay.
        """
        return {name: self._settled(name, model, fits, before) for name, model in models.items()}

    def _settled(
        self, name: str, model: SensorModel, fits: FitsOfReplicates, before: tuple[Models, FitsOfReplicates] | None
    ) -> SensorModel:
        if reads_another(model):
            return model
        simulated = [fitted[name] for fitted in fits]
        if before is None:
            return replace(model, fitted=model.fitted.moved(self.target[name], simulated))
        models, fits_before = before
        last = models[name].fitted, [fitted[name] for fitted in fits_before]
        return replace(model, fitted=model.fitted.between(self.target[name], simulated, *last))

    def misfit_of(self, headers: Mapping[str, SensorHeader], fits: FitsOfReplicates) -> float:
        """Return the loss in nats of models whose replicates' `fits` have another noise than the recording's:
        statistics relative to the noise do not distinguish a line from one of twice its amplitude.
        """
        lost = 0.0
        for name, target in self.target.items():
            square = np.mean([np.square(fitted[name].noise(headers[name])) for fitted in fits], axis=0)
            deviation = np.log(square / np.square(target.noise(headers[name]))) / 2 / _NOISE_SURE
            lost += float((FREEDOM + 1) / 2 * np.log1p(np.square(deviation) / FREEDOM).sum())
        return lost


def reads_another(model: SensorModel) -> bool:
    """Return whether a sensor always has another's data, so that its own data never show."""
    return any(
        isinstance(effect, ChannelSwap) and effect.kind != "place" and not effect.spans for effect in model.added
    )


def _changed(model: SensorModel, trial: Hypothesis) -> SensorModel:
    remaining = tuple(effect for effect in model.added if effect.name != trial.removed)
    removed = model.removed | ({trial.removed} if trial.removed else set())
    fitted = model.fitted if trial.fitted is None else trial.fitted
    return replace(model, fitted=fitted, added=(*remaining, *trial.effects), removed=removed)


def update_likelihood(standing: UnitState, values: Floats) -> tuple[SyntheticLikelihood, Floats]:
    """Return the likelihood after a change, and the shift (n,) of each statistic, from its replicates (r, n) and the
    first r of those without it. Both use the same draws, so a few replicates suffice.
    """
    before, without = standing.likelihood, standing.values[: len(values)]
    shifts, has_value = values - without, np.isfinite(values)
    if standing.probes is not None:
        shifts = shifts * _kept(shifts / before.scale, standing.probes)
    known = np.isfinite(shifts).any(axis=0)
    shift = np.zeros(shifts.shape[1])
    shift[known] = np.nanmean(shifts[:, known], axis=0)
    location, scale = before.location + shift, before.scale.copy()
    scatter_group = None if standing.scatter_group is None else standing.scatter_group[known]
    ratio = _spread_ratio(values[:, known], without[:, known], before.scale[known], scatter_group)
    scale[known] *= ratio
    # if a change removes the scatter, as a delay that exceeds the noise does, the values before it do not matter (a
    # control variate with a weight of at most the ratio)
    weight, straight = np.minimum(ratio, 1.0), np.nanmean(values[:, known], axis=0)
    paired = weight * location[known] + (1 - weight) * straight
    location[known] = np.where(np.isfinite(location[known]), paired, location[known])
    if len(values) >= _PAIRS:  # a statistic that no longer scatters has its present value
        least = np.fmax(_SAME * (1 + np.abs(values).max(axis=0)), least_scale(before))
        same = has_value.all(axis=0) & (np.ptp(values, axis=0) < least)
        location[same] = values[:, same].mean(axis=0)
    scale = np.fmax(np.fmax(scale, _SAME * (1 + np.abs(location))), least_scale(before))
    fresh = has_value.all(axis=0) & ~np.isfinite(before.location)  # has values only after the change
    alone = likelihood_of(values[:, fresh], np.zeros(int(fresh.sum())))
    location[fresh] = alone.location
    scale[fresh] = np.fmax(alone.scale, _UNSURE * (1 + np.abs(alone.location)))
    missing_in_both = ~has_value.any(axis=0) & ~np.isfinite(without).any(
        axis=0
    )  # as statistics that are shared with sensors outside the unit
    never = ~has_value.any(axis=0) & ~missing_in_both
    location[never & before.always] = np.nan
    always = (before.always & (has_value.all(axis=0) | missing_in_both)) | fresh
    silent = np.asarray((never & before.always) | (~has_value.any(axis=0) & before.never))
    return SyntheticLikelihood(location, scale, np.asarray(always), silent, *_branched(before, shifts, shift)), shift


def _branched(before: SyntheticLikelihood, shifts: Floats, shift: Floats) -> tuple[Floats, Floats]:
    """Return the outcomes (k, n) of each replicate, added to the branches of the effects before, and their scatter
    (n,). A replicate without the change gets the mean shift.
    """
    if before.branches is None or before.width is None:
        return before.location + shifts, before.scale
    mean_shifts = np.broadcast_to(shift, (max(0, len(before.branches) - len(shifts)), len(shift)))
    return before.branches + np.concatenate([shifts, mean_shifts])[: len(before.branches)], before.width


def least_scale(before: SyntheticLikelihood) -> Floats:
    """Return the least scale (n,) under a model with more effects. If a single event dominates chance, no statistic is
    known more precisely than the form of the event.
    """
    return FORM * before.scale


def gains_of(standing: UnitState, likelihood: SyntheticLikelihood, shift: Floats) -> Floats:
    """Return the log-likelihood ratio (n,) of each recorded statistic due to a change, in nats; they add up."""
    before = standing.likelihood.log_density(standing.real)
    return standing.weight * (likelihood.log_density(standing.real, shift) - before)


def affected_mask(before: SyntheticLikelihood, likelihood: SyntheticLikelihood, shift: Floats) -> Booleans:
    """Return the mask (n,) of the statistics that a change shifts, widens or narrows beyond chance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        widened = np.abs(np.log(likelihood.scale / before.scale)) > _WIDER
    return np.asarray((np.abs(shift) > before.scale) | widened)


def counts_of(standing: UnitState, likelihood: SyntheticLikelihood, shift: Floats) -> float:
    """Return the factor, at least 1, of the gain of a change whose statistics are more independent than those of the
    whole unit.

    The few statistics that a curved response shifts are independent, even if hundreds of levels are not. A change that
    shifts many statistics for one reason counts less when it is judged.
    """
    touched = affected_mask(standing.likelihood, likelihood, shift)
    if not touched.any() or len(standing.values) < _PAIRS:
        return 1.0
    share = independent_share(standing.likelihood.scores(standing.values)[:, touched])
    return max(share / standing.independent, 1.0)


def _kept(shifts: Floats, probes: Indices) -> Floats:
    """Return the share (n,) of each statistic's shift (r, n), in standard deviations, that the change caused.

    If a change alters the random draws, pairs differ by chance alone. Its contribution to the mean of r pairs follows
    from their scatter, for all statistics of a probe together (empirical Bayes: Efron and Morris, J. Am. Stat. Assoc.
    68, 1973).
    """
    known = np.isfinite(shifts).all(axis=0)
    share = np.ones(shifts.shape[1])
    for probe in np.unique(probes[known]) if len(shifts) > 1 else ():
        probe_shifts = shifts[:, known & (probes == probe)]
        by_chance = min(float(probe_shifts.var(axis=0, ddof=1).mean()), _INDEPENDENT) / len(probe_shifts)
        square = float((probe_shifts.mean(axis=0) ** 2).mean())
        share[probes == probe] = max(0.0, 1 - by_chance / square) if square > 0 else 0.0
    return share


def _spread_ratio(values: Floats, without: Floats, scale: Floats, scatter_group: Indices | None = None) -> Floats:
    """Return the ratio (n,) by which a change widens or narrows the scatter, from replicates with and without it.

    If pairs are close even a few replicates determine it; the log of the ratio is shrunk by its uncertainty, which
    follows from the correlation of the pairs. Few pairs determine only the excess of their differences over independent
    ones.
    """
    if len(values) < _PAIRS:
        added = _added((values - without) / scale, scatter_group)
        return np.asarray(np.sqrt(1.0 + np.maximum(added - _INDEPENDENT, 0.0)))
    spreads = [np.nanstd(side, axis=0) for side in (values, without)]
    usable = (spreads[0] > 0) & (spreads[1] > 0) & np.isfinite(scale)
    ratio = np.ones(values.shape[1])
    first, second = spreads[0][usable], spreads[1][usable]
    log_ratio = np.log(first / second)
    deviation = np.nanvar(values[:, usable] - without[:, usable], axis=0)
    together = np.clip((first**2 + second**2 - deviation) / (2 * first * second), -1.0, 1.0)
    variance = (1 - together**2) / (len(values) - 1)
    ratio[usable] = np.exp(log_ratio * log_ratio**2 / (log_ratio**2 + 2 * variance + _TINY))
    return ratio


def _added(shifts: Floats, scatter_group: Indices | None) -> Floats:
    """Return (n,) the variance of the shifts (r, n) of few replicates, in standard deviations; 0 for a single
    replicate.

    Two shifts that agree by chance do not determine the variance. Each variance is combined with the mean of its group,
    which counts as `_LIKE_IT` more replicates (Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004).
    """
    freedom = np.isfinite(shifts).sum(axis=0) - 1
    variance = np.zeros(shifts.shape[1])
    several = freedom > 0
    variance[several] = np.nanvar(shifts[:, several], axis=0, ddof=1)
    touched = several & (variance > 0)  # the part that is not simulated has no shifts
    for group in np.unique(scatter_group[touched]) if scatter_group is not None else ():
        is_in_group = touched & (scatter_group == group)
        variance[is_in_group] = (
            freedom[is_in_group] * variance[is_in_group] + _LIKE_IT * variance[is_in_group].mean()
        ) / (freedom[is_in_group] + _LIKE_IT)
    return variance


_NOISE_SURE = 0.05
"""Relative error of a noise, due to its fit and its form."""

_PAIRS = 6
_INDEPENDENT = 2.0
"""Variance of the difference of two independent readings of variance 1."""

_LIKE_IT = 4.0
_WIDER = 0.3
_UNSURE = 0.1
_TINY = 1e-12
_SAME = 1e-9

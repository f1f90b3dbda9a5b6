"""Diagnosis of the gap between a simulator and recordings of an inertial sensor array.

The model
---------
A **recording** x is a campaign of logs of one array: times, raw counts and flags of each triad, with phases, tracks
and temperatures if the logs contain them. A **simulator** makes recordings of the same form from

* **fitted parameters** theta: noise, bias, linear thermal slope of the bias (one steeper than that of any part is an
  effect), and the chip's own filter. Each replicate draws the cutoff of the filter within the uncertainty that the rows
  leave. The noise of half of the replicates has the measured correlations instead, since no fitted filter has exactly
  the form of the chip's. If the correlations fit no filter, the noise of all replicates has them;
* **nuisance parameters** nu: properties of a unit that a data sheet does not specify, each with a tolerance
  (`model.populations`). The following are profiled within their tolerances: scale error, misalignment, g-sensitivity
  and tilt of the box; the lag of an element behind the temperature of the box, up to the lag of the dies by their own
  thermometers if that is longer than usual (`model.element_temperature`); the delay of a signal in a chip's filter and
  in its decimation, and the offset of the times of rows due to a queue, or between the clocks of the sensors and of a
  track (`model.signal_delay`); lines of the surroundings, which several sensors of a quantity measure alike, faint
  lines of accelerometers that the others together would not show, and the mains that the wires of a single sensor pick
  up (`model.ambient_lines`); and broad vibrations of the surroundings at rest, by cross-spectra of the sensors and by
  the excess of their spectra over those in the quietest parts (`recording.vibration`). The following are drawn anew for
  every replicate: the course of a vibration, the phase and rate of the data clock (`model.data_clock`), the scatter of
  biases from one power-on to the next, the position of an accelerometer, nonlinearity, the slope of the scale over
  temperature, the curvature of a bias over temperature, slopes that the temperatures of the recording do not determine,
  usual flicker in long phases, a bias that all accelerometers have in common, and the course of an unrecorded room
  temperature (`model.room_temperature`). Their estimates are reported as **pulls**, value over tolerance
  (`model.nuisance`), and are not causes;
* **effects** e with parameters eta, a place (sensor, axes, family or all) and a time (always, from a moment on, in
  some logs, in stretches): the simulator may lack an effect that the sensors have, or have one that they lack
  (`inference.effects`).

**Statistics** s(x) are some 80 numbers for each axis and phase (`statistics.probes`), of the residuals of the fit,
never of raw samples. Each is defined so that it scatters nearly normally without a gap. In motion a sensor is compared
with the others of its quantity, and with fewer than two others also with the track of the log, without the noise of the
track at rest (`simulate.motion.track_noise`). A drift of the sensors' common clock from the track's shows as a growing
delay of one sensor. The following are left out: rows in which a filter settles after power-on, the ends of a rest in
which the box still moves, and moments at which several sensors are restless or measure a knock (`recording.quiet`), as
with a hand, keystrokes, motors that start, or a box that is set down. A few readings that the logger reports as lost
are the recorder's, as is one in ten thousand that is missing without a report (`recording.recorder_gaps`). Rests in
which all sensors are much noisier than in another one are left out too. Without a track the motion is estimated from
the sensors together (`recording.movement`), unless the box vibrates faster than the rows show. Turns between noted
rests are motions too, with the attitudes at their beginning and end from gravity (`recording.turns`), and so are long
stretches between detected rests. A statistic that one side lacks is missing: it has no score.

**Null distribution.** The gap is judged by parametric bootstrap: replicates x* ~ p(x | theta_hat, nu*), with nu* drawn
from its population and theta fitted again to each. It thus includes the uncertainty of the fit and of the unit.

**Normal scores** (`statistics.tails`). Scores of levels and of rare rows have heavy tails, and would be the largest of
all scores. Each score is replaced by the normal deviate with the same tail probability, by a tail of Student's t that
is fitted to the replicates; the scores of each replicate are converted with the tails of the others. If more scores
are far beyond this tail, such as those of stale rows that a few replicates have, they have an exponential tail.

**Motions without an instrument** are estimated from the sensors themselves (`recording.movement`), less the noise of
their mean. The mean is a robust one (Huber) of the readings without the rotational forces at the noted positions. Where
the readings change faster than their rows resolve, as in a hand, the response of a sensor depends on the moments of its
rows: sensors are then compared in longer windows, and differences count only beyond wide margins.

**Pooled scores** (`statistics.pooled`). The norm of the amounts by which the normal scores of a sensor exceed one
standard deviation is formed for each log and for all logs, and compared with chance like a single score: an effect that
changes tens of statistics a little is significant there before it is in a single one. The scores of a response to
motion, which a delay or another position shifts alike on all axes, and those of slow changes, over temperature and of
turn-on series are also summed over the axes of a sensor. Each domain of statistics has the same share of the level, and
pools and sums a smaller one: the few statistics over temperature, in motion or of time are not masked by the thousands
of the noise of phases.

**Localisation** (`inference.assessment`). A tree (array, chip, sensor, axis, domain, statistic) is tested downwards
by the largest normal score among siblings, against the same maximum over the replicates (Westfall and Young 1993;
Meinshausen 2008), at one family-wise level of 5 %.

**Hypotheses** (`inference.search`). All effects are tried on every sensor that differs, by local statistics -2 ln
p(s | H0) / p(s | Hi) from paired replicates (Anau Montel, Alvey and Weniger, arXiv 2412.15100). The evidence is that of
all logs, of each rate, of each kind of experiment and of single logs. An effect on all axes is tried if it gains on the
axes that show it, and telegraph noise if a wander gains. The best few are refined (Gauss-Newton steps by simulation,
fitted parameters adapted by indirect inference) and evaluated on held-out data (`statistics.split`). p is a **synthetic
likelihood** (`statistics.synthetic_likelihood`): Student's t about the replicates' median, tempered by the share of the
statistics that is independent.

**Selection** is forward, by units: the best hypothesis is selected if it gains more nats on the held-out part than
chance and a placebo do. A shared cause is tried for sensors of one chip that differ together.

**Verification.** Replicates of the model with all causes are compared with the recording again. **Closure** is the
share of the excess squared scores on held-out logs that the causes remove. A test precedes the probabilities
(`findings.verdict`): if the remainder is far beyond chance, the gap is unexplained, its cause is outside the library,
and no cause is probable.

With earlier recordings of the same array (`against`), these replace the simulator for the properties of the units
(`inference.comparison`): the question becomes what changed since then.

Compare: Li and Huggins, arXiv 2203.15897 (checks on divided data); ASME V&V 20 (comparison with a validation
uncertainty); the pulls of particle physics.

Subpackages
-----------
`recording` reads logs, `statistics` summarises them, `model` simulates them again, `inference` identifies the causes,
`findings` reports them; each imports only those before it. `diagnose` combines them.
"""

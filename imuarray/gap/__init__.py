"""Diagnosis of the gap between a simulator and recordings of an inertial sensor array.

The model
---------
A **recording** x is a campaign of logs of one array: times, raw counts and flags of each triad, with phases, tracks
and temperatures as far as the logs tell them. A **simulator** makes such recordings from

* **fitted parameters** theta: noise, bias, linear thermal slope of the bias, the chip's own filter, whose cutoff each
  replicate draws within what the rows tell of it (measured correlations where no filter has them);
* **nuisance parameters** nu: what a data sheet leaves to the part, each with a tolerance (`model.populations`). Scale
  error, misalignment, g-sensitivity and tilt of the box are profiled within their tolerances; so are the lag of an
  element behind the temperature of the box, where dies are late by their own thermometers as long as these are
  (`model.element_temperature`), the delay of a signal in a chip's filter and in its decimation, the offset of the times
  of rows from a queue, or of the sensors' clock from a track's (`model.signal_delay`), and lines of the surroundings:
  those that several sensors of a quantity measure alike, and faint ones of accelerometers (`model.ambient_lines`). The
  phase and rate of the data clock (`model.data_clock`), the scatter of biases from one power-on to the next, the
  position of an accelerometer, nonlinearity, the slope of the scale over temperature, the curve of a bias over
  temperature, slopes that no temperature tells, usual flicker in long phases, a bias that all accelerometers have in
  common, and the course of a room's temperature that nobody recorded (`model.room_temperature`) are drawn anew for
  every replicate. Their estimates are reported as **pulls**, value over tolerance (`model.nuisance`), and are no
  causes;
* **effects** e with parameters eta, a place (sensor, axes, family or all) and a *when* (always, from a moment on, in
  some logs, in stretches): what may be missing in the simulator, or be in it and not in the sensors
  (`inference.effects`).

**Statistics** s(x) are some 80 numbers for each axis and phase (`statistics.probes`), of what the fit leaves, never of
raw samples; each is such that it scatters nearly normally where nothing is wrong. In motion a sensor is compared with
the others of its quantity, and with fewer than two others with the track of the log as well, without the noise that the
track has at rest (`simulate.motion.track_noise`); whether the clock of all drifts away from the track's is told by the
growth of one sensor's delay. Rows in which a filter settles after power-on are left out, and so
are the ends of a rest in which the box still moves, and moments at which several sensors are restless
(`recording.quiet`): a hand, keystrokes, motors that start. Without a track the motion is estimated from the sensors
together (`recording.movement`), unless the box vibrates faster than the rows show. Turns between noted rests are
motions, too, whose beginning and end gravity tells (`recording.turns`), and so are long stretches between detected
rests. A statistic that one side lacks is missing: it has no score.

**Null distribution.** The gap is judged by parametric bootstrap: replicates x* ~ p(x | theta_hat, nu*), nu* drawn
from its population, theta fitted again to each. So both kinds of uncertainty are in it, that of the fit and that of
the part.

**Normal scores** (`statistics.tails`). Scores of levels and of rare rows have heavy tails, of which the largest of all
scores would consist. Each score is replaced by the deviation of a normal quantity that chance exceeds as rarely, by a
tail of Student's t that is fitted to the replicates; those of each replicate are by the tails of the others.

**Pooled scores** (`statistics.pooled`). The norm of what the normal scores of a sensor exceed one standard deviation by
is formed for each log and for all logs, and compared with chance like a single score: an effect that moves tens of
statistics a little is beyond chance there before it is in one place. The scores of a response to motion are also
summed over the axes of a sensor, which a delay or another position shifts alike.

**Localisation** (`inference.assessment`). A tree (array, chip, sensor, axis, domain, statistic) is tested downwards
by the largest normal score among siblings, against the same maximum over the replicates (Westfall and Young 1993;
Meinshausen 2008), at one family-wise level of 5 %.

**Hypotheses** (`inference.search`). All effects are looked at on every sensor that differs, by local statistics -2 ln
p(s | H0) / p(s | Hi) from paired replicates (Anau Montel, Alvey and Weniger, arXiv 2412.15100), from the evidence of
all logs, of each rate, of each kind of experiment and of single logs (an effect on all axes if it gains on those that
show it, telegraph noise if a wander does); the best few are refined (Gauss-Newton steps by simulation, fitted
parameters adapted by indirect inference) and evaluated on held-out data (`statistics.split`). p is a **synthetic
likelihood** (`statistics.synthetic_likelihood`): Student's t about the replicates' median, tempered by the share of the
statistics that is independent.

**Selection** is forward, by units: the best hypothesis is taken if it gains more nats on the held-out part than
chance and a placebo do; sensors of one chip that differ together are offered a shared cause.

**Verification.** Replicates with all causes in are compared with the recording again. **Closure** is the share of the
excess squared scores that is gone on held-out logs. A gate stands before the probabilities (`findings.verdict`): if
what is left is far beyond chance, the gap is unexplained, by something outside the library, and no cause is probable.

With earlier recordings of the same array (`against`) these take the simulator's place for what belongs to the units
(`inference.comparison`): the question becomes what changed since then.

Compare: Li and Huggins, arXiv 2203.15897 (checks on divided data); ASME V&V 20 (comparison with a validation
uncertainty); the pulls of particle physics.

The rooms
---------
`recording` reads logs, `statistics` summarises them, `model` simulates them again, `inference` finds what is missing,
`findings` says it; each imports only those before it. `diagnose` puts them together.
"""

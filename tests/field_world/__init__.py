"""The field world: recordings as engineers make them in the field, to judge `imuarray.diagnose`.

An engineer wrote it who had not read this project: from the file format, the data sheets of the chips and the names
of the effects. It shares no code with the simulator, the emulator or the other worlds. Since 2026-11-29 it is a
development world: the diagnosis may be tuned on it, so its figures no longer say how the diagnosis transfers to
unknown recordings.

Its 45 cases: twenty controls, in which nothing is wrong; seventeen with one named effect; four with a fault that has
no name in the library of causes; four with two faults. They have one to 32 sensors of seven chips (BMA180, ADXL345,
L3G4200D, MPU-6050, MPU-9150, HMC5883 and HMC5883L, BMP180), and are still, put on six faces, tumbled, on a turntable,
heated, switched on several times, in a rover, a boat, an elevator, a car, on a swing, or carried by a pedestrian.

::

    python -m tests.field_world DIR                      # all cases
    python -m tests.field_world DIR --seed-offset 1000   # other parts, motions and noise, the same plans and faults
    python -m tests.field_world DIR --only attic_desk van

writes `DIR/CASE/*.h5` and `DIR/truth.json`: an object with one of each case, by its name. Its `effects` have the name
of the effect (null if it has none), sensor, axis, size and unit, the statistic `sd` of a matched filter, the logs and
times in which it acts, and other names that are acceptable. A seed gives the same data always.

====================  ========================================================================================
chips.py              the sensors as configured: units, codes, rates, bandwidths, axes
parts.py              the errors of one specimen, drawn within the data sheet
streams.py            random streams with keys
signals.py            noise in a band, flicker, a lag, interpolation, a smooth step
rotation.py           quaternions and rotation matrices
surroundings.py       the world of the box: attitude, acceleration, vibration, temperature, pressure, field
experiments.py        the experiments, each a world of one log
recorder.py           when the recorder reads which sensor, and on which clock
faults.py             what can be wrong, each at its place in the chain
chain.py              from the motion of the box to the registers of one sensor
barometer.py          the BMP180
readings.py           what the recorder reads of each sensor
severity.py           how large a fault is; scales it to a target
plan.py, cases.py     what a case consists of; the 45 cases
log_file.py           file format 1, written with h5py
writer.py             writes cases and their truth
====================  ========================================================================================
"""

"""The bench world: recordings of small arrays, made to judge `imuarray.diagnose`, never to tune it.

An experimenter wrote it from the file format and the data sheets of the chips, as somebody writes it who has a bench,
a hair dryer and a rate table, and who had read neither the simulator nor the diagnosis nor the emulator nor their
tests. It imports the standard library, numpy and h5py only (a test checks that) and has its own signal chain: motion
of the box at 400 Hz, lever arm, matrix of the part, temperature of the chip with a lag, white, 1/f and 1/f² noise, a
Butterworth filter of second order, codes, and a recorder that polls each sensor late.

Its thirty cases: nine controls, in which nothing is wrong; fifteen with one fault; three with a fault that has no name
in the library of causes; three with two faults. Together they have one to nine ADXL345, BMA180, L3G4200D and MPU-6050,
40 to 800 frames a second, and the experiments that such arrays have had: still, six faces by hand, tumbled, on a rate
table with its track, in a vehicle, heated, and switched on six times. Each part is a specimen within its data sheet.

::

    python -m tests.bench_world DIR                        # the thirty cases
    python -m tests.bench_world DIR --seed-offset 1000     # other parts, motions and noise, the same plans and faults
    python -m tests.bench_world DIR --kind control         # control, single, unknown or pair

writes `DIR/CASE/log1.h5` ... and `DIR/truth.json`: a list with an object for each case, whose `faults` have the
effect, the sensor, its axes, the parameters, the time from which they act, and the size in words. A seed gives the
same data always.

====================  ========================================================================================
chips.py              the sensors as configured: codes, rates, axes, filters
arrays.py             sensors on a board: channels, addresses, positions
parts.py              the errors of one specimen, drawn within the data sheet
rotation.py           rotation matrices, vectors and quaternions
motion.py             rate, specific force and temperature of the box, from its course
experiments.py        the courses: still, faces, tumble, vehicle, rate table, heating
filters.py, noise.py  low-pass filter and lag; noise with a power law
recorder.py           when each frame is polled, and which frames are missed
faults.py             what can be wrong, each at its place in the chain
samples.py            what a chip samples and a recorder reads
chain.py              from the motion to the rows of one sensor
log_file.py           file format 1, written with h5py
cases.py              the thirty cases
writer.py             writes cases and their truth
====================  ========================================================================================
"""

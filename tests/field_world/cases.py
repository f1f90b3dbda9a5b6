"""The 45 cases: 20 controls, 17 with a named effect, four with a nameless fault, and four with two faults.

Their names tell the scene, never the fault.
"""

from __future__ import annotations

import numpy as np

from tests.field_world import experiments, faults
from tests.field_world.chips import Sensor
from tests.field_world.plan import Case
from tests.field_world.recorder import Logger
from tests.field_world.signals import lag

CASES = {}
SIX = ["z_up", "x_up", "y_up", "z_down", "x_down", "y_down"]


def case(f):
    """Add a function that returns a case to `CASES`, by its name."""
    CASES[f.__name__] = f
    return f


def bma180(n, rg=2, bw=150, **k):
    return Sensor(n, "bma180", "acc", rg, 0, bw, address=k.pop("address", 0x40), **k)


def adxl345(n, odr=100, rg=16, **k):
    return Sensor(n, "adxl345", "acc", rg, odr, address=k.pop("address", 0x53), has_thermometer=False, **k)


def l3g4200d(n, rg=250, odr=100, bw=25, **k):
    return Sensor(n, "l3g4200d", "gyro", rg, odr, bw, address=k.pop("address", 0x68), **k)


def hmc5883(n, odr=15, rg=1.3, **k):
    return Sensor(n, k.pop("chip", "hmc5883l"), "mag", rg, odr, address=0x1E, has_thermometer=False, **k)


def bmp180(n, divisor=100, **k):
    return Sensor(n, "bmp180", "baro", address=0x77, divisor=divisor, **k)


def mpu6050(n, ra=2, rg=250, odr=100, bw=42, chip="mpu6050", names=("{}_acc", "{}_gyro"), **k):
    a = k.pop("address", 0x68)
    return [
        Sensor(names[0].format(n), chip, "acc", ra, odr, bw, address=a, die=n, **k),
        Sensor(names[1].format(n), chip, "gyro", rg, odr, bw, address=a, die=n, **k),
    ]


def nine(has_thermometer=True, complete=True, odr=100, acc=2, bw=40):
    s = [
        bma180("BMA1", acc, bw, position_mm=(30, 20, 0), axes="+Y-X+Z", channel=0, has_thermometer=has_thermometer),
        bma180(
            "BMA2",
            acc,
            bw,
            position_mm=(30, -20, 0),
            axes="+Y+X-Z",
            channel=0,
            address=0x41,
            has_thermometer=has_thermometer,
        ),
        bma180("BMA3", acc, bw, position_mm=(-30, 20, 5), axes="-X+Y-Z", channel=1, has_thermometer=has_thermometer),
        bma180("BMA4", acc, bw, position_mm=(-30, -20, 5), channel=1, address=0x41, has_thermometer=has_thermometer),
        adxl345("ADXL1", odr, position_mm=(0, 25, 0), axes="-Y+X+Z", channel=2),
        adxl345("ADXL2", odr, position_mm=(0, -25, 0), channel=2, address=0x1D, axes="-X-Y+Z"),
        l3g4200d("Gyro1", 250, odr, position_mm=(12, 0, 0), channel=2, has_thermometer=has_thermometer),
        l3g4200d(
            "Gyro2",
            250,
            odr,
            position_mm=(-12, 0, 0),
            channel=2,
            address=0x69,
            axes="+X-Y-Z",
            has_thermometer=has_thermometer,
        ),
        l3g4200d("Gyro3", 250, odr, position_mm=(0, 8, 8), channel=3, axes="+Y+Z+X", has_thermometer=has_thermometer),
    ]
    if complete:
        s += [
            hmc5883("Mag1", 15, position_mm=(0, 40, 0), channel=3),
            bmp180("Baro", 100, position_mm=(0, 0, 10), channel=3),
        ]
    return s


# ================================================================ controls
@case
def attic_desk():
    return Case(
        "attic_desk",
        "control",
        "one ADXL345 on a desk for ten minutes, Linux board, nothing else on the bus",
        [adxl345("acc", 100, axes="+X+Y+Z", address=0x1D)],
        Logger(100, busy=1),
        lambda key: experiments.static((*key, 0), 590, level=1.2, walkers=2),
        has_multiplexer=False,
        has_clocks=True,
    )


@case
def bench_pair():
    return Case(
        "bench_pair",
        "control",
        "two accelerometers of different chips, six faces by hand, microcontroller recorder",
        [
            adxl345("acc_rear", 100, position_mm=(-15, 0, 0), axes="-X-Y+Z"),
            bma180("acc_front", 2, 40, position_mm=(15, 0, 0), axes="+Y-X+Z", has_thermometer=False),
        ],
        Logger(100, "mcu", ppm=42),
        lambda key: experiments.faces((*key, 0), [*SIX, "z_up"], 18),
        has_multiplexer=False,
        has_scales=False,
    )


@case
def night_nine():
    return Case(
        "night_nine",
        "control",
        "nine triads, magnetometer, barometer behind the multiplexer, 100 Hz, a busy Linux night with stalls and gaps",
        nine(),
        Logger(100, busy=7, stall=2.5, gaps=((143.2, 146.9), (371.0, 372.4)), restarts=((455.0, 461.3),)),
        lambda key: experiments.static((*key, 0), 540, start_c=21, level=0.7, temp=("room", {"drift": -1.6})),
        has_clocks=True,
    )


@case
def board16():
    s = []
    for i in range(16):
        flip = i % 2
        s += mpu6050(
            f"IMU{i + 1:02d}",
            16,
            2000,
            62.5,
            98,
            "mpu9150",
            position_mm=(-22.5 + 15 * (i % 4), -22.5 + 15 * (i // 4), -1.5 if flip else 1.5),
            axes="-Y-X-Z" if flip else "+X+Y+Z",
            bus=f"/dev/i2c-{10 + i // 2}",
            address=0x68 + i % 2,
            has_thermometer=False,
        )
    return Case(
        "board16",
        "control",
        "sixteen MPU-9150 on both sides of a board, tumbled by hand, 62.5 Hz",
        s,
        Logger(62.5, "mcu", ppm=-18, burst=0.0002),
        lambda key: experiments.tumble((*key, 0), 110, fs=400, brisk=1.0),
        has_multiplexer=False,
        flags="none",
        source="imported",
        software="converted 2.1",
        has_scales=False,
    )


@case
def rover_field():
    return Case(
        "rover_field",
        "control",
        "a rover, motor vibration that follows the speed, magnetometer near the motors",
        [
            bma180("base_acc", 8, 150, position_mm=(60, 0, 20), axes="+X-Y-Z", channel=0),
            l3g4200d("base_gyro", 500, 200, position_mm=(55, 12, 20), channel=1, axes="+X+Y+Z"),
            adxl345("mast_acc", 200, 8, position_mm=(0, 0, 180), channel=1),
            hmc5883("mast_mag", 30, 1.9, position_mm=(0, 0, 200), channel=1, divisor=5),
        ],
        Logger(200, busy=1),
        lambda key: experiments.rover((*key, 0), 110),
    )


@case
def walk_park():
    return Case(
        "walk_park",
        "control",
        "a pedestrian carries the box through a park",
        [
            *mpu6050("chest", 4, 500, 100, 42, position_mm=(0, 10, 0), axes="+Z-Y+X"),
            adxl345("side", 100, 16, position_mm=(0, -20, 5), axes="+Z+X+Y"),
        ],
        Logger(100, "mcu", ppm=-66),
        lambda key: experiments.pedestrian((*key, 0), 160),
        has_multiplexer=False,
    )


@case
def harbour():
    return Case(
        "harbour",
        "control",
        "moored boat with running engine, sun on the deck, no phase labels that mean anything",
        [
            hmc5883("compass", 15, 1.3, position_mm=(0, 0, 60), channel=3, divisor=3, averaged=8),
            l3g4200d("g_port", 250, 100, position_mm=(0, 30, 0), channel=0),
            l3g4200d("g_stbd", 250, 100, position_mm=(0, -30, 0), channel=1, axes="-X-Y+Z"),
            adxl345("a_port", 50, 4, position_mm=(10, 30, 0), channel=0, supply_v=3.3),
            bma180("a_stbd", 3, 20, position_mm=(10, -30, 0), channel=1),
            bmp180("baro", 25, oversampling=2, channel=3),
        ],
        Logger(50),
        lambda key: experiments.boat((*key, 0), 330),
    )


@case
def lift():
    return Case(
        "lift",
        "control",
        "an elevator up and down, barometer and two accelerometers",
        [
            bmp180("p", 10, oversampling=1, channel=0),
            bma180("a1", 1.5, 75, position_mm=(20, 0, 0), channel=0, axes="-Y+X+Z"),
            adxl345("a2", 100, 2, position_mm=(-20, 0, 0), channel=1),
        ],
        Logger(100, "mcu", ppm=11),
        lambda key: experiments.elevator((*key, 0), 170),
        has_frame_rate=False,
    )


@case
def table_three_gyros():
    s = [
        l3g4200d("north", 250, 100, position_mm=(40, 0, 0), channel=0),
        l3g4200d("south", 250, 100, position_mm=(-40, 0, 0), channel=0, address=0x69, axes="-X-Y+Z"),
        l3g4200d("up", 500, 100, position_mm=(0, 0, 25), channel=1, axes="+Z+X+Y"),
        bma180("a", 2, 40, position_mm=(0, 30, 0), channel=1),
    ]
    rates = [30, 90, 180, 0, -60, -120, -220, 0]
    return Case(
        "table_three_gyros",
        "control",
        "turntable with encoder as reference, three gyros and an accelerometer, three mountings",
        s,
        Logger(100),
        lambda key: [experiments.turntable((*key, i), rates, 7, f) for i, f in enumerate(("z_up", "x_up", "y_up"))],
    )


@case
def playground():
    return Case(
        "playground",
        "control",
        "on a swing, accelerometers at two places and a gyro, no labels",
        [
            bma180("outer", 3, 75, position_mm=(0, 0, -120), axes="+X+Y+Z", has_thermometer=False),
            l3g4200d("mid", 250, 200, position_mm=(0, 0, 0), has_thermometer=False, axes="+X-Y-Z"),
            adxl345("inner", 200, 4, position_mm=(0, 20, 110), axes="-X+Y-Z"),
        ],
        Logger(200, "mcu", ppm=-3),
        lambda key: experiments.swing((*key, 0), 70, labels=False),
        has_multiplexer=False,
    )


@case
def commute():
    return Case(
        "commute",
        "control",
        "in a car that warms up, Linux board with gaps",
        [
            hmc5883("mag", 75, 1.9, channel=3, divisor=1, position_mm=(0, 50, 0)),
            *mpu6050("A", 2, 250, 100, 20, position_mm=(10, 0, 0), channel=0, axes="-X-Y+Z"),
            *mpu6050("B", 2, 250, 100, 20, position_mm=(-10, 0, 0), channel=0, address=0x69),
            bmp180("baro", 50, channel=3),
        ],
        Logger(100, busy=3, gaps=((88.0, 90.4),)),
        lambda key: experiments.car((*key, 0), 240),
    )


@case
def oven_loop():
    pts = [(0, 24), (60, 24), (62, 48), (330, 48), (332, 25), (560, 25)]

    def worlds(key):
        x = experiments.static(
            (*key, 0), 560, start_c=24, temp=("profile", {"points": pts, "tau": 55}), labels=False, finish=False
        )
        x.phases = [(0, 60, "room", "+Z"), (62, 330, "heat", "+Z"), (332, 560, "cool", "+Z")]
        return x.finish()

    return Case(
        "oven_loop",
        "control",
        "box heated with a lamp and cooled again, reference thermometer",
        [
            bma180("BMA_a", 2, 40, position_mm=(10, 10, 0), axes="+Y+X-Z"),
            l3g4200d("L3G_a", 250, 100, position_mm=(-10, 10, 0)),
            adxl345("ADXL_a", 50, position_mm=(0, -10, 0)),
            l3g4200d("L3G_b", 250, 100, position_mm=(-10, -10, 0), address=0x69, axes="+X-Y-Z"),
        ],
        Logger(50),
        worlds,
        has_reference_temperature=True,
    )


@case
def freezer_out():
    def worlds(key):
        x = experiments.static(
            (*key, 0), 480, start_c=-14, temp=("exp", {"start": -14, "to": 17, "tau": 210}), labels=False, finish=False
        )
        x.phases = [(0, 480, "heat", "+Z")]
        return x.finish()

    return Case(
        "freezer_out",
        "control",
        "taken from the freezer, warming on the bench, two MPU-6050",
        mpu6050("m1", 2, 250, 100, 42, position_mm=(0, 8, 0))
        + mpu6050("m2", 2, 250, 100, 42, position_mm=(0, -8, 0), address=0x69, axes="-X+Y-Z", names=("{}_a", "{}_w")),
        Logger(100, "mcu", ppm=25),
        worlds,
        has_multiplexer=False,
    )


@case
def morning_starts():
    s = [
        l3g4200d("G1", 250, 400, second_filter=True, bw=50, channel=1),
        l3g4200d(
            "G2", 500, 400, second_filter=True, bw=50, channel=1, address=0x69, position_mm=(10, 0, 0), axes="-X-Y+Z"
        ),
        bma180("B1", 4, 75, position_mm=(0, 10, 0)),
        bma180("B2", 4, 75, position_mm=(0, -10, 0), address=0x41, axes="+Y+X-Z"),
    ]

    def worlds(key):
        r = []
        for i in range(8):
            x = experiments.static(
                (*key, i), 25, start_c=20 + 0.4 * i, labels=False, temp=("warmup", {"dT": 1.0, "tau": 60}), finish=False
            )
            x.q = x.q.copy()
            x.phases = [(0, 25, f"run {i + 1}", "+Z")]
            x.marks["age"] = 1.5
            r.append(x.finish())
        return r

    return Case(
        "morning_starts",
        "control",
        "eight power-ons, 25 s each",
        s,
        Logger(200),
        worlds,
        labels=[f"start{i + 1:02d}" for i in range(8)],
        flags="identical",
    )


@case
def fast_single():
    return Case(
        "fast_single",
        "control",
        "one BMA180 in low-power mode (1200 Hz) polled as fast as it goes, repeats and skips",
        [bma180("acc", 2, 300, low_power=True, axes="-Z+Y+X")],
        Logger(1450, "mcu", ppm=-31, burst=0.0002),
        lambda key: experiments.static((*key, 0), 40, fs=2400, level=1.0, hum=0.15, face="x_up"),
        has_multiplexer=False,
        flags="identical",
    )


@case
def garden_rates():
    return Case(
        "garden_rates",
        "control",
        "outdoors: sensors at different rates, a stake that sinks slowly, sun and wind",
        [
            adxl345("fast", 400, position_mm=(0, 0, 0), channel=0, rg=4),
            l3g4200d("gyro", 250, 100, divisor=4, channel=0, position_mm=(10, 0, 0), axes="-Y+X+Z"),
            hmc5883("mag", 15, 1.2, divisor=25, channel=1, chip="hmc5883"),
            bmp180("baro", 400, channel=1),
            bma180("slow", 2, 10, divisor=8, channel=1, position_mm=(-10, 0, 5)),
        ],
        Logger(400),
        lambda key: experiments.static(
            (*key, 0), 145, fs=800, start_c=19, tilt=0.12, wind=0.006, temp=("sun", {"dT": 7})
        ),
    )


@case
def put_down():
    def worlds(key):
        x = experiments.putdown((*key, 0), 75)
        t1 = x.marks["t"][0]
        x.phases = [
            (0, t1 - 6, "static", "+Z"),
            (t1 - 5, t1 + 0.5, "motion", ""),
            (t1 + 1.0, 75, "static", "+Z"),
        ]  # the first label is wrong: held in the hand
        return x

    return Case(
        "put_down",
        "control",
        "held, put down, fingers leave, nudged; a phase label is wrong",
        [
            adxl345("left", 200, 8, position_mm=(-30, 0, 0)),
            adxl345("right", 200, 8, position_mm=(30, 0, 0), address=0x1D, axes="-X-Y+Z"),
            l3g4200d("g", 250, 200, has_thermometer=False),
        ],
        Logger(200, "mcu", ppm=8),
        worlds,
        has_multiplexer=False,
        has_dimensions=False,
    )


@case
def cellar_hum():
    return Case(
        "cellar_hum",
        "control",
        "a cellar beside a transformer: 100 Hz hum in all parts alike, people on the stairs",
        [
            bma180("b1", 2, 150, position_mm=(12, 0, 0)),
            bma180("b2", 2, 150, position_mm=(-12, 0, 0), address=0x41, axes="+Y+X-Z"),
            adxl345("x1", 200, position_mm=(0, 14, 0), channel=1),
            l3g4200d("w1", 250, 200, channel=1, axes="+Z+X+Y"),
            hmc5883("m1", 75, 1.3, channel=2, divisor=2, position_mm=(40, 0, 0)),
            hmc5883("m2", 75, 1.3, channel=3, divisor=2, position_mm=(-40, 0, 0), axes="-X-Y+Z"),
        ],
        Logger(200, stall=0.5),
        lambda key: experiments.static((*key, 0), 240, fs=1000, hum=0.35, mag_hum=1.6, walkers=4, level=1.5),
    )


@case
def three_evenings():
    s = [
        bma180("acc_front", 4, 40, position_mm=(35, 0, 0)),
        bma180("acc_back", 4, 40, position_mm=(-35, 0, 0), address=0x41, axes="-X-Y+Z"),
        adxl345("acc_mid", 100, position_mm=(0, 0, 10), channel=1, supply_v=2.8),
        l3g4200d("gyro_front", 250, 100, position_mm=(30, 10, 0), channel=1),
        l3g4200d("gyro_back", 250, 100, position_mm=(-30, 10, 0), channel=1, address=0x69, axes="-X+Y-Z"),
    ]

    def worlds(key):
        r = []
        for i, o in enumerate(
            (
                SIX,
                ["z_up", "y_down", "x_up", "z_down", "y_up", "x_down"],
                ["z_up", "x_down", "y_up", "x_up", "y_down", "z_down"],
            )
        ):
            x = experiments.faces((*key, i), o, 14, start_c=20 + 2 * i, hard=0.4)
            x.phases = []
            r.append(x)
        return r

    return Case(
        "three_evenings",
        "control",
        "six faces on three evenings, no phase labels",
        s,
        Logger(100, busy=1),
        worlds,
        labels=["mon", "wed", "fri"],
    )


@case
def lone_gyro():
    return Case(
        "lone_gyro",
        "control",
        "one L3G4200D of 100 Hz polled at 137 Hz (repeats), turned by hand now and then",
        [l3g4200d("gyro", 500, 100, axes="+Y-X+Z")],
        Logger(137, stall=1.5),
        lambda key: experiments.tumble((*key, 0), 180, brisk=0.6, rest=20),
        has_multiplexer=False,
    )


# ================================================================ effects
@case
def shelf_faces():
    return Case(
        "shelf_faces",
        "effect",
        "six faces twice; one accelerometer bends (quadratic)",
        [
            bma180("A_one", 2, 40, position_mm=(10, 0, 0)),
            bma180("A_two", 2, 40, position_mm=(-10, 0, 0), address=0x41, axes="-X-Y+Z"),
            l3g4200d("W", 250, 100, channel=1, more={"delay_ns": 7030000}),
            adxl345("A_three", 100, channel=1),
        ],
        Logger(100),
        lambda key: experiments.faces((*key, 0), [*SIX, "z_up", "x_up"], 16),
        [faults.Quadratic("A_two", "z", 6e-3, 20, minimum=9e-3, tolerance="0.15 %FS = 3 mg, typical")],
    )


@case
def rate_table():
    s = [
        l3g4200d("g1", 250, 100, position_mm=(20, 0, 0), axes="+X-Y-Z"),
        l3g4200d("g2", 250, 100, position_mm=(-20, 0, 0), address=0x69),
        l3g4200d("g3", 250, 100, position_mm=(0, 20, 0), channel=1, axes="-X-Y+Z"),
    ]
    rates = [40, 90, 140, 190, 235, 0, -40, -90, -140, -190, -235, 0]
    return Case(
        "rate_table",
        "effect",
        "turntable with encoder; one gyro's gain falls towards full scale (cubic)",
        s,
        Logger(100, "mcu", ppm=17),
        lambda key: [experiments.turntable((*key, i), rates, 6, f) for i, f in enumerate(("z_up", "y_up"))],
        [faults.Cubic("g2", "z", -2.0, 20, minimum=1.8, also_acceptable=(), tolerance="0.2 %FS = 0.5 dps, typical")],
    )


@case
def trail_four():
    s = []
    for i, (ch, ad, ax) in enumerate(
        ((0, 0x68, "+X+Y+Z"), (0, 0x69, "-X-Y+Z"), (1, 0x68, "+X-Y-Z"), (1, 0x69, "-X+Y-Z"))
    ):
        s += mpu6050(
            f"unit{'ABCD'[i]}",
            8,
            1000,
            100,
            42,
            channel=ch,
            address=ad,
            axes=ax,
            position_mm=(20 * (i % 2) - 10, 20 * (i // 2) - 10, 0),
            has_thermometer=i != 2,
        )
    return Case(
        "trail_four",
        "effect",
        "pedestrian with four MPU-6050; the recorder logs the old bytes again when the bus hiccups",
        s,
        Logger(100, burst=0.0003),
        lambda key: experiments.pedestrian((*key, 0), 120),
        [faults.HeldRows("unitC_gyro", None, 0.006)],
        flags="none",
        source="imported",
        software="csv2h5",
    )


@case
def knocked():
    f = faults.ScaleError(
        "acc_mid", "y", 3e-3, 20, minimum=1.5e-3, onset=0.0, tolerance="data sheet: 1 % part to part, none for a change"
    )

    def worlds(key):
        x = experiments.faces((*key, 0), [*SIX, "z_up", "x_up", "y_up", "z_down", "x_down", "y_down"], 12, hard=0.5)
        f.onset = round(x.phases[6][0] - 2.2, 2)
        return x

    return Case(
        "knocked",
        "effect",
        "six faces, a hard put-down, six faces again",
        [
            bma180("acc_low", 2, 40),
            bma180("acc_mid", 2, 40, address=0x41, axes="+Y-X+Z", position_mm=(0, 20, 0)),
            adxl345("acc_top", 100, channel=1, axes="-X-Y+Z"),
            hmc5883("mag", 15, channel=1, divisor=4),
        ],
        Logger(100),
        worlds,
        [f],
    )


@case
def kitchen_faces():
    return Case(
        "kitchen_faces",
        "effect",
        "six faces on a kitchen table; one gyro feels g",
        [
            l3g4200d("left_w", 250, 100),
            l3g4200d("right_w", 250, 100, address=0x69, axes="-X-Y+Z", position_mm=(25, 0, 0)),
            adxl345("left_a", 100, channel=1),
            adxl345("right_a", 100, address=0x1D, channel=1, axes="-X-Y+Z", position_mm=(25, 5, 0)),
        ],
        Logger(
            100,
            "mcu",
            ppm=-40,
        ),
        lambda key: experiments.faces((*key, 0), [*SIX, "z_up"], 20),
        [
            faults.GSensitivity(
                "right_w",
                "x",
                0.05,
                20,
                minimum=0.03,
                along="z",
                tolerance="not specified; other parts below 0.012 dps/g",
            )
        ],
    )


@case
def long_swing():
    return Case(
        "long_swing",
        "effect",
        "a pendulum; one accelerometer does not sit where the drawing says",
        [
            bma180("p1", 3, 75, position_mm=(0, 0, -150)),
            bma180("p2", 3, 75, position_mm=(0, 0, 60), address=0x41, axes="-X-Y+Z"),
            adxl345("p3", 200, 4, position_mm=(0, 40, 0), channel=1),
            l3g4200d("w", 250, 200, channel=1),
        ],
        Logger(200, "mcu", ppm=5),
        lambda key: experiments.swing((*key, 0), 80, length_m=0.7, amp=35),
        [
            faults.Displacement(
                "p2", None, 8.0, 20, minimum=6.0, direction=[0, 0, 1], tolerance="placed to 0.6 mm elsewhere"
            )
        ],
    )


@case
def brisk_walk():
    return Case(
        "brisk_walk",
        "effect",
        "pedestrian; one sensor's values come through a queue",
        [
            bma180("belt", 4, 75, axes="-Z+Y+X"),
            adxl345("bag", 100, 16, channel=1, axes="+Y+Z+X"),
            adxl345("bag2", 100, 16, channel=1, address=0x1D, position_mm=(0, 15, 0)),
            l3g4200d("belt_w", 500, 100, channel=0, axes="-Z+Y+X"),
        ],
        Logger(100),
        lambda key: experiments.pedestrian((*key, 0), 90, labels=False),
        [faults.Skew("bag2", None, 0.03, tolerance="filters differ by some 5 ms")],
    )


@case
def ferry():
    return Case(
        "ferry",
        "effect",
        "boat; a bad plug loses readings of one sensor",
        nine(complete=True),
        Logger(100),
        lambda key: experiments.boat((*key, 0), 150),
        [faults.LostRows("ADXL2", None, 0.015)],
    )


@case
def gravel():
    return Case(
        "gravel",
        "effect",
        "rover on gravel; one axis clips below its range",
        [
            adxl345("a_front", 200, 16, position_mm=(80, 0, 0)),
            adxl345("a_rear", 200, 16, address=0x1D, position_mm=(-80, 0, 0), axes="-X-Y+Z"),
            bma180("a_deck", 8, 75, channel=1, position_mm=(0, 0, 40)),
            l3g4200d("w_deck", 500, 200, channel=1, position_mm=(0, 10, 40)),
        ],
        Logger(200, "mcu", ppm=-9),
        lambda key: experiments.rover((*key, 0), 90, vib=1.5),
        [faults.Clipping("a_rear", "z", 500, 20, also_acceptable=("range_reset",))],
    )


@case
def quiet_room():
    return Case(
        "quiet_room",
        "effect",
        "static; a weak line in one gyro",
        [
            l3g4200d("gy_0", 250, 200, second_filter=True, bw=70),
            l3g4200d("gy_1", 250, 200, address=0x69, second_filter=True, bw=70, axes="-X+Y-Z"),
            bma180("ac_0", 2, 75, channel=1),
            hmc5883("ma_0", 75, channel=1, divisor=3),
        ],
        Logger(200),
        lambda key: experiments.static((*key, 0), 240, level=0.6),
        [faults.Tone("gy_1", "y", 0.02, 8, hz=37.3, wander=0.02)],
    )


@case
def weekend():
    s = [
        bma180("u1", 2, 20),
        bma180("u2", 2, 20, address=0x41, axes="+Y+X-Z"),
        adxl345("u3", 50, channel=1),
        adxl345("u4", 50, channel=1, address=0x1D, axes="-X-Y+Z"),
        l3g4200d("u5", 250, 100, channel=2),
    ]
    return Case(
        "weekend",
        "effect",
        "two static logs of nine minutes; one axis walks away at random",
        s,
        Logger(50, busy=2),
        lambda key: [
            experiments.static((*key, i), 540, level=0.5, temp=("room", {"drift": 0.7 - i})) for i in range(2)
        ],
        [faults.RandomWalk("u2", "x", 2e-5, 8, also_acceptable=("bias_instability",))],
        has_clocks=True,
    )


@case
def van():
    return Case(
        "van",
        "effect",
        "in a van; register halves of two conversions are mixed now and then",
        [
            l3g4200d("yaw1", 250, 100),
            l3g4200d("yaw2", 250, 100, address=0x69, axes="+X-Y-Z"),
            bma180("acc", 4, 40, channel=1),
            bmp180("baro", 100, channel=1),
        ],
        Logger(100),
        lambda key: experiments.car((*key, 0), 150),
        [faults.TornWords("yaw1", "z", 6)],
    )


@case
def library():
    return Case(
        "library",
        "effect",
        "static; one axis jumps between two levels",
        [
            adxl345("k1", 100, 4, axes="+X-Y-Z"),
            adxl345("k2", 100, 4, address=0x1D),
            bma180("k3", 2, 40, channel=1, has_thermometer=False),
        ],
        Logger(100, "mcu", ppm=14),
        lambda key: experiments.static((*key, 0), 420, level=0.9, walkers=2),
        [faults.Telegraph("k1", "x", 1e-3, 20, up=7.0, down=16.0)],
    )


@case
def two_tumbles():
    s = [
        *mpu6050("c", 2, 500, 100, 42, axes="+X+Y+Z"),
        bma180("d", 4, 75, position_mm=(0, 18, 0), channel=1, axes="-Y+X+Z"),
        adxl345("e", 100, 4, position_mm=(18, 0, 0), channel=1),
        l3g4200d("f", 500, 100, channel=1, address=0x69),
    ]
    return Case(
        "two_tumbles",
        "effect",
        "tumbled twice; one board glued in askew",
        s,
        Logger(100),
        lambda key: [experiments.tumble((*key, i), 70) for i in range(2)],
        [faults.Misalignment("d", None, 4.0, about=[0.3, 1.0, 0.5], tolerance="0.5 degrees, one sigma")],
    )


@case
def hot_cold():
    pts = [(0, 22), (40, 22), (42, 45), (200, 45), (202, 22), (330, 22), (332, 42), (440, 42), (442, 22), (560, 22)]

    def worlds(key):
        x = experiments.static(
            (*key, 0), 560, start_c=22, temp=("profile", {"points": pts, "tau": 25}), labels=False, finish=False
        )
        x.phases = [(0, 40, "room", "+Z"), (42, 200, "heat", "+Z"), (202, 330, "cool", "+Z")]
        return x.finish()

    return Case(
        "hot_cold",
        "effect",
        "heated and cooled twice; one bias follows its thermometer late",
        [
            l3g4200d("t1", 250, 100, axes="+X-Y-Z"),
            bma180("t2", 2, 40, axes="-X-Y+Z"),
            bma180("t3", 2, 40, address=0x41),
            l3g4200d("t4", 250, 100, channel=1),
        ],
        Logger(100, "mcu", ppm=33),
        worlds,
        [faults.ThermalLag("t3", "z", 1e-4, 20, tau=70.0)],
    )


@case
def porch():
    return Case(
        "porch",
        "effect",
        "outdoors, tilted slowly; the lowest bit of one chip never sets",
        [
            adxl345("n1", 200, 4),
            adxl345("n2", 200, 4, address=0x1D, axes="-X+Y-Z"),
            l3g4200d("n3", 250, 200, channel=1),
        ],
        Logger(200, busy=1),
        lambda key: experiments.static((*key, 0), 150, tilt=0.8, wind=0.01, temp=("sun", {"dT": 4})),
        [faults.CoarseCodes("n1", None, 2)],
    )


@case
def van_table():
    return Case(
        "van_table",
        "effect",
        "tumbled by hand; the wiring table names two axes the wrong way round",
        [
            l3g4200d("w_a", 500, 100),
            l3g4200d("w_b", 500, 100, address=0x69, axes="-X-Y+Z"),
            adxl345("s_a", 100, 4, channel=1),
            bma180("s_b", 4, 40, channel=1, axes="+Y-X+Z"),
            bma180("s_c", 4, 40, channel=1, address=0x41),
        ],
        Logger(100, "mcu", ppm=-12),
        lambda key: experiments.tumble((*key, 0), 80),
        [faults.ExchangedAxes("s_c", ("x", "y"), 1, perm=[1, 0, 2], sign=[1, -1, 1])],
    )


# ================================================================ without a name
@case
def forest_rover():
    return Case(
        "forest_rover",
        "unknown",
        "rover; vibration rectification in one accelerometer: its mean moves with the vibration's power",
        [
            bma180("ch_l", 8, 75, position_mm=(0, 50, 0)),
            bma180("ch_r", 8, 75, position_mm=(0, -50, 0), address=0x41, axes="-X-Y+Z"),
            adxl345("ch_m", 200, 16, channel=1),
            l3g4200d("ch_w", 500, 200, channel=1),
        ],
        Logger(200),
        lambda key: experiments.rover((*key, 0), 100),
        [nameless(faults.Rectification("ch_l", "x", 1e-3, 20))],
    )


@case
def jog():
    return Case(
        "jog",
        "unknown",
        "pedestrian; a board hangs loose on its pin header and rings",
        [
            adxl345("j1", 200, 8),
            adxl345("j2", 200, 8, address=0x1D, position_mm=(0, 10, 0), axes="-X-Y+Z"),
            bma180("j3", 4, 75, channel=1, position_mm=(0, -10, 0)),
            l3g4200d("j4", 500, 200, channel=1),
        ],
        Logger(200, "mcu", ppm=21),
        lambda key: experiments.pedestrian((*key, 0), 75),
        [nameless(faults.LooseBoard("j2", "z", 1.0, hz=46.0, Q=6.0, box="z"))],
    )


@case
def potting():
    return Case(
        "potting",
        "unknown",
        "six faces; the potting of one chip creeps after each turn",
        [
            bma180("r1", 2, 40, axes="+Y-X+Z"),
            bma180("r2", 2, 40, address=0x41, position_mm=(20, 0, 0)),
            adxl345("r3", 100, channel=1),
            l3g4200d("r4", 250, 100, channel=1),
        ],
        Logger(100),
        lambda key: experiments.faces((*key, 0), [*SIX, "z_up", "y_up"], 24),
        [nameless(faults.Creep("r2", "z", 1e-3, 20, tau=14.0, box="z"))],
    )


@case
def greenhouse():
    def worlds(key):
        x = experiments.static((*key, 0), 420, start_c=29, labels=True, finish=False)
        g = x.r("thermostat")
        on, t = np.zeros(x.n), -2.0
        while t < 425:
            a, b = g.uniform(14, 20), g.uniform(22, 32)
            on[(x.t >= t) & (x.t < t + a)] = 1
            t += a + b
        x.marks["heater"] = on
        h = lag(on, x.fs, 30.0)
        x.T += 2.5 * (h - 0.4) + 0.5
        return x.finish()

    return Case(
        "greenhouse",
        "unknown",
        "static; the box heater's thermostat pulls the supply of one accelerometer down",
        [
            adxl345("h1", 100, 4),
            adxl345("h2", 100, 4, address=0x1D, axes="+X-Y-Z"),
            bma180("h3", 2, 40, channel=1),
            l3g4200d("h4", 250, 100, channel=1),
        ],
        Logger(100),
        worlds,
        [nameless(faults.Droop("h1", None, 1e-3, 20))],
    )


# ================================================================ pairs
@case
def stairwell():
    return Case(
        "stairwell",
        "pair",
        "static; two faults on two sensors",
        [
            bma180("v1", 2, 40),
            bma180("v2", 2, 40, address=0x41, axes="-X-Y+Z"),
            l3g4200d("v3", 250, 100, channel=1),
            l3g4200d("v4", 250, 100, channel=1, address=0x69, axes="-X+Y-Z"),
            bmp180("v5", 100, channel=1),
        ],
        Logger(100, busy=1),
        lambda key: experiments.static((*key, 0), 400, walkers=3),
        [
            faults.Flicker("v1", "y", 1e-4, 20, also_acceptable=("random_walk",)),
            faults.Stuck("v4", "z", 1, onset=212.0, duration=25.0, text="one axis keeps its code"),
        ],
    )


@case
def six_starts():
    s = [
        l3g4200d("Y1", 250, 200),
        l3g4200d("Y2", 250, 200, address=0x69, axes="-X-Y+Z"),
        bma180("X1", 4, 40, channel=1),
        bma180("X2", 4, 40, channel=1, address=0x41, axes="+Y+X-Z"),
    ]

    def worlds(key):
        r = []
        for i in range(6):
            x = experiments.static(
                (*key, i), 40, start_c=22, labels=False, temp=("warmup", {"dT": 0.8, "tau": 50}), finish=False
            )
            x.marks["age"] = 2.0
            x.phases = [(0, 40, f"run {i + 1}", "+Z")]
            r.append(x.finish())
        return r

    return Case(
        "six_starts",
        "pair",
        "six power-ons; two faults on two sensors",
        s,
        Logger(200),
        worlds,
        [
            faults.BistableBias(
                "Y2",
                "x",
                0.9,
                logs=[1, 4, 5],
                also_acceptable=("turn_on_bias",),
                tolerance="turn-on scatter 0.08 dps rms",
            ),
            faults.RangeReset(
                "X1",
                None,
                2,
                logs=[3],
                ratio=2.0,
                shift=[0.012, -0.02, 0.05],
                text="came up in the factory range of 2 g",
            ),
        ],
    )


@case
def warm_board():
    def worlds(key):
        x = experiments.static(
            (*key, 0), 460, start_c=12, temp=("exp", {"start": 11, "to": 33, "tau": 170}), labels=False, finish=False
        )
        x.phases = [(0, 460, "heat", "+Z")]
        return x.finish()

    return Case(
        "warm_board",
        "pair",
        "warming up; two faults on one sensor",
        mpu6050("q1", 2, 250, 100, 42)
        + mpu6050("q2", 2, 250, 100, 42, address=0x69, axes="-X-Y+Z", position_mm=(12, 0, 0)),
        Logger(100, "mcu", ppm=-22),
        worlds,
        [
            faults.ThermalKnee("q1_acc", "z", 1e-4, 20, T0=27.0),
            faults.Tone("q1_acc", "x", 1e-3, 8, hz=21.7, wander=0.01),
        ],
        has_multiplexer=False,
    )


@case
def five_rounds():
    s = [
        adxl345("o1", 100, 4),
        adxl345("o2", 100, 4, address=0x1D, axes="-X-Y+Z", position_mm=(16, 0, 0)),
        bma180("o3", 4, 40, channel=1),
        l3g4200d("o4", 500, 100, channel=1),
    ]

    def worlds(key):
        r = []
        for i in range(5):
            x = experiments.tumble((*key, i), 40, start_c=21 + 0.5 * i)
            x.marks["age"] = 3.0
            r.append(x)
        return r

    return Case(
        "five_rounds",
        "pair",
        "five power-ons with a short tumble each; two faults on one sensor",
        s,
        Logger(100),
        worlds,
        [
            faults.WrongRate(
                "o2",
                None,
                50.0,
                text="left at 50 Hz by another program, repeats in twos",
                also_acceptable=("stale_samples",),
            ),
            faults.TurnOnBias(
                "o2",
                "y",
                0.03,
                pattern=[0.6, -1.3, 1.1, -0.9, 0.7],
                tolerance="1.5 mg rms",
                also_acceptable=("bistable_bias",),
            ),
        ],
    )


def nameless(fault):
    """Return the fault without the name of an effect."""
    fault.name = None
    return fault

"""Properties of every mechanism: parameters change with severity, the effect grows with it, independence."""

from __future__ import annotations

import ast
import subprocess
import sys
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

import firmware_emulator
from firmware_emulator.array import open_bus
from firmware_emulator.mechanisms import MECHANISMS
from firmware_emulator.mechanisms.mechanism import FittedBoard
from firmware_emulator.mechanisms.query import fittings_from
from firmware_emulator.world import HeatingWorld, Shaking
from tests.emulator.mechanisms.mechanism_bench import ARRAY, errors, every
from tests.selection import some

EFFECTS = {
    *("white_noise", "bias_instability", "random_walk", "popcorn_noise", "bandwidth", "tone", "bias", "scale"),
    *("misalignment", "axis_error", "nonlinearity", "g_sensitivity", "thermal_bias", "thermal_scale", "thermal_lag"),
    *("quantisation", "saturation", "stale_samples", "glitches", "stuck", "turn_on_bias", "bistable_bias"),
    *("range_reset", "clock_error", "jitter", "dropped_samples", "skew", "odr_error", "common_mode", "size_effect"),
    *("channel_swap", "thermometer", "adaptive_range"),
}
"""The names of effects, as the documentation lists them."""
EITHER_OR = ("rotated_package", "crossed_wiring", "range_switch")
ON_THE_ELEMENT = (
    *("carrier_shot_noise", "trapped_charges", "stress_relaxation", "single_trap", "mains_ripple", "package_tilt"),
    *("reference_voltage", "plate_gap", "drive_imbalance", "thermistor_bow", "gain_resistor", "soft_clipping"),
    *("power_on_stress", "pipeline_delay", "log_creep", "one_sided_noise", "spinning_motor", "keyed_transmitter"),
    *("interleaved_converters", "thermal_hysteresis", "vibration_rectification", "reference_noise", "lever_arm"),
)
PACKAGE = Path(firmware_emulator.__file__).parent


def both(at_ns):
    """Shaken and heated at once, so that everything has something to act on."""
    shaken = Shaking(peak_g=0.3, peak_dps=100.0, still_s=0.5, motion_s=20.0)(at_ns)
    return shaken._replace(temperature_degc=HeatingWorld(scale=0.003)(at_ns).temperature_degc)


def test_severity_1_is_the_size_of_the_defaults_and_relations_have_known_names():
    for name, kind in MECHANISMS.items():
        assert kind.at(1.0) == kind(), name
        assert set(kind.resembles) <= EFFECTS, name
        assert set(kind.touches) <= {"adxl345", "bma180", "l3g4200d", "icm42688_gyro"}, name


def test_parameters_change_monotonically_with_severity():
    for name in sorted(set(MECHANISMS) - set(EITHER_OR)):
        rungs = [astuple(MECHANISMS[name].at(severity)) for severity in (0.5, 1, 2, 5, 20)]
        ladder = np.array([[value for value in rung if np.isscalar(value)] for rung in rungs], dtype=float)
        steps = np.diff(ladder, axis=0)
        assert all((column >= 0).all() or (column <= 0).all() for column in steps.T), name
        assert steps.any(axis=0).any(), name


@pytest.mark.parametrize("name", some(ON_THE_ELEMENT, 1))
def test_the_error_grows_with_severity(name):
    kind = MECHANISMS[name]
    where = "Gyro" if "l3g4200d" in kind.touches else "BMA"

    def size(severity: float) -> float:
        full_scale = 250.0 if where == "Gyro" else 2.0
        error = errors(kind.at(severity), where, every(31.2, 450), world=both, full_scale=full_scale)
        return float(np.sqrt(np.mean(error**2)))

    ladder = [size(severity) for severity in (0.5, 1, 4)]
    assert ladder == sorted(ladder)
    assert ladder[2] > 1.5 * ladder[1] > 0


def test_every_effect_with_a_name_has_a_mechanism_and_some_mechanisms_have_no_name():
    assert {effect for kind in MECHANISMS.values() for effect in kind.resembles} == EFFECTS
    assert sum(not kind.resembles for kind in MECHANISMS.values()) >= 8


def test_no_file_imports_the_simulator_or_the_diagnosis():
    """By its text: the mechanisms share register facts with the library and nothing else; cases may record."""
    allowed = {"cases.py": ("facts", "acquire", "array", "atomic", "bus", "commands", "errors", "shipped")}
    files = [*(PACKAGE / "mechanisms").rglob("*.py"), PACKAGE / "cases.py", PACKAGE / "board.py"]
    assert {f"{kind.__module__.rpartition('.')[2]}.py" for kind in MECHANISMS.values()} < {file.name for file in files}
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for module in modules:
                top, _, rest = module.partition(".")
                if top == "imuarray":
                    assert rest.split(".")[0] in allowed.get(file.name, ("facts",)), (file.name, module)
                assert not module.startswith(("importlib", "tests")), (file.name, module)


@pytest.mark.slow
def test_making_a_case_does_not_load_the_simulator():
    """By the modules that a fresh interpreter has loaded, also indirectly."""
    code = (
        "import sys, firmware_emulator.cases, firmware_emulator.mechanisms.query;"
        "print([name for name in sys.modules if name.startswith(('imuarray.simulate', 'imuarray.gap'))])"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "[]"


def test_a_url_names_mechanisms_sensors_and_severities():
    query = {"mechanism": "mains_ripple,log_creep", "severity": "2,0.5", "sensor": "Gyro|Gyro twin,BMA"}
    ripple, creep = fittings_from(query, ARRAY)
    assert ripple.sensors == ("Gyro", "Gyro twin")
    assert ripple.mechanism == MECHANISMS["mains_ripple"].at(2.0)
    assert creep.sensors == ("BMA",)
    assert fittings_from({"mechanism": "mux_hang"}, ARRAY)[0].sensors == ("BMA", "BMA twin", "Gyro", "Gyro twin")
    assert fittings_from({"mechanism": "supply_drift"}, ARRAY)[0].sensors == ("BMA", "BMA twin")
    with open_bus({**query, "units": "drawn", "run": "3", "seed": "5"}, ARRAY) as bus:
        bus.transfer(0x70, b"\x04")
        assert bus.transfer(0x40, b"\x00", 1) == b"\x03"


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"mechanism": "magic"}, "mechanism 'magic'; allowed are carrier_shot_noise"),
        ({"mechanism": "log_creep", "sensor": "Gyro9"}, "allowed are ADXL, BMA, BMA twin, Gyro, Gyro twin"),
        ({"mechanism": "lever_arm", "sensor": "Gyro"}, "allowed are ADXL, BMA, BMA twin"),
        ({"mechanism": "log_creep", "severity": "0"}, "allowed is anything above 0"),
        ({"mechanism": "log_creep", "severity": "much"}, "severity=much; allowed is a number"),
        ({"mechanism": "log_creep", "severity": "1,2"}, "lists of equal length"),
        ({"mechanism": "crossed_wiring", "sensor": "BMA"}, "needs exactly 2 sensors"),
        ({"mechanism": "crossed_wiring", "sensor": "BMA|Gyro"}, "needs sensors of one chip"),
        ({"mechanism": "rate_divider,slow_oscillator"}, "two mechanisms would change the inside"),
        ({"units": "new"}, "units=new; allowed are paper, drawn"),
        ({"run": "-1"}, "run=-1; allowed is a whole number"),
    ],
)
def test_a_url_with_impossible_parameters_is_refused(query, message):
    with pytest.raises(ValueError, match=message):
        open_bus(query, ARRAY)


def test_a_board_without_mechanisms_equals_the_plain_board():
    def conversation(**settings):
        with open_bus({"seed": "4", **settings}, ARRAY) as bus:
            bus.transfer(0x70, b"\x04")
            bus.clock.sleep_until(10**9)
            return [bus.transfer(0x40, b"\x02", 7) for _ in range(50)], bus.clock.now_ns()

    assert conversation() == conversation(units="paper")
    assert conversation() != conversation(units="paper", run="1")
    assert isinstance(FittedBoard(ARRAY, both, 4).kind(ARRAY.sensors[0]), type)

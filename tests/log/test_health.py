"""The health level of a recording, and the events that count as faults."""

from __future__ import annotations

import pytest

from imuarray.log.format import Event
from imuarray.log.health import Health, Observations, health_of, is_trouble


@pytest.mark.parametrize(
    ("seen", "health"),
    [
        (Observations(1, 100), Health("green", "the sensor delivers, no frame was missed, no fault reported")),
        (Observations(4, 100), Health("green", "all 4 sensors deliver, no frame was missed, no fault reported")),
        (Observations(4, 999, missed=1), Health("amber", "1 frame missed")),
        (Observations(4, 90, missed=10), Health("red", "10 % of the frames missed")),
        (Observations(4, 99, silent={"Gyro2": 12.0}), Health("red", "Gyro2 silent for 12 s")),
        (Observations(4, 99, lost={"A": 3, "B": 0}), Health("amber", "3 readings of A lost")),
        (Observations(4, 99, gaps={"A": 1}), Health("amber", "1 gap in the readings of A")),
        (Observations(4, 99, clipped={"A": 7}), Health("amber", "7 readings of A at the end of the range")),
        (Observations(4, 99, faults={("A", "stuck_bus"): 2}), Health("amber", "2 faults of A reported (stuck bus)")),
        (Observations(4, 99, stopped="nothing came for 9 s"), Health("red", "nothing came for 9 s")),
        (Observations(4, 99, room_s=1800.0), Health("amber", "the disk is full in 30 min")),
        (Observations(4, 99, room_s=60.0), Health("red", "the disk is full in 60 s")),
        (
            Observations(4, 99, room_s=1e6),
            Health("green", "all 4 sensors deliver, no frame was missed, no fault reported"),
        ),
        (
            Observations(9, 99, silent=dict.fromkeys("ABCDE", 5.0), missed=1, lost={"F": 2}, faults={("", "bus"): 1}),
            Health("red", "A, B, C and 2 more silent for 5 s; 1 frame missed; 2 readings of F lost"),
        ),
    ],
)
def test_the_worst_fault_decides_the_level_and_is_named_first(seen: Observations, health: Health) -> None:
    result = health_of(seen)
    assert (result.level, result.reason) == (health.level, health.reason)
    assert (result.advice == "") == (result.level == "green")


def test_the_advice_is_for_the_first_reason() -> None:
    assert health_of(Observations(4, 90, missed=10)).advice == "lower the frame rate, or record fewer sensors"
    advice = health_of(Observations(4, 90, missed=10, bus_failed=True)).advice
    assert advice == "check the wires and pull-up resistors of the bus"
    seen = Observations(4, 90, silent={"A": 9.0}, missed=10)
    assert health_of(seen).advice == "check cable, power and address"


def test_faults_that_have_a_count_are_not_counted_as_events_too() -> None:
    """The logger reports missed frames and lost readings by events too."""
    seen = Observations(4, 999, missed=2, lost={"A": 1}, faults={("", "late"): 1, ("A", "lost"): 1})
    assert health_of(seen).reason == "2 frames missed; 1 reading of A lost"
    assert health_of(Observations(4, 999, faults={("A", "lost"): 1})).reason == "1 fault of A reported (readings lost)"
    seen = Observations(4, 999, gaps={"A": 1}, faults={("A", "lost"): 1})
    assert health_of(seen).reason == "1 gap in the readings of A"
    seen = Observations(4, 999, silent={"A": 5.0}, faults={("A", "lost"): 1})
    assert health_of(seen).reason == "A silent for 5 s"


@pytest.mark.parametrize(
    ("kind", "message", "trouble"),
    [
        ("lost", "no reading", True),
        ("lost", "in all 12 readings lost in 3.0 s", False),
        ("hang", "SDA is held low", True),
        ("hang", "works again, after 3.0 s", False),
        ("adapter", "the adapter is back at /dev/i2c-3, its sensors are configured again", False),
        ("hang", "still present when the log ended, in all 2 times in 3.0 s", True),
        ("back", "answers again with its configuration intact, after 0.50 s", False),
        ("recovered", "the log was cut short", False),
    ],
)
def test_the_end_of_a_fault_is_not_a_fault(kind: str, message: str, trouble: bool) -> None:
    assert is_trouble(Event(0, "A", kind, message)) is trouble


def test_consecutive_names_are_written_as_a_range() -> None:
    """Eight gyroscopes of one board are named by the first and the last, as everywhere else."""
    seen = Observations(sensors=8, frames=100, clipped={f"IMU{number}_gyro": 10 for number in range(1, 9)})
    assert "80 readings of IMU1_gyro to IMU8_gyro at the end of the range" in health_of(seen).reason

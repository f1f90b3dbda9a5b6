"""Acquisition: detects the sensors of an array on a bus, connects them and records them into a log."""

from imuarray.acquire.detect import Detection, detect, explore
from imuarray.acquire.record import record
from imuarray.acquire.recording import RecordingCounts, RecordingOptions
from imuarray.acquire.sensor_routes import SensorRoute, connect

Summary = RecordingCounts
"""The former name of `RecordingCounts`."""

__all__ = ["Detection", "RecordingCounts", "RecordingOptions", "SensorRoute", "connect", "detect", "explore", "record"]

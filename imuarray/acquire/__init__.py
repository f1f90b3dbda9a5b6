"""Acquisition: detects the sensors of an array on a bus, connects them and records them into a log."""

from imuarray.acquire.detect import Detection, detect, explore
from imuarray.acquire.record import record
from imuarray.acquire.recording import RecordingOptions, Summary
from imuarray.acquire.sensor_routes import SensorRoute, connect

__all__ = ["Detection", "RecordingOptions", "SensorRoute", "Summary", "connect", "detect", "explore", "record"]

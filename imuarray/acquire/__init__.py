"""Acquisition: detects the sensors of an array on a bus, connects them and records them into a log."""

from imuarray.acquire.bus_segment import connect
from imuarray.acquire.detection import Detection, detect, explore
from imuarray.acquire.recorder import record
from imuarray.acquire.recording import RecordingCounts, RecordingOptions
from imuarray.acquire.sample_buffer import SensorRoute

Summary = RecordingCounts
"""The former name of `RecordingCounts`."""

__all__ = ["Detection", "RecordingCounts", "RecordingOptions", "SensorRoute", "connect", "detect", "explore", "record"]
